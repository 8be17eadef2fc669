"""What a singular extremal claims is evaluated at what is returned, relative to what it is made of."""

from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem
from retrax.integrators.boundary_value.inputs.boundary_data import BoundaryDataReader
from retrax.integrators.boundary_value.shooting import EndConditions
from retrax.integrators.boundary_value.shooting.end_conditions import EndValues
from retrax.integrators.boundary_value.shooting.verification import (
    find_end_violation,
    stationarity,
    stationarity_violation,
)
from retrax.manifolds import Euclidean

PLANE, STEPS = Euclidean(2), 6
TIMES = np.linspace(0, 1, STEPS)
SCALES = 10.0 ** np.arange(-12, 13, 4)


class Cost(eqx.Module):
    """``scale (w^2 / 2 + price |s|)`` of two controls ``(w, s)``."""

    scale: Array
    price: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return self.scale * (u[0] ** 2 / 2 + self.price * jnp.abs(u[1]))


def driven(q: Array, u: Array) -> Array:
    return u


def problem(scale: float = 1.0, price: float = 0.0) -> OptimalControlProblem:
    """``q' = (w, s)``: extremals have ``p = (scale w, 0)``, and any ``s``."""
    return OptimalControlProblem(PLANE, driven, Cost(jnp.asarray(scale), jnp.asarray(price)), 2)


measured = eqx.filter_jit(stationarity)  # once for all costs


def verdict(
    given: OptimalControlProblem, costates: np.ndarray, controls: np.ndarray, exact: bool = True, slope: float = 0.0
) -> str:
    """With costates that change by a slope over each step."""
    points = tuple((np.ones((STEPS, 2)), costates + a * slope) for a in (-0.5, 0.0, 0.5))
    return stationarity_violation(given, TIMES, measured(given, points, controls), exact)


CONTROLS = np.stack([np.full(STEPS, 2.0), np.cos(3 * TIMES)], axis=1)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("component", [0, 1])
@pytest.mark.usual(1)
def test_a_control_that_is_beside_is_seen_at_every_size_of_the_cost(scale, component):
    costates = scale * np.stack([CONTROLS[:, 0], np.zeros(STEPS)], axis=1)
    broken = []
    for error in (0.0, 1e-14, 1e-11, 1e-7, 1e-4, 1.0):
        moved = costates.copy()
        moved[3, component] += error * scale
        words = verdict(problem(scale), moved, CONTROLS)
        assert not words or f"in u[{component}] at t = {TIMES[3]:.6g}" in words
        broken.append(bool(words))
    assert broken == [False, False, False, True, True, True]


@pytest.mark.slow
def test_controls_that_switch_over_a_kink_are_no_gauge():
    """With the price ``c`` of ``|s|`` the costate ``c`` suits one sign of ``s``: the other misses by ``2 c``."""
    for price in 10.0 ** np.arange(-6, 5, 2):
        costates = np.stack([CONTROLS[:, 0], np.full(STEPS, price)], axis=1)
        given = problem(1.0, price)
        assert not verdict(given, costates, np.abs(CONTROLS))
        for exact in (True, False):
            assert f"dH/du is {2 * price:.3g} in u[1]" in verdict(given, costates, CONTROLS, exact)


def test_a_control_between_the_stages_is_allowed_what_a_step_varies():
    costates = np.stack([CONTROLS[:, 0], np.zeros(STEPS)], axis=1)
    beside = partial(verdict, problem(), costates + np.array([1e-3, 0]), CONTROLS)
    assert beside(exact=True, slope=np.array([1e-2, 0]))
    assert [bool(beside(exact=False, slope=np.array([slope, 0]))) for slope in (0.0, 1e-5, 1e-4, 3e-3, 1e-1)] == [
        True,
        True,
        True,
        False,
        False,
    ]


@pytest.mark.parametrize("scale", SCALES)
def test_a_missed_end_is_seen_in_every_unit(scale):
    space = Euclidean(1) * Euclidean(1)
    reader = BoundaryDataReader(space)
    ends = reader.ends((np.zeros(1), None), (np.full(1, scale), None), batched=False)
    rows = zip((ends.start, ends.end), ends.prescribed, strict=True)
    nodes = (reader.condition(row[0], prescribed.parts) for row, prescribed in rows)
    conditions = EndConditions(OptimalControlProblem(space, lambda q, u: (u, u), lambda q, u: u @ u, 1), *nodes)
    trajectory = tuple(scale * np.linspace(0, 1, 5)[:, None] for _ in range(2))
    for part, name in enumerate(("state at the end, factor 0", "costate at the end, factor 1")):
        rows = np.zeros(2)
        rows[part] = 1e-5 * scale
        at = EndValues(np.zeros(2), np.zeros((2, 2)), rows, np.zeros((2, 2)), {})
        words = find_end_violation(conditions, at, trajectory, trajectory)
        assert (name in words and words.endswith(f"reach {scale:.3g}")) or rows[part] < 1e-13
        rows[part] = 1e-12 * scale
        assert not find_end_violation(conditions, at, trajectory, trajectory)
