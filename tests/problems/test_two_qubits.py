"""The gate of two qubits: its extremals in closed form, and that none of those that are found is cheaper."""

import numpy as np
import pytest
import scipy.linalg
from retrax import problems
from retrax.integrators import Solver
from scipy.optimize import least_squares

AXES = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
COUPLINGS = -0.5j * np.array([np.kron(a, b) for a in AXES for b in AXES])
FIELDS = -0.5j * np.array([*(np.kron(a, np.eye(2)) for a in AXES), *(np.kron(np.eye(2), a) for a in AXES)])
BASIS = np.concatenate([COUPLINGS, FIELDS])
COUPLED, FIELD = np.array([3.0, 0, 0, 0, 2, 0, 0, 0, 1]), np.array([0.0, 1, 2, 1, 0, -1])
STARTS = 600


def exponential(a):
    """``exp`` of a skew-Hermitian matrix, and its derivatives along the basis by divided differences."""
    t, vectors = np.linalg.eigh(-1j * a)
    gaps, values = t[:, None] - t, np.exp(1j * t)
    near = np.abs(gaps) < 1e-9
    divided = np.where(near, values[:, None], (values[:, None] - values) / np.where(near, 1, 1j * gaps))
    inside = vectors.conj().T @ BASIS @ vectors
    return (vectors * values) @ vectors.conj().T, vectors @ (divided * inside) @ vectors.conj().T


def miss(c, gate):
    """By how much ``exp(-K) exp(K + P)`` misses the gate, and its derivatives by the coordinates of ``P`` and ``K``."""
    first, first_slopes = exponential(-np.tensordot(c[9:], FIELDS, 1))
    second, second_slopes = exponential(np.tensordot(c, BASIS, 1))
    slopes = first @ second_slopes
    slopes[9:] -= first_slopes[9:] @ second
    gap = (first @ second - gate).ravel()
    slopes = slopes.reshape(15, 16)
    return np.concatenate([gap.real, gap.imag]), np.concatenate([slopes.real, slopes.imag], axis=1).T


def test_the_controls_of_the_record_lead_to_the_gate():
    entry = problems.get("two-qubit-gate")
    coupled, field = np.tensordot(COUPLED, COUPLINGS, 1), np.tensordot(FIELD, FIELDS, 1)
    u, steps = np.eye(4, dtype=complex), 400
    for t in (np.arange(steps) + 0.5) / steps:
        turn = scipy.linalg.expm(t * field)
        control = np.einsum("kij,ji->k", COUPLINGS.conj().transpose(0, 2, 1), turn.conj().T @ coupled @ turn).real
        np.testing.assert_allclose(control @ control / 2, entry.optimum, rtol=1e-12)
        u = scipy.linalg.expm(np.tensordot(control, COUPLINGS, 1) / steps) @ u
    np.testing.assert_allclose(u, entry.end, atol=1e-4)


@pytest.mark.slow
def test_no_extremal_that_least_squares_find_is_cheaper():
    entry, rng = problems.get("two-qubit-gate"), np.random.default_rng(0)
    costs = []
    for _ in range(STARTS):
        sizes = np.repeat([2.0, rng.uniform(0, 5)], [9, 6])
        found = least_squares(
            lambda c: miss(c, entry.end)[0],
            sizes * rng.standard_normal(15),
            lambda c: miss(c, entry.end)[1],
            xtol=1e-14,
        )
        if found.cost < 1e-20:
            costs.append(found.x[:9] @ found.x[:9] / 2)
    costs = np.sort(costs)
    assert len(costs) > STARTS / 4
    np.testing.assert_allclose(costs[0], entry.optimum, rtol=1e-9)
    assert np.min(costs[costs > 7.001]) > 9.675


@pytest.mark.slow
def test_the_gate_is_solved_on_the_tape():
    entry = problems.get("two-qubit-gate")
    solver = Solver(entry.problem, entry.discretization, entry.steps)
    solution = solver.solve(entry.start, entry.end, entry.horizon)
    assert solver.evaluator == "tape"
    assert abs(entry.distance(solution.cost)) < 1e-9
