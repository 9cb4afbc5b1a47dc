source("common.R")
data <- read.csv(commandArgs(TRUE)[1])
for (name in c("test", "unit", "station")) data[[name]] <- factor(data[[name]])
needs("lme4")

model <- y ~ x + (x | test) + (x | unit) + (x | station)
run <- timed(function() lmer(model, data, REML = FALSE))
fit <- run$fitted
varying <- VarCorr(fit)
say("lme4", run, logLik(fit), fixef(fit), varying$test, sigma(fit), list(varying$station, varying$unit))
