"""Controls that are held between samples: against exact discrete problems, and against propagation of the controls."""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
import retrax as rx
from retrax.manifolds import InvalidInputError
from scipy.integrate import solve_ivp
from scipy.linalg import expm

A, B = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.0], [1.0]])
PRICE = 0.1  # of the control
FIRST = np.array([1.0, 0.0])
STEP, STEPS = 0.2, 15
INERTIA = np.array([1.0, 2.0, 3.0])
BODY = rx.SO(3)


def oscillator(**more):
    """A damped oscillator with a quadratic cost."""
    return rx.OptimalControlProblem(
        rx.Euclidean(2), lambda q, u: A @ q + B @ u, lambda q, u: (q @ q + PRICE * u @ u) / 2, controls=1, **more
    )


def least_cost_of_samples():
    """The optimum of the oscillator with controls that are constant between samples, by Riccati's recursion on the
    exact transition [Van Loan 1978]."""
    motion, weights = np.zeros((3, 3)), np.diag([1.0, 1.0, PRICE])
    motion[:2] = np.hstack([A, B])
    both = expm(np.block([[-motion.T, weights], [np.zeros((3, 3)), motion]]) * STEP)
    transition = both[3:, 3:]
    cost = transition.T @ both[:3, 3:]
    a, b = transition[:2, :2], transition[:2, 2:]
    p = np.zeros((2, 2))
    for _ in range(STEPS):
        cross = a.T @ p @ b + cost[:2, 2:]
        p = cost[:2, :2] + a.T @ p @ a - cross @ np.linalg.solve(cost[2:, 2:] + b.T @ p @ b, cross.T)
    return FIRST @ p @ FIRST / 2


def test_constant_controls_are_those_of_the_exact_discrete_regulator():
    """The error falls as the fourth power of the length of a Runge-Kutta step."""
    errors = []
    for substeps in (1, 2, 4):
        held = rx.hold_controls(oscillator(), STEP, substeps=substeps)
        found = rx.solve(held, FIRST, None, STEP * STEPS, steps=STEPS)
        assert found.status == "minimum"
        errors.append(abs(found.cost - least_cost_of_samples()))
    assert errors[0] < 1e-4
    assert all(16 * 0.8 < first / then < 16 * 1.5 for first, then in pairwise(errors))


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.slow
def test_rates_and_bounds_hold_and_a_small_enough_rate_costs_more(order):
    """A sweep of the rate through the one that the optimum without a limit has."""
    costs = []
    for rate in (0.5, 1.0, 2.0, 4.0, 1e3):
        held = rx.hold_controls(oscillator(control_bounds=(-0.3, 0.9)), STEP, order=order, rate_limits=rate, substeps=2)
        found = rx.solve(held, (FIRST, np.zeros(1)), None, STEP * STEPS, steps=STEPS)
        assert found.status == "minimum"
        control = found.states[1][:, 0]
        np.testing.assert_allclose(np.diff(control), STEP * found.controls[:, 0], atol=1e-12)
        assert np.all((control < 0.9 + 1e-9) & (control > -0.3 - 1e-9))
        assert np.max(np.abs(np.diff(control))) < rate * STEP + 1e-9
        costs.append(found.cost)
    assert costs[0] > costs[1] > costs[2] > costs[3] - 1e-12 > costs[4] - 2e-12


def rigid_body(**more):
    def dynamics(q, u):
        turn, rate = q
        return turn @ rx.hat(rate), (u - jnp.cross(rate, INERTIA * rate)) / INERTIA

    manifold = rx.manifolds.Product(BODY, rx.Euclidean(3))
    return rx.OptimalControlProblem(manifold, dynamics, lambda q, u: u @ u / 2, controls=3, **more)


def turned(angle):
    return np.asarray(expm(np.asarray(rx.hat(np.array([0.3, -0.5, 0.8]) * angle))))


def signal_of(found, order):
    """The torques as a function of the sample and the time after it."""
    torques, rates = found.states[1], found.controls
    return (lambda k, t: torques[k] + t * rates[k]) if order else (lambda k, t: torques[k + 1])


