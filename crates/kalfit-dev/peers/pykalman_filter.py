import common

try:
    import numpy as np
    from pykalman import KalmanFilter
except ImportError:
    common.missing()

from space import dynamics, ensemble

z, H, shared = ensemble()
F, Q, R, mean, covariance = dynamics(H.shape[-1])


def total():
    value = 0.0
    for j, values in enumerate(z):
        weights = (H if shared else H[j])[:, None, :]
        filtered = KalmanFilter(F, weights, Q, R, initial_state_mean=mean, initial_state_covariance=covariance)
        value += filtered.loglikelihood(values[:, None])
    return value


value, run = common.timed(total)
common.say("pykalman", run, value)
