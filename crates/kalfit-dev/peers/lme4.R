source("common.R")
data <- read.csv(commandArgs(TRUE)[1])
data$test <- factor(data$test)
needs("lme4")

run <- timed(function() lmer(y ~ x + (x | test), data, REML = FALSE))
fit <- run$fitted
say("lme4", run, logLik(fit), fixef(fit), VarCorr(fit)$test, sigma(fit))
