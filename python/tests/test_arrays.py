"""Ensembles from arrays, against the joint Gaussian density of all measurements, by numpy."""

import numpy as np
import pytest

import kalfit

N, M = 3, 2


def spread(rng, size, least=0.1):
    root = rng.normal(size=(size, size))
    return root @ root.T / size + least * np.eye(size)


def ensemble_of(rng, tests=7):
    """Random arrays of every kind, with gaps, and tests of different lengths."""
    lengths = rng.integers(3, 7, size=tests)
    made = {
        "transition": [rng.normal(size=(k, N, N)) * 0.4 for k in lengths],
        "process_noise": [np.stack([spread(rng, N, 0.05) for _ in range(k)]) for k in lengths],
        "inputs": [rng.normal(size=(k, N)) for k in lengths],
        "observation": [rng.normal(size=(k, M, N)) for k in lengths],
        "noise": [np.stack([spread(rng, M) for _ in range(k)]) for k in lengths],
        "measurement_offsets": rng.normal(size=(max(lengths), M)),
        "start_offsets": rng.normal(size=(tests, N)),
    }
    measurements = [rng.normal(size=(k, M)) * 2 for k in lengths]
    for test in measurements:
        test[rng.random(size=test.shape) < 0.2] = np.nan
    return measurements, made


def log_density(measurements, made, mean, covariance, step_first):
    """Sum over the tests of the log-density of their measurements, without a filter: x = A x_0 + b + noise, stacked."""
    total = 0.0
    for j, z in enumerate(measurements):
        steps = len(z)
        carry, known = np.eye(N), made["start_offsets"][j].copy()
        weights = []  # of x_0 and of each w in x_k
        noises = []
        state = np.zeros((N, 0))
        rows_x0, rows_known, rows_w = [], [], []
        for k in range(steps):
            if k > 0 or step_first:
                f = made["transition"][j][k]
                carry, known = f @ carry, f @ known + made["inputs"][j][k]
                state = np.hstack([f @ state, np.eye(N)])
                noises.append(made["process_noise"][j][k])
            weights.append((carry.copy(), known.copy(), state.copy()))
        wide = N * len(noises)
        for carry, known, state in weights:
            rows_x0.append(carry)
            rows_known.append(known)
            rows_w.append(np.hstack([state, np.zeros((N, wide - state.shape[1]))]))
        q = np.zeros((wide, wide))
        for i, noise in enumerate(noises):
            q[i * N : (i + 1) * N, i * N : (i + 1) * N] = noise
        h = np.zeros((steps * M, steps * N))
        r = np.zeros((steps * M, steps * M))
        for k in range(steps):
            h[k * M : (k + 1) * M, k * N : (k + 1) * N] = made["observation"][j][k]
            r[k * M : (k + 1) * M, k * M : (k + 1) * M] = made["noise"][j][k]
        a, b, c = np.vstack(rows_x0), np.concatenate(rows_known), np.vstack(rows_w)
        centre = h @ (a @ mean + b) + made["measurement_offsets"][:steps].ravel()
        sigma = h @ (a @ covariance @ a.T + c @ q @ c.T) @ h.T + r
        seen = ~np.isnan(z.ravel())
        gap, sigma = (z.ravel() - centre)[seen], sigma[np.ix_(seen, seen)]
        total -= 0.5 * (seen.sum() * np.log(2 * np.pi) + np.linalg.slogdet(sigma)[1] + gap @ np.linalg.solve(sigma, gap))
    return total


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("step_first", [False, True])
def test_the_log_likelihood_is_that_of_the_joint_gaussian(seed, step_first):
    rng = np.random.default_rng(seed)
    measurements, made = ensemble_of(rng)
    ensemble = kalfit.Ensemble.from_arrays(measurements, step_first=step_first, **made)
    mean, covariance = rng.normal(size=N), spread(rng, N)
    names = ensemble.states
    known = ensemble.fit(
        mean={"fixed": dict(zip(names, mean))},
        covariance={"structure": "fixed", "matrix": covariance},
        innovations=False,
        deletion="none",
    )
    expected = log_density(measurements, made, mean, covariance, step_first)
    assert abs(known.log_likelihood - expected) <= 1e-10 * abs(expected), (known.log_likelihood, expected)
    free = ensemble.fit(innovations=False, deletion="none")
    expected = log_density(measurements, made, free.mean, free.covariance, step_first)
    assert free.converged and abs(free.log_likelihood - expected) <= 1e-9 * abs(expected), (free.log_likelihood, expected)
    assert free.log_likelihood > known.log_likelihood


