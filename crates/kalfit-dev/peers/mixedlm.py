"""`MixedLM` of statsmodels, or of mixedlm-rs, which has the same interface: the second argument names the package."""

import csv
import sys
import warnings
from importlib import import_module

import common

PACKAGES = {"statsmodels": "statsmodels.regression.mixed_linear_model", "mixedlm-rs": "mixedlm_rs"}
package = sys.argv[2]

try:
    import numpy as np

    MixedLM = import_module(PACKAGES[package]).MixedLM
except ImportError:
    common.missing()

with open(sys.argv[1], newline="") as file:
    rows = [(row["test"], float(row["x"]), float(row["y"])) for row in csv.DictReader(file)]
test = np.array([row[0] for row in rows])
design = np.array([(1.0, row[1]) for row in rows])
y = np.array([row[2] for row in rows])


def fit():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return MixedLM(y, design, groups=test, exog_re=design).fit(reml=False)


result, run = common.timed(fit)
covariance = np.asarray(result.cov_re)
common.say(
    package,
    run,
    result.llf,
    mean=result.fe_params,
    covariance=[covariance[0, 0], covariance[1, 0], covariance[1, 1]],
    noise=[result.scale**0.5],
)
