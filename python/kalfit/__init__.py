"""Error models from ensembles of tests that are not alike: maximum likelihood for the mean and covariance of the initial state of
a Kalman filter model.

>>> import kalfit
>>> fit = kalfit.fit("examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv")
>>> print(fit)
Gyros on two bench stations
...
"""

from kalfit._data import Data, Table, TableLike
from kalfit._estimates import Estimate, Parameter, Parameters
from kalfit._fit import Fit, Interrupted, apply, predict
from kalfit._fitting import Ensemble, fit
from kalfit._formula_model import FormulaModel, model_from_formula
from kalfit._jobs import check, compare, datasheet, estimates, export, plan, reduce, simulate, test, validate
from kalfit._kalfit import DataError, Error, FitError, ModelError, version
from kalfit._labelled import Labelled
from kalfit._lmm import lmm
from kalfit._model import Model, ModelLike
from kalfit._population import Factor, Level, Phase
from kalfit._progress import Step
from kalfit._results import (
    Applied,
    Check,
    Comparison,
    Datasheet,
    Filter,
    Plan,
    Predicted,
    RatioTest,
    Simulation,
    Validation,
)
from kalfit._test_fits import GroupFit, TestFit
from kalfit._warnings import ConvergenceWarning, FormulaWarning

__version__ = version()

__all__ = [
    "Applied",
    "Check",
    "Comparison",
    "ConvergenceWarning",
    "Data",
    "DataError",
    "Datasheet",
    "Ensemble",
    "Error",
    "Estimate",
    "Filter",
    "Fit",
    "FitError",
    "FormulaModel",
    "FormulaWarning",
    "GroupFit",
    "Interrupted",
    "Labelled",
    "Factor",
    "Level",
    "Model",
    "ModelError",
    "ModelLike",
    "Parameter",
    "Parameters",
    "Phase",
    "Plan",
    "Predicted",
    "RatioTest",
    "Simulation",
    "Step",
    "Table",
    "TableLike",
    "TestFit",
    "Validation",
    "__version__",
    "apply",
    "check",
    "compare",
    "datasheet",
    "estimates",
    "export",
    "fit",
    "lmm",
    "model_from_formula",
    "plan",
    "predict",
    "reduce",
    "simulate",
    "test",
    "validate",
]
