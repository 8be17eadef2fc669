"""Guesses on which no control is felt, or that lie far from any flight: skips through the atmosphere, and glides."""

from typing import Any

import casadi as ca
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Solver
from retrax.manifolds import Euclidean, Product
from retrax.retractions import Midpoint, default_retraction

STEPS = 60
LINE = Euclidean(1)
EARTH, PULL, HIGH, DENSE = 6378e3, 3.986e14, 7.2e3, 1.225  # m, m^3/s^2, m, kg/m^3
LENGTH, SPEED, TIME = 1e5, 7.8e3, 100.0
THERMAL, WIDE, DRAG, POLAR, MASS, WING, AIR, GRAVITY = 2.5, 100.0, 0.034, 0.069662, 100.0, 14.0, 1.13, 9.80665


def skip(xp: Any, x: list, u: Any) -> list:
    """Height, speed and slope of a lifting body, of 300 kg on a square metre."""
    height, speed, slope = LENGTH * x[0], SPEED * x[1], x[2]
    force, far = DENSE * xp.exp(-height / HIGH) * speed**2 / 600, EARTH + height
    pull = PULL / far**2
    return [
        speed * xp.sin(slope) * TIME / LENGTH,
        (-force * (0.1 + 1.1 * u**2) - pull * xp.sin(slope)) * TIME / SPEED,
        (force * u / speed - (pull / speed - speed / far) * xp.cos(slope)) * TIME,
    ]


def glide(xp: Any, x: list, u: Any) -> list:
    """Distance, height and their rates, in a thermal: R. Bulirsch et al., in Optimal Control, Birkhaeuser 1993."""
    along = (100.0 * x[0] / WIDE - 2.5) ** 2
    forward, up = 10.0 * x[2], 10.0 * x[3] - THERMAL * (1 - along) * xp.exp(-along)
    size = xp.sqrt(forward**2 + up**2)
    lift, drag = (AIR * WING * size**2 / 2 * c for c in (u, DRAG + POLAR * u**2))
    sin, cos = up / size, forward / size
    return [x[2], x[3], (-lift * sin - drag * cos) / MASS, (lift * cos - drag * sin) / MASS - GRAVITY]


def solver(rates: Any, count: int, bounds: tuple, last: int, weight: float) -> Solver:
    """The largest last value of a state, with a small cost of the control."""
    space = Product(*[LINE] * count)
    problem = OptimalControlProblem(
        space,
        lambda q, u: tuple(jnp.stack([v]) for v in rates(jnp, [x[0] for x in q], u[0])),
        lambda q, u: weight * u @ u,
        1,
        terminal_cost=lambda q: -q[last][0],
        control_bounds=bounds,
    )
    return Solver(problem, Midpoint(default_retraction(space)), STEPS)


def by_ipopt(rates: Any, given: tuple, first: tuple[np.ndarray, float], last: int, horizon: Free) -> float:
    """The least cost that IPOPT finds for the same points in the middle of the steps.

    ``given``: starts, ends, bounds, and the weight of the control; ``first``: states and controls of a guess.
    """
    (start, end, (low, high), weight), (states, control) = given, first
    count, opti = len(start), ca.Opti()
    x, u, duration = opti.variable(count, STEPS), opti.variable(1, STEPS), opti.variable()
    h = duration / STEPS
    ends = [h / 2 * ca.vertcat(*rates(ca, [x[i, k] for i in range(count)], u[k])) for k in range(STEPS)]
    for k in range(STEPS - 1):
        opti.subject_to(x[:, k] + ends[k] == x[:, k + 1] - ends[k + 1])
    reached = x[:, -1] + ends[-1]
    for place, values in ((x[:, 0] - ends[0], start), (reached, end)):
        for i, value in enumerate(values):
            if value is not None:
                opti.subject_to(place[i] == value)
    opti.subject_to(opti.bounded(low, u, high))
    opti.subject_to(opti.bounded(horizon.lower, duration, horizon.upper))
    opti.minimize(weight * h * ca.sumsqr(u) - reached[last])
    opti.set_initial(x, states.T)
    opti.set_initial(u, control)
    opti.set_initial(duration, horizon.guess)
    opti.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"})
    return float(opti.solve().value(opti.f))


def parts(values: tuple) -> tuple:
    return tuple(None if value is None else np.array([value]) for value in values)


SLOPES = [-1.5, -2.0, -2.5, -3.0, -4.0]


@pytest.fixture(scope="module")
def skipping():
    return solver(skip, 3, (-0.7, 0.7), 1, 1e-3)


@pytest.mark.parametrize(
    ("degrees", "duration"),
    [
        pytest.param(slope, t, marks=[] if (slope, t) in ((-2.0, 3.0), (-3.0, 4.0)) else pytest.mark.slow)
        for slope in SLOPES
        for t in (2.0, 3.0, 4.0, 8.0)
        if (slope, t) != (-4.0, 4.0)  # it falls to the ground, and no other search finds a skip
    ],
)
def test_a_skip_through_the_atmosphere_is_found_from_a_constant_height(skipping, degrees, duration):
    """At the height where it enters no control is felt: the states to which the controls lead dive to where they
    are."""
    start, end, horizon = (1.0, 1.2, np.deg2rad(degrees)), (1.0, None, None), Free(duration, 1.0, 30.0)
    found = skipping.solve(parts(start), parts(end), horizon, throw=False, max_iterations=150)
    assert found.success, found.result
    # IPOPT from a guess that dives and rises, as from the constant height.
    s = (np.arange(STEPS) + 0.5) / STEPS
    near = np.stack([1 + 0 * s, 1.2 + 0 * s, start[2] * (1 - 2 * s)], 1), 0.0
    least = by_ipopt(skip, (start, end, (-0.7, 0.7), 1e-3), near, 1, horizon)
    assert found.cost == pytest.approx(least, rel=1e-6)


@pytest.fixture(scope="module")
def gliding():
    return solver(glide, 4, (0.0, 1.4), 0, 0.0)


@pytest.mark.parametrize(
    ("end", "control", "duration"),
    [
        pytest.param(x, u, t, marks=[] if (u, t) in ((0.7, 10.0),) else pytest.mark.slow)
        for x, u in ((None, 0.0), (None, 0.7), (12.5, 0.0))
        for t in (5.0, 8.0, 10.0, 12.0)
    ],
)
def test_a_glider_flies_farthest_from_poor_guesses(gliding, end, control, duration):
    """Guessed where it starts, or evenly to a guessed end, with no lift or some."""
    start, horizon = (0.0, 10.0, 1.32275675, -0.128750052), Free(duration, 0.01, 20.0)
    s = ((np.arange(STEPS) + 0.5) / STEPS)[:, None]
    states = np.hstack([(end or 0.0) * s, 10 - s, start[2] + 0 * s, start[3] + 0 * s])
    guess = Guess(tuple(states[:, i, None] for i in range(4)), np.full((STEPS, 1), control))
    found = gliding.solve(parts(start), parts((None, 9.0, *start[2:])), horizon, guess=guess, throw=False)
    assert found.success, found.result
    assert found.cost == pytest.approx(-12.4730366, rel=1e-7)  # IPOPT, from each of these guesses
