"""Mistakes that raise nothing by themselves: controls that are broadcast or unread, and angles in degrees."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax import SO, Cayley, Euclidean, Exponential, Free, Midpoint, OptimalControlProblem, hat, solve
from retrax.integrators.problem_checks.requirements import require_values
from retrax.manifolds import NotOnManifoldError

from .problems import rotation

Q, PLANE = SO(3) * Euclidean(3), Euclidean(2)
LABELS = {"states": ("attitude", "body rate"), "controls": "torque"}
SLEW = OptimalControlProblem(
    Q, lambda q, u: (q[0] @ hat(q[1]), u), lambda q, u: u @ u / 2, 3, labels=LABELS, units={"time": "s"}
)


def cart(dynamics, cost=lambda q, u: u @ u / 2, controls=1, **options):
    problem = OptimalControlProblem(PLANE, dynamics, cost, controls, **options)
    return solve(problem, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Midpoint(Cayley(PLANE)), steps=4)


def test_one_control_that_is_added_to_several_entries_is_asked_about():
    with pytest.warns(
        UserWarning, match="the only control, in .*, is added to each of 2 entries; try controls=2"
    ) as caught:
        require_values(OptimalControlProblem(PLANE, lambda q, u: u - q, lambda q, u: u @ u, 1))
    assert caught[0].filename == __file__
    for dynamics in (
        lambda q, u: jnp.array([0.0, 1.0]) * u - q,
        lambda q, u: u[0] - q,
        lambda q, u: jnp.stack([q[1], u[0]]),
    ):
        require_values(OptimalControlProblem(PLANE, dynamics, lambda q, u: u @ u, 1))


@pytest.mark.parametrize("used", [(0,), (1,), (0, 1)])
@pytest.mark.slow
def test_controls_that_no_function_reads_are_named(used):
    read, labels = jnp.array(used), {"controls": ("left", "right")}

    def solved():
        dynamics, cost = lambda q, u: jnp.stack([q[1], u[read].sum()]), lambda q, u: u[read] @ u[read] / 2
        return cart(dynamics, cost, 2, labels=labels)

    if len(used) == 2:
        found = solved()
    else:
        with pytest.warns(UserWarning, match=f"reads {('right', 'left')[used[0]]}, which makes the problem singular"):
            found = solved()
    assert found.cost == pytest.approx(6.4 / len(used), rel=1e-9)  # of four midpoint steps: 6 / (1 - 1/16)


@pytest.mark.parametrize("degrees", [10.0, 60.0, 110.0, 119.0, 121.0, 150.0])
@pytest.mark.usual(2)
def test_the_report_has_the_angle_of_the_turn_and_asks_about_long_steps(degrees):
    angle = np.radians(degrees)
    end = np.asarray(rotation([0.0, 0.0, angle]))
    problem = OptimalControlProblem(
        SO(3), lambda q, u: q @ hat(u), lambda q, u: u @ u / 2, 3, labels={"states": "attitude"}
    )
    text = str(solve(problem, np.eye(3), end, 1.0, method=Midpoint(Exponential(SO(3))), steps=1))
    assert f"{degrees:.4g} degrees from start to end" in text
    assert ("angles and rates are in radians" in text) == (degrees > 120)


@pytest.mark.parametrize("rate", [0.1, 1.0, 10.0, 57.3])
def test_a_failed_solve_asks_about_rates_in_degrees(rate):
    """A body that turns by 1 rad s^-1, or by the same number of degrees per second, and is to rest after 20 s."""
    start, end = (np.eye(3), np.array([0.0, 0.0, rate])), (np.asarray(rotation([0.0, 0.0, 2.0])), np.zeros(3))
    method = Midpoint(Exponential(Q))
    found = solve(SLEW, start, end, 20.0, method=method, steps=20, max_iterations=2, throw=False)
    assert found.result.startswith("The iteration limit")
    assert ("check that angles and rates are in radians" in found.result) == (rate > 2)


def test_messages_and_reports_name_factors_by_their_labels():
    method, rest = Midpoint(Cayley(Q)), np.zeros(3)
    for end, words in (
        ((1.1 * np.eye(3), rest), "end, attitude: not on"),
        ((np.eye(4), rest), r"end, attitude: .*got \(4, 4\)"),
        ((np.eye(3), np.full(3, np.nan)), "end, body rate: .*NaN"),
    ):
        with pytest.raises(NotOnManifoldError, match=words):
            solve(SLEW, (np.eye(3), rest), end, 1.0, method=method, steps=3)
    turned = (rotation([0.3, 0.1, 0.2]), rest)
    for horizon in (1.0, Free(1.0, 0.9, 1.1)):
        found = solve(SLEW, (np.eye(3), rest), turned, horizon, method=method, steps=3)
        assert list(found.body_costates) == list(found.spatial_costates) == ["attitude, SO(3)"]
        for named in (found.momenta, found.checks.conserved, found.checks.momentum_spreads):
            assert list(named) == ["attitude, SO(3)", "body rate, R^3"]
        assert {name.partition(":")[0] for name in found.checks.violations} == {"attitude"}
    text = str(solve(SLEW, (np.eye(3), rest), turned, 1.0, method=method, steps=3))
    assert "factor" not in text.replace("factors=(", "")
    for words in ("attitude, SO(3): 21.44 degrees", "attitude: max |x'x - I|", "spatial covector  attitude, SO(3)"):
        assert words in text
