"""celerite2's log-likelihood of a record at irregular times: a Gauss-Markov process seen through noise, both known."""

import sys

import common

try:
    import celerite2
    import numpy as np
    from celerite2 import terms
except ImportError:
    common.missing()

t, y = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1, unpack=True)
process = celerite2.GaussianProcess(terms.RealTerm(a=0.25, c=1 / 3.0), mean=0.0)


def value():
    process.compute(t, diag=np.full(len(t), 0.01))
    return process.log_likelihood(y)


value, run = common.repeated(value)
common.say("celerite2", run, value)