def test_one_array_for_all_tests_is_the_same_as_a_list_of_it():
    rng = np.random.default_rng(9)
    z = rng.normal(size=(5, 4, 1))
    h, r = rng.normal(size=(4, 1, 2)), [[0.25]]
    shared = kalfit.Ensemble.from_arrays(z, observation=h, noise=r)
    listed = kalfit.Ensemble.from_arrays(list(z), observation=[h] * 5, noise=[np.full((4, 1, 1), 0.25)] * 5)
    assert shared.fit().mean.tolist() == listed.fit().mean.tolist()
    assert len(shared) == 5 and len(shared.table) == 20
    constant = kalfit.Ensemble.from_arrays(z, observation=[[1.0, 0.5]], noise=[[1]], transition=[[1, 1], [0, 1]])
    assert constant.table.columns == ["test", "z1"], "what is always the same is no column"
    assert "1.0" not in constant.model().text.split("[measurements]")[0].replace("(1.0)", ""), constant.model().text


def test_a_known_start_is_not_estimated():
    rng = np.random.default_rng(2)
    z = rng.normal(size=(6, 5, 1))
    ensemble = kalfit.Ensemble.from_arrays(
        z,
        observation=[[1, 1]],
        noise=[[0.1]],
        transition=[[1, 0], [0, 0.9]],
        process_noise=[[0, 0], [0, 0.04]],
        states=["bias", "drift"],
        known_start={"drift": (0.0, 0.5)},
        ids=list("abcdef"),
    )
    fit = ensemble.fit()
    assert fit.states == ["bias"] and [test.id for test in fit.tests] == list("abcdef")
    assert kalfit.fit(ensemble.model(), ensemble).mean.tolist() == fit.mean.tolist()
    assert "bias" in kalfit.check(ensemble.model(), ensemble).summary()


def test_gaps_in_what_a_measurement_needs_are_refused():
    z, h = np.ones((3, 2, 1)), np.ones((2, 1, 1))
    h[1] = np.nan
    with pytest.raises(kalfit.DataError, match=r"H\[1, x1\]"):
        kalfit.Ensemble.from_arrays(z, observation=h, noise=[[1]]).fit()
    z[:, 1] = np.nan
    assert kalfit.Ensemble.from_arrays(z, observation=h, noise=[[1]]).fit().converged


@pytest.mark.parametrize(
    "changed, words",
    [
        ({"measurements": np.ones((3, 2))}, r"measurements is an array of shape \(3, 2\), expected \(tests, steps, m\)"),
        ({"measurements": []}, "no tests"),
        ({"measurements": [np.ones((2, 1)), np.ones((2, 2))]}, r"measurements\[1\] has shape \(2, 2\), expected \(steps, 1\)"),
        ({"noise": np.eye(2)}, r"noise has shape \(2, 2\), expected \(1, 1\) or \(steps, 1, 1\)"),
        ({"transition": np.ones((1, 2, 2))}, r"transition has 1 steps, expected at least the 2"),
        ({"observation": [np.ones((1, 2)), np.ones((1, 3)), np.ones((1, 2))]}, "not of the same shape in all tests"),
        ({"process_noise": [[1, 2], [0, 1]]}, "process_noise is not symmetric"),
        ({"process_noise": [[-1, 0], [0, 1]]}, "variance of x1 in process_noise is -1"),
        ({"states": ["a"]}, "expected 2 different ones"),
        ({"ids": ["a", "a", "b"]}, "expected 3 different ones"),
        ({"start_offsets": np.ones(3)}, r"start_offsets has shape \(3,\)"),
        ({"known_start": {"x7": (0, 1)}}, "known_start names 'x7', expected some of x1, x2"),
    ],
)
def test_arrays_that_do_not_go_together_are_refused_in_words(changed, words):
    given = {"measurements": np.ones((3, 2, 1)), "observation": np.ones((1, 2)), "noise": [[1.0]], **changed}
    with pytest.raises(ValueError, match=words):
        kalfit.Ensemble.from_arrays(given.pop("measurements"), **given)
