source("common.R")
# the second argument: `dense` or `sparse` matrices
arguments <- commandArgs(TRUE)
data <- read.csv(arguments[1])
needs("metafor")

tests <- nrow(data)
long <- data.frame(
  test = rep(data$test, each = 2),
  outcome = rep(c("a", "b"), tests),
  y = as.vector(rbind(data$y_a, data$y_b))
)
V <- lapply(seq_len(tests), function(j) with(data[j, ], matrix(c(v_a, c_ab, c_ab, v_b), 2)))
run <- timed(function() {
  rma.mv(y, bldiag(V),
    mods = ~ outcome - 1, random = ~ outcome | test, struct = "UN", data = long, method = "ML",
    sparse = arguments[2] == "sparse"
  )
})
fit <- run$fitted
tau <- sqrt(fit$tau2)
covariance <- diag(fit$tau2)
covariance[1, 2] <- covariance[2, 1] <- fit$rho * prod(tau)
say("metafor", run, logLik(fit), coef(fit), covariance)
