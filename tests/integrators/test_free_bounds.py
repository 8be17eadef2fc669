"""Bounds of a free horizon and of free parameters, from where they hold to where they do not."""

import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver, solve
from retrax.integrators.boundary_value.inputs.arguments import BoundaryData
from retrax.integrators.boundary_value.inputs.boundary_data import EndPart, PrescribedEnd
from retrax.integrators.boundary_value.inputs.reformulation_kind import ReformulationKind
from retrax.integrators.boundary_value.reformulations.free_quantities import FreeQuantities
from retrax.integrators.boundary_value.transcription.inequality_rows import InequalityRows
from retrax.retractions import Addition, Midpoint

from .test_formulation import AHEAD, DRIFTING, GAUSS, LINE, PLANE, REST, T_BEST, cart, drift, quickly


def test_bounds_are_inequalities_at_the_first_point():
    """In the formulation, before any solver: ``log(l / T_0) - s``, ``s - log(u / T_0)``, ``lower - theta``, ``theta -
    upper``."""
    far = {"far": lambda q, u, given: q - given["gain"]}
    limited = OptimalControlProblem(
        LINE, drift, lambda q, u, given: u @ u, 1, control_bounds=(-2, np.inf), constraints=far
    )
    horizon = Free(2.0, lower=1.0, upper=8.0)
    given = {"gain": 3.0, "drift": Free(np.array([0.5]), upper=np.array([0.75]))}
    reader = Solver(limited, Midpoint(Addition(LINE)), 3)._reader
    formulation = FreeQuantities(reader, ReformulationKind.of(horizon, given))
    inner = formulation.problem.with_parameters(formulation.parameters(BoundaryData(None, None, horizon, given)))
    names = "control_bounds lower", "far", "horizon lower", "horizon upper", "parameters upper"
    assert inner._inequality_names == tuple(f"{name}[0]" for name in names)
    y = np.ones(1), np.array([0.5, 1 + 0.25])
    expected = [-2 - 4, 1 - 3, np.log(0.5) - 0.25, 0.25 - np.log(4), 0.5 - 0.75]
    np.testing.assert_allclose(inner.inequalities(y, np.full(1, 4.0)), expected)
    free = (PrescribedEnd.of((EndPart("", False, 1, 1, 1),), (False,)),) * 2
    mask = InequalityRows(inner, None, 2).mask(3, free)
    assert np.all(mask[:, :, :2])
    assert np.all(mask[0, 0])
    assert not np.any(mask[1:, :, 2:])
    assert not np.any(mask[0, 1, 2:])


def test_minimum_time_with_bounds():
    """``|u| <= a`` from rest to rest over the distance 1: full force, then full brake, ``T = 2 / sqrt(a)``, ``H =
    0``."""
    for bound in (0.25, 1.0, 100.0):
        quickest = OptimalControlProblem(PLANE, cart, lambda q, u: 1.0, 1, control_bounds=(-bound, bound))
        solver = Solver(quickest, GAUSS, 10)
        for guess in (0.3, 3.0, 30.0):
            found = solver.solve(REST, AHEAD, Free(guess / bound**0.5))
            assert found.horizon == pytest.approx(2 / bound**0.5, rel=1e-9)
            np.testing.assert_allclose(found.controls[:, 0], bound * np.repeat([1.0, -1.0], 10), rtol=1e-5)
            assert np.max(np.abs(found.hamiltonians)) < 1e-4


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 1.01, 1.1, 2.0])
@pytest.mark.usual(2)
def test_a_bound_of_the_horizon_from_where_it_holds_to_where_it_does_not(side, share):
    """The multiplier is the derivative of ``T + 6 / T^3`` by the bound; per unit of the time that the first stage
    stands for."""
    bound, other = share * T_BEST, share < 1
    holds = other if side == "upper" else not other
    horizon = Free(0.8 * bound, upper=bound) if side == "upper" else Free(1.2 * bound, lower=bound)
    found = quickly().solve(REST, AHEAD, horizon)
    assert found.horizon == pytest.approx(bound if holds else T_BEST, rel=1e-8)
    weight = (found.times[1] - found.times[0]) / 2
    expected = abs(1 - 18 / bound**4) if holds else 0.0
    assert weight * found.multipliers[f"horizon {side}"][0, 0] == pytest.approx(expected, abs=1e-6)
    assert not np.any(found.multipliers[f"horizon {side}"][1:])


@pytest.mark.parametrize("share", [0.5, 0.95, 1.05, 2.0])
@pytest.mark.usual(1)
def test_a_bound_of_a_parameter_from_where_it_holds_to_where_it_does_not(share):
    best = 2.0 / (2 * (1 + 2.0**2))
    given = {"gain": 2.0, "drift": Free(np.array([0.01]), upper=share * best)}
    found = solve(DRIFTING, np.zeros(1), np.ones(1), 2.0, method=Midpoint(Addition(LINE)), steps=4, parameters=given)
    drifted = min(share, 1.0) * best
    assert found.parameters["drift"] == pytest.approx(drifted, rel=1e-7)
    np.testing.assert_allclose(found.controls, 0.5 - 2 * drifted, rtol=1e-6)
    slope = 2.0 * (2 * (0.5 - 2 * drifted) - drifted)  # - d/da of T ((1/T - g a)^2 + a^2) / 2
    assert 0.5 * found.multipliers["parameters upper"][0, 0] == pytest.approx(slope, abs=1e-7)
