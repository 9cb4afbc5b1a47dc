source("common.R")
# a latent intercept and a latent slope whose loadings are definition variables: one row for each test
data <- read.csv(commandArgs(TRUE)[1])
needs("OpenMx")
mxOption(key = "Number of Threads", value = 1)

rows <- as.integer(table(data$test))[1]
data$row <- ave(data$x, data$test, FUN = seq_along)
wide <- reshape(data, idvar = "test", timevar = "row", direction = "wide", sep = "")
y <- paste0("y", seq_len(rows))
x <- paste0("x", seq_len(rows))
model <- mxModel("regression",
  type = "RAM", manifestVars = y, latentVars = c("intercept", "slope"),
  mxPath("intercept", y, free = FALSE, values = 1),
  mxPath("slope", y, free = FALSE, labels = paste0("data.", x)),
  mxPath("one", c("intercept", "slope"), free = TRUE, values = c(mean(data$y), 0), labels = c("m1", "m2")),
  mxPath(c("intercept", "slope"),
    arrows = 2, connect = "unique.pairs", free = TRUE, values = c(0.5, 0, 0.5), labels = c("c11", "c21", "c22")
  ),
  mxPath(y, arrows = 2, free = TRUE, values = 0.5 * var(data$y), lbound = 1e-6, labels = "r"),
  mxData(wide, type = "raw")
)
run <- timed(function() mxRun(model, silent = TRUE))
fit <- run$fitted
at <- coef(fit)
covariance <- matrix(at[c("c11", "c21", "c21", "c22")], 2)
say("OpenMx", run, logLik(fit), at[c("m1", "m2")], covariance, sqrt(at["r"]))