def flown(start, signal, horizon, step):
    """The state of the body after a time under torques, by an integrator of SciPy, sample by sample."""

    def rates(t, y, k):
        turn, rate = y[:9].reshape(3, 3), y[9:]
        torque = signal(k, t)
        return np.concatenate(
            [(turn @ np.asarray(rx.hat(rate))).ravel(), (torque - np.cross(rate, INERTIA * rate)) / INERTIA]
        )

    y = np.concatenate([start[0].ravel(), start[1]])
    for k in range(round(horizon / step)):
        y = solve_ivp(rates, (0.0, step), y, "DOP853", rtol=1e-12, atol=1e-12, args=(k,)).y[:, -1]
    return y[:9].reshape(3, 3), y[9:]


@pytest.mark.slow
@pytest.mark.parametrize("order", [0, 1])
def test_the_body_arrives_under_the_torques_that_were_found(order):
    """On SO(3) x R^3; with twice as many Runge-Kutta steps it arrives sixteen times as near."""
    begin, end = (np.eye(3), np.zeros(3)), (turned(1.2), np.zeros(3))
    misses = []
    for substeps in (1, 2):
        held = rx.hold_controls(rigid_body(), 0.5, order=order, rate_limits=3.0, substeps=substeps)
        found = rx.solve(held, (begin, np.zeros(3)), (end, None), 4.0, steps=8)
        assert found.status == "minimum"
        turn, rate = flown(begin, signal_of(found, order), 4.0, 0.5)
        misses.append(np.linalg.norm(turn - end[0]) + np.linalg.norm(rate))
    assert misses[0] < 1e-2
    assert 8 < misses[0] / misses[1] < 32


def test_functions_with_time_and_parameters_are_those_at_the_time_within_the_sample():
    """The same problem with the time as a state of its own."""
    timed = rx.OptimalControlProblem(
        rx.Euclidean(1),
        lambda q, u, t, p: p * jnp.cos(t) * u,
        lambda q, u, t: (u @ u + (q - jnp.sin(t)) @ (q - jnp.sin(t))) / 2,
        controls=1,
        time_dependent=True,
    )
    clocked = rx.OptimalControlProblem(
        rx.Euclidean(2),
        lambda x, u: jnp.stack([1.5 * jnp.cos(x[1]) * u[0], 1.0]),
        lambda x, u: (u @ u + (x[0] - jnp.sin(x[1])) ** 2) / 2,
        controls=1,
    )
    one = rx.solve(rx.hold_controls(timed, 0.25), np.ones(1), None, 2.0, steps=8, parameters=1.5)
    two = rx.solve(rx.hold_controls(clocked, 0.25), np.array([1.0, 0.0]), None, 2.0, steps=8)
    assert one.status == two.status == "minimum"
    np.testing.assert_allclose(one.cost, two.cost, rtol=1e-10)
    np.testing.assert_allclose(one.controls, two.controls, atol=1e-9)


def test_constraints_and_costs_are_of_the_state_without_the_control():
    """Limits at the samples, a condition between the ends, and costs of ends and nodes."""
    problem = oscillator(
        constraints={"power": lambda q, u: q[1] * u[0] - 0.05},
        node_constraints={"speed": lambda q: q[1] ** 2 - 0.16},
        boundary_constraints={"half": lambda first, last: last[0] - first[0] / 2},
        terminal_cost=lambda q: 3.0 * q @ q,
        node_cost=lambda q, k: 0.1 * q[0] ** 2,
    )
    found = rx.solve(
        rx.hold_controls(problem, STEP, order=1), (FIRST, rx.Free(np.zeros(1))), None, STEP * STEPS, steps=STEPS
    )
    assert found.success
    (q, w), v = found.states, found.controls
    assert np.max(np.abs(q[:, 1])) < 0.4 + 1e-9
    assert np.max(q[:-1, 1] * w[:-1, 0]) < 0.05 + 1e-9
    assert abs(q[-1, 0] - 0.5) < 1e-10
    np.testing.assert_allclose(np.diff(w, axis=0), STEP * v, atol=1e-12)


