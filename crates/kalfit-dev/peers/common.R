# What the R scripts share: the time of a fit alone, and the lines that `cargo dev peers` reads.

Sys.setenv(OMP_NUM_THREADS = 1, OPENBLAS_NUM_THREADS = 1)

# status 77 says that the package is missing
needs <- function(package) {
  if (!requireNamespace(package, quietly = TRUE)) quit(status = 77)
  suppressPackageStartupMessages(library(package, character.only = TRUE))
}

timed <- function(fit) {
  gc()
  taken <- system.time(fitted <- fit())
  list(fitted = fitted, processor = sum(taken[1:2]), elapsed = taken[[3]])
}

# covariance: the lower triangle by rows; noise: a standard deviation, or none; groups: covariances of factors and units
say <- function(package, run, log_likelihood, mean, covariance, noise = NULL, groups = NULL) {
  triangle <- function(covariance) as.numeric(covariance[upper.tri(covariance, diag = TRUE)])
  line <- function(key, values) cat(key, format(values, digits = 17, trim = TRUE), "\n")
  cat("version", package, as.character(packageVersion(package)), "\n")
  line("log_likelihood", as.numeric(log_likelihood))
  line("mean", as.numeric(mean))
  line("covariance", triangle(covariance))
  if (!is.null(noise)) line("noise", as.numeric(noise))
  if (!is.null(groups)) line("groups", unlist(lapply(groups, triangle)))
  line("processor", run$processor)
  line("elapsed", run$elapsed)
}
