"""An accuracy that is asked for where constraints hold a trajectory, touch it, or depend on time."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    Free,
    OptimalControlProblem,
    solve,
    step_errors,
)
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Addition, Cayley, Gauss, default_retraction

from .test_refinement import PLANE, cart, energy


@pytest.mark.parametrize("accuracy", [1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
@pytest.mark.parametrize("slope", [1.4, 2.0])
@pytest.mark.usual(2)
def test_a_cone_whose_slopes_pass_through_zero_is_solved_to_any_accuracy(slope, accuracy):
    """Near the end of the arc on the cone the thrust passes its axis in one direction: finer steps come nearer to
    where the cone has no slope in that, and no curvature in the other."""
    gravity, rest = np.array([0.0, 0.0, -1.0]), np.zeros(3)
    space = Euclidean(3) * Euclidean(3)

    def cone(q, u):
        return jnp.sqrt(u[0] ** 2 + u[1] ** 2 + 1e-6) - slope * u[2]

    problem = OptimalControlProblem(
        space, lambda q, u: (q[1], u + gravity), lambda q, u: u @ u / 2, 3, constraints={"cone": cone}
    )
    start = np.array([2.0, 1.0, 3.0]), np.array([0.3, -0.2, -0.5])
    solution = solve(
        problem, start, (rest, rest), 3.0, method=Gauss(2, default_retraction(space)), steps=10, accuracy=accuracy
    )
    assert solution.checks.strict_minimum
    assert solution.cost == pytest.approx({1.4: 6.88101245, 2.0: 5.343992}[slope], rel=max(10 * accuracy, 1e-7))


@pytest.mark.parametrize("accuracy", [1e-4, 1e-5, 1e-7])
@pytest.mark.parametrize("degrees", [15.0, 16.0, 18.0, 20.0])
@pytest.mark.usual(2)
def test_a_minimum_that_touches_a_cone_is_shown_with_any_accuracy(degrees, accuracy):
    """A slew past a cone that is left alone up to 16 degrees, and touched at one time by a wider one: finer stages
    beside that time hold almost the same."""
    inertia, space = jnp.array([3.0, 2.0, 1.0]), SO(3) * Euclidean(3)
    aim = np.array([np.cos(0.8) * np.cos(0.3), np.sin(0.8) * np.cos(0.3), np.sin(0.3)])

    def dynamics(q, u):
        return q[0] @ hat(q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia

    def outside(q, u):
        return q[0][:, 0] @ aim - np.cos(np.deg2rad(degrees))

    problem = OptimalControlProblem(space, dynamics, energy, 3, constraints={"outside": outside})
    turned = np.array([[np.cos(1.6), -np.sin(1.6), 0.0], [np.sin(1.6), np.cos(1.6), 0.0], [0.0, 0.0, 1.0]])
    ends, method = ((np.eye(3), np.zeros(3)), (turned, np.zeros(3))), Gauss(2, Cayley(space))
    solution = solve(problem, *ends, 5.0, method=method, steps=10, accuracy=accuracy)
    assert solution.checks.strict_minimum
    assert (solution.checks.active["outside"] > 0) == (degrees > 17)


@pytest.mark.parametrize("kind", ["constraints", "node_constraints"])
def test_constraints_with_an_explicit_time_are_looked_at_between_the_points(kind):
    line = Euclidean(1)
    tube = (lambda q, u, t: q[0] - 1 - t) if kind == "constraints" else (lambda q, t: q[0] - 1 - t)
    problem = OptimalControlProblem(
        line, lambda q, u, t: u, lambda q, u, t: u @ u / 2, 1, time_dependent=True, **{kind: {"tube": tube}}
    )
    found = solve(problem, np.zeros(1), np.ones(1), 1.0, method=Gauss(2, Addition(line)), steps=10, accuracy=1e-6)
    assert found.cost == pytest.approx(0.5, rel=1e-9)
    assert found.checks.between == {"tube": 0.0}


@pytest.mark.slow
def test_what_is_violated_between_the_points():
    """The largest excess along the polynomials, and none of it at the points; refinement sees what depends on states
    alone."""
    low = {"ceiling": lambda q, u: q[0] - 1 / 9}
    problem = OptimalControlProblem(PLANE, cart, energy, 1, constraints=low)
    given, method = (problem, np.array([0.0, 1.0]), np.array([0.0, -1.0]), 1.0), Gauss(3, Addition(PLANE))
    for steps in (7, 20):
        found = solve(*given, method=method, steps=steps)
        errors = step_errors(problem, found)
        along = found(np.linspace(0, 1, 20_001)).states[:, 0] - 1 / 9
        assert found.checks.violation < 1e-9 < np.max(along)
        np.testing.assert_allclose(np.max(errors.violations["ceiling"]), np.max(along), rtol=0.2)
    found = solve(*given, method=method, steps=7, accuracy=1e-6)
    assert found.checks.between["ceiling"] < 1e-6
    assert abs(found.cost - 4) < 1e-5


@pytest.mark.parametrize(
    ("horizon", "constraints", "count", "accuracy"),
    [
        (Free(3.0), None, 1, 1e-6),
        (Free(3.0, lower=0.5), None, 1, 1e-6),
        (Free(3.0, lower=2.5), None, 1, 1e-6),
        # The control, which costs nothing, chatters within the steps and exceeds the limit between the points.
        (Free(3.0), {"slow": lambda q, u: q[1] - 0.8}, 1, 1e-4),
    ],
)
@pytest.mark.parametrize("refined", [False, True])
@pytest.mark.usual(2)
def test_bounds_of_durations_and_horizons_break_no_symmetry(horizon, constraints, count, accuracy, refined, capsys):
    """The costate of the position is constant, because no function depends on the position."""
    bounds = {"control_bounds": (-1, 1), "constraints": constraints}
    problem = OptimalControlProblem(PLANE, cart, lambda q, u: 1.0, 1, **bounds)
    ends = np.zeros(2), np.array([1.0, 0.0])
    found = solve(
        problem, *ends, horizon, method=Gauss(2, Addition(PLANE)), steps=12, accuracy=accuracy if refined else None
    )
    assert found.checks.conserved == {"R^2": count}
    if count:
        assert np.ptp(found.momenta["R^2"][:, 0]) < 1e-9
    found.report()
    lengths = np.diff(found.times)
    words = f"{lengths[0]:.6g}" if np.ptp(lengths) < 1e-9 else f"{lengths.min():.3g} to {lengths.max():.3g}"
    assert f"steps of {words}\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("price", "accuracy"),
    [
        (0.0, 1e-6),
        *(pytest.param(*of, marks=pytest.mark.slow) for of in ((0.0, 3e-2), (0.0, 3e-3), (1e-2, 1e-6), (0.1, 1e-6))),
    ],
)
def test_a_mesh_is_refined_to_what_a_control_that_chatters_allows(price, accuracy):
    """Least time in the plane at a limit of the speed, along which only the means of two forces are determined: the
    error falls as the steps do, so a loose accuracy is reached, and a tight one only with a cost of the forces."""
    space, most, first = Euclidean(4), 0.8, 20
    limits = {"speed": lambda q, u: q[2:] @ q[2:] - most**2, "force": lambda q, u: jnp.concatenate([u - 1, -1 - u])}
    problem = OptimalControlProblem(
        space, lambda q, u: jnp.concatenate([q[2:], u]), lambda q, u: 1 + price * u @ u, 2, constraints=limits
    )
    ends, method = (np.zeros(4), np.array([1.0, 0.4, 0.0, 0.0])), Gauss(2, Addition(space))
    found = solve(problem, *ends, Free(3.0), method=method, steps=first, accuracy=accuracy, throw=False)
    assert found.success == (found.checks.error <= accuracy) == (price > 0 or accuracy > 1e-3)
    if not found.success:
        assert found.steps == first
        assert re.search("because a control chatters along a constraint.* it would take about .e.* steps", found.result)
        assert found.horizon == pytest.approx(2.0504579, rel=1e-3)