@pytest.mark.parametrize("ratio", [0.5, 1 - 1e-6, 1.0, 1 + 1e-6, 2.0])
def test_only_steps_of_the_sample_time_are_taken(ratio):
    held = rx.hold_controls(oscillator(), STEP)
    if ratio == 1.0:
        assert rx.solve(held, FIRST, None, STEP * STEPS, steps=STEPS).success
        return
    with pytest.raises(InvalidInputError, match=r"each control is held for 0\.2"):
        rx.solve(held, FIRST, None, ratio * STEP * STEPS, steps=STEPS)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"steps": None}, "a step for each sample"),
        ({"accuracy": 1e-3}, "a step for each sample"),
        ({"horizon": rx.Free(3.0)}, "free horizon"),
        ({"method": rx.Midpoint(rx.default_retraction(rx.Euclidean(2)))}, "Euler map of its retraction"),
    ],
)
def test_a_solve_that_would_have_other_steps_is_refused(changes, words):
    given = {"horizon": STEP * STEPS, "steps": STEPS, "method": None} | changes
    with pytest.raises(InvalidInputError, match=words):
        rx.solve(rx.hold_controls(oscillator(), STEP), FIRST, None, **given)


@pytest.mark.parametrize("before", [-0.5, -0.3, 0.9, 1.0])
@pytest.mark.usual(1)
def test_the_control_before_a_constant_one_may_be_beyond_its_bounds(before):
    """A sweep of the control that acted before the horizon through both bounds."""
    held = rx.hold_controls(oscillator(control_bounds=(-0.3, 0.9)), STEP, rate_limits=[4.0])
    found = rx.solve(held, (FIRST, np.array([before])), None, STEP * STEPS, steps=STEPS)
    applied = found.states[1][1:, 0]
    assert found.status == "minimum"
    assert np.all((applied < 0.9 + 1e-9) & (applied > -0.3 - 1e-9))


HELD = rx.hold_controls(oscillator(), STEP)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: rx.simulate(HELD, lambda q, t: np.zeros(1), start=FIRST, horizon=1.0, sample_time=0.1), "simulation"),
        (lambda: rx.tracking(HELD, lambda t: jnp.zeros(2)), "hold_controls"),
        (lambda: rx.Guess.from_controls(HELD, HELD.sampling.method, FIRST, np.zeros(1), 3.0, STEPS), "held controls"),
        (lambda: rx.classify(HELD), "held controls"),
        (
            lambda: rx.RecedingHorizon(rx.Solver(HELD, HELD.sampling.method, STEPS), end=None, end_time=3.0),
            "one duration",
        ),
        (
            lambda: rx.Solver(HELD, HELD.sampling.method, STEPS).solve_many(np.stack([FIRST] * 2), None, [3.0, 3.1]),
            "is 0",
        ),
    ],
)
def test_what_takes_the_dynamics_as_a_differential_equation_refuses_held_controls(call, words):
    with pytest.raises(InvalidInputError, match=words):
        call()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"problem": 1}, "takes an OptimalControlProblem"),
        ({"problem": rx.hold_controls(oscillator(), 0.1)}, "are held already"),
        ({"problem": oscillator(periodic=True), "order": 1}, "is periodic"),
        ({"sample_time": -0.1}, "positive finite time"),
        ({"order": 2}, "order must be 0"),
        ({"substeps": 0}, "at least 1"),
        ({"rate_limits": 0.0}, "positive number"),
        ({"rate_limits": [1.0, 2.0]}, "positive number"),
        ({"rate_limits": np.nan}, "positive number"),
        ({"retraction": rx.Cayley(BODY)}, "a retraction of"),
    ],
)
def test_wrong_arguments_are_named(changes, words):
    with pytest.raises(InvalidInputError, match=words):
        rx.hold_controls(**{"problem": oscillator(), "sample_time": STEP} | changes)
