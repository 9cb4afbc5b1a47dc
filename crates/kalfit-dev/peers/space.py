"""The ensemble of `cargo dev peers`' state-space comparison, from a CSV file of z and the known inputs, test by test.

Random constants seen through known inputs, and a stationary drift: x' = 0.9 x + w, Var w = 0.19, Var noise = 0.01, prior N(0, I).
"""

import csv
import sys

import numpy as np


def ensemble():
    """Measurements, tests by rows; coefficients, tests by rows by states, or rows by states where all tests share them."""
    with open(sys.argv[1], newline="") as file:
        table = list(csv.reader(file))[1:]
    tests = len({row[0] for row in table})
    numbers = np.array([[float(cell) for cell in row[1:]] for row in table]).reshape(tests, -1, len(table[0]) - 1)
    inputs = numbers[:, :, 1:]
    H = np.concatenate([inputs, np.ones(inputs.shape[:2] + (1,))], axis=2)
    shared = bool((H == H[0]).all())
    return numbers[:, :, 0], H[0] if shared else H, shared


def dynamics(states):
    F = np.eye(states)
    F[-1, -1] = 0.9
    Q = np.zeros((states, states))
    Q[-1, -1] = 0.19
    return F, Q, np.array([[0.01]]), np.zeros(states), np.eye(states)
