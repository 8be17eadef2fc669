"""The length of a pendulum, fitted to measured places of its mass: on a circle times a length, as
`scipy.optimize.least_squares` finds it, and not by an equation that is written as two inequalities."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Phase, solve_phases
from retrax.manifolds import Euclidean, Product, Sphere
from retrax.retractions import Addition, Exponential, Gauss
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

GRAVITY, HORIZON, COUNT, STEPS = 9.81, 1.5, 7, 4
TIMES = np.linspace(0.0, HORIZON, COUNT)
SPACE = Product(Sphere(1), Euclidean(2))  # the direction of the rod; its rate and length


def angles(length, angle, rate):
    """Angles and their rates at the times, from the first."""
    options = {"t_eval": TIMES, "rtol": 1e-11, "atol": 1e-12}
    return solve_ivp(lambda _, z: [z[1], -GRAVITY / length * np.sin(z[0])], (0, HORIZON), [angle, rate], **options).y


def swung(length, angle, rate):
    """Places of the mass at the times, from the angle and its rate at first."""
    found, _ = angles(length, angle, rate)
    return length * np.stack([np.sin(found), -np.cos(found)], axis=1)


def swinging(q, u):
    rod, (rate, length) = q
    return rate * jnp.stack([-rod[1], rod[0]]), jnp.stack([-GRAVITY / length * rod[0], 0 * length])


def fitted(places, method, length, rolled):
    """The solution from the length and the rod at rest, or as it swings from there, a phase between each two
    measurements."""
    each = [
        (np.array([np.sin(angle), -np.cos(angle)]), np.array([rate, length]))
        for angle, rate in angles(length, 0.8, 0.0).T
    ]
    start = each[0]

    def missed(k):
        return lambda q: jnp.sum((q[1][1] * q[0] - places[k]) ** 2) / 2

    phases = []
    for k in range(COUNT - 1):
        first = {"initial_cost": missed(0)} if k == 0 else {}
        problem = OptimalControlProblem(SPACE, swinging, lambda q, u: 0.0, 0, terminal_cost=missed(k + 1), **first)
        stages = STEPS * method.stages
        none = np.zeros((stages, 0))
        guess = Guess(tuple(np.tile(leaf, (stages, 1)) for leaf in start), none)
        if rolled:
            guess = Guess.from_controls(problem, method, each[k], none, TIMES[1], STEPS)
        begin = tuple(map(Free, start)) if k == 0 else None
        phases.append(Phase(problem, method, STEPS, TIMES[1], start=begin, guess=guess))
    return solve_phases(phases)


@pytest.mark.slow
@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize("noise", [0.0, 1e-2])
@pytest.mark.parametrize(
    ("length", "rolled"),
    [
        *((length, False) for length in (0.5, 1.0, 2.0, 2.5, 3.0)),
        *((length, True) for length in (0.5, 1.0, 2.0, 3.0)),
    ],
)
def test_a_length_is_fitted_on_a_circle(length, rolled, noise, stages):
    places = swung(1.3, 1.0, 0.3) + noise * np.random.default_rng(0).standard_normal((COUNT, 2))
    judge = least_squares(lambda z: (swung(*z) - places).ravel(), [1.0, 0.8, 0.0], xtol=1e-14, gtol=1e-14)
    found = fitted(places, Gauss(stages, Exponential(SPACE)), length, rolled)
    rod, (rate, own) = (leaf[0] for leaf in found.phases[0].states)
    assert found.cost == pytest.approx(judge.cost, rel=1e-4, abs=1e-11)
    np.testing.assert_allclose([own, np.arctan2(rod[0], -rod[1]), rate], judge.x, rtol=1e-5, atol=1e-5)


def test_an_equation_as_two_inequalities_is_named():
    """A rod in the places of its mass, of a length that is free, with the tension as a control: nothing is inside of
    both inequalities."""
    space = Euclidean(5)

    def pulled(q, u):
        return jnp.stack([q[2], q[3], -u[0] * q[0], -u[0] * q[1] - GRAVITY, 0 * q[4]])

    def stretched(q, u):
        return q[:2] @ q[:2] - q[4] ** 2

    rod = {"no longer": stretched, "no shorter": lambda q, u: -stretched(q, u)}
    end = swung(1.3, 1.0, 0.3)[-1]
    problem = OptimalControlProblem(
        space, pulled, lambda q, u: u @ u, 1, terminal_cost=lambda q: jnp.sum((q[:2] - end) ** 2), constraints=rod
    )
    start = Free(np.array([np.sin(0.8), -np.cos(0.8), 0.0, 0.0, 1.0]))
    found = solve_phases(
        [Phase(problem, Gauss(2, Addition(space)), 10, HORIZON, start=start)], max_iterations=40, throw=False
    )
    assert not found.success
    assert "no longer and no shorter hold the trajectory" in found.result
    assert "try to leave room between them, or to write an equation into the dynamics" in found.result
