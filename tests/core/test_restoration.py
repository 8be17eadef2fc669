"""The feasibility phase of the core, judged by integrating what it finds."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding import search
from retrax.compute.binding.search import Feasibility, Search
from retrax.compute.binding.structs import Residual
from retrax.integrators import OptimalControlProblem, Phase, Solver, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint

PLANE, SPACE = Euclidean(2), Euclidean(3)
ROOT = np.sqrt(3) / 6
TABLEAUS = {  # of one point and of two points of Gauss
    1: (np.array([[0.5]]), np.ones(1)),
    2: (np.array([[0.25, 0.25 - ROOT], [0.25 + ROOT, 0.25]]), np.full(2, 0.5)),
}
TOLERANCE, MISSES = 1e-10, 1e-8


def car(q: Any, u: Any, numbers: Any = jnp) -> Any:
    """A car, which cannot move sideways."""
    return numbers.stack([u[0] * numbers.cos(q[2]), u[0] * numbers.sin(q[2]), u[1]])


def pendulum(q: Any, u: Any, numbers: Any = jnp) -> Any:
    return numbers.stack([q[1], u[0] - numbers.sin(q[0])])


def half_square(q: Any, u: Any) -> Any:
    return u @ u / 2


class Phases:
    """The feasibility phases that come before the first search of a solve."""

    def __init__(self, monkeypatch: Any, most: int = 100) -> None:
        self.found: Feasibility | None = None
        self.arrays: list[dict[str, Any]] = []
        self.steps: list[tuple[float, float]] = []  # shares of Newton's step, and what the first phase misses after it
        run, report = Search.run, search._report

        def noted(owner: Any, context: Any, iteration: Any) -> bool:
            if self.found is None:
                missed = owner().phase(0)["RESIDUALS"][Residual.INFEASIBILITY]
                self.steps.append((iteration.contents.fraction, missed))
            return report(owner, context, iteration)

        monkeypatch.setattr(search, "_report", noted)

        def restored(search: Search) -> Any:
            if self.found is None:
                self.found = search.restore(most)
                for k in range(len(search._of)):
                    at = search.phase(k)
                    names = "STEP_SIZE", "CONTROLS", "COSTATES", "POINT_COSTATES", "LIMIT_MULTIPLIERS"
                    self.arrays.append(
                        {name: at[name].copy() for name in names} | {"POINTS": search._of[k].sizes.points}
                    )
            return run(search)

        monkeypatch.setattr(Search, "run", restored)

    def rolled_out(self, phase: int, field: Callable[..., Any], start: np.ndarray) -> Any:
        """The end to which the controls of a phase lead from a start, and the points on the way there."""
        own, q, passed = self.arrays[phase], np.array(start, float), []
        a, b = TABLEAUS[own["POINTS"]]
        controls = own["CONTROLS"].reshape(len(own["STEP_SIZE"]), len(b), -1)
        for h, u in zip(own["STEP_SIZE"], controls, strict=True):
            stages = np.tile(q, (len(b), 1))
            for _ in range(100):
                slopes = np.stack([field(stage, v, np) for stage, v in zip(stages, u, strict=True)])
                stages = q + h * a @ slopes
            passed += list(stages)
            q = q + h * b @ slopes
        return q, np.array(passed), controls.reshape(-1, controls.shape[-1])


METHODS = pytest.mark.parametrize("method", [Midpoint, lambda retraction: Gauss(2, retraction)], ids=["map", "Gauss"])


@METHODS
@pytest.mark.parametrize("aside", [0.05, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("limit", [None, 9.0])
@pytest.mark.usual(2)
def test_a_car_is_led_to_a_place_beside_it(method, aside, limit, monkeypatch):
    """No control leads there at first."""
    bounds = {} if limit is None else {"control_bounds": (-limit, limit)}
    problem, phases = OptimalControlProblem(SPACE, car, half_square, 2, **bounds), Phases(monkeypatch)
    solver = Solver(problem, method(Addition(SPACE)), 12)
    end = np.array([0.3, aside, 0.0])
    found = solver.solve(np.zeros(3), end, 1.0)
    assert found.success
    assert phases.found is not None
    assert phases.found.feasible
    reached, _, controls = phases.rolled_out(0, car, np.zeros(3))
    np.testing.assert_allclose(reached, end, atol=MISSES)
    assert limit is None or np.abs(controls).max() < limit
    for name in "COSTATES", "POINT_COSTATES", "LIMIT_MULTIPLIERS":
        assert not phases.arrays[0][name].any()
    shares, missed = np.transpose(phases.steps)
    assert np.all(shares <= 1)
    assert np.all(np.diff(missed) <= 0)


@METHODS
@pytest.mark.parametrize("torque", [2.0, 0.5])
@pytest.mark.usual(1)
def test_a_pendulum_is_swung_with_little_torque(method, torque, monkeypatch):
    problem = OptimalControlProblem(PLANE, pendulum, half_square, 1, control_bounds=(-torque, torque))
    phases, end = Phases(monkeypatch), np.array([1.0, 0.0])
    Solver(problem, method(Addition(PLANE)), 20).solve(np.zeros(2), end, 6.0, throw=False)
    assert phases.found is not None
    assert phases.found.feasible
    reached, _, controls = phases.rolled_out(0, pendulum, np.zeros(2))
    np.testing.assert_allclose(reached, end, atol=MISSES)
    assert np.abs(controls).max() < torque


def two_phases(torque: float, monkeypatch: Any, **options: Any) -> Phases:
    """A pendulum that loses half of its speed amid its way, and whose torque is limited from then on."""
    phases = Phases(monkeypatch, **options)
    free = OptimalControlProblem(PLANE, pendulum, half_square, 1)
    limited = OptimalControlProblem(PLANE, pendulum, half_square, 1, control_bounds=(-torque, torque))
    first = Phase(free, Midpoint(Addition(PLANE)), 8, 1.0, start=np.zeros(2))
    second = Phase(limited, Gauss(2, Addition(PLANE)), 6, 1.0, end=np.array([1.5, 0.0]))
    solve_phases([first, second], links=[lambda q: q * np.array([1.0, 0.5])], throw=False)
    return phases


@pytest.mark.parametrize("most", [1.5, 3.0, 12.0])
@pytest.mark.usual(1)
def test_phases_are_led_over_their_links(most, monkeypatch):
    phases = two_phases(most, monkeypatch)
    assert phases.found is not None
    assert phases.found.feasible
    amid, *_ = phases.rolled_out(0, pendulum, np.zeros(2))
    reached, _, controls = phases.rolled_out(1, pendulum, amid * np.array([1.0, 0.5]))
    np.testing.assert_allclose(reached, [1.5, 0.0], atol=MISSES)
    assert np.abs(controls).max() < most


def test_what_holds_is_told_by_what_is_evaluated(monkeypatch):
    """Around a disc that the guess runs through: excesses may be left, and then not all holds."""

    def outside(q: Any, u: Any = None) -> Any:
        return 0.04 - (q[0] - 0.5) ** 2 - (q[1] - 0.05) ** 2

    problem = OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, constraints={"disc": outside})
    phases = Phases(monkeypatch)
    Solver(problem, Midpoint(Addition(PLANE)), 20).solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, throw=False)
    reached, passed, _ = phases.rolled_out(0, lambda q, u, _: u, np.zeros(2))
    np.testing.assert_allclose(reached, [1.0, 0.0], atol=MISSES)
    assert phases.found is not None
    assert phases.found.feasible
    assert phases.found.holds == (max(map(outside, passed)) <= TOLERANCE)


def test_there_is_no_feasible_trajectory_that_the_controls_do_not_reach(monkeypatch):
    """The bound of the speed is below the way to go."""
    problem = OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, control_bounds=(-0.5, 0.5))
    phases = Phases(monkeypatch)
    Solver(problem, Midpoint(Addition(PLANE)), 20).solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, throw=False)
    assert phases.found is not None
    assert not phases.found.holds


@pytest.mark.parametrize("most", [0, 1, 3])
@pytest.mark.usual(1)
def test_it_makes_no_more_trials_than_it_may(most, monkeypatch):
    phases = two_phases(1.5, monkeypatch, most=most)
    assert phases.found is not None
    assert phases.found.trials == most
    assert not phases.found.feasible


def test_a_report_stops_it(monkeypatch):
    seen = []

    def report(_search, _context, iteration):
        seen.append(iteration.contents.number)
        return seen[-1] == 2

    monkeypatch.setattr(search, "_report", report)
    phases = two_phases(1.5, monkeypatch)
    assert phases.found is not None
    assert phases.found.stopped
    assert phases.found.trials == 2
    assert seen[:2] == [1, 2]
