source("common.R")
data <- read.csv(commandArgs(TRUE)[1])
data$test <- factor(data$test)
needs("nlme")

run <- timed(function() lme(y ~ x, data, random = ~ x | test, method = "ML"))
fit <- run$fitted
say("nlme", run, logLik(fit), fixef(fit), unclass(getVarCov(fit)), sigma(fit))
