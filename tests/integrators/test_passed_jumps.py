"""Hamiltonians that jump along a trajectory, or whose derivatives do not tell of their values: no success without a
word."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import (
    Composition,
    OptimalControlProblem,
    PresymplecticIntegrator,
    Result,
    SymplecticIntegrator,
    classify,
    integrate,
    integrate_many,
    load_trajectory,
    solve,
)
from retrax.integrators.problem_checks.smoothness.hamiltonian_jumps import PassedJump
from retrax.integrators.problem_checks.smoothness.step_primitives import with_margins
from retrax.manifolds import ConvergenceError, Euclidean, InvalidInputError
from retrax.retractions import Addition, CotangentLift, Exponential, Gauss, Midpoint, Projection

from .problems import SPHERE, pendulum_energy

LINE, PLANE = Euclidean(1), Euclidean(2)
METHOD = SymplecticIntegrator(CotangentLift(Midpoint(Addition(LINE))))
START = np.zeros(1), np.array([0.6])


class Step(eqx.Module):
    """A pendulum's energy with a step of some height, a kink of some slope there, and a factor on all of it."""

    height: Array
    kink: Array
    unit: Array

    def __call__(self, q: Array, p: Array) -> Array:
        beyond = jnp.where(q[0] > 0.3, self.height + self.kink * (q[0] - 0.3), 0.0)
        return self.unit * (p @ p / 2 - jnp.cos(q[0]) + beyond)


def step(height: float, kink: float = 0.0, unit: float = 1.0) -> Step:
    return Step(*map(jnp.asarray, (height, kink, unit)))


@pytest.mark.parametrize("unit", [pytest.param(1e-9, marks=pytest.mark.slow), 1e9])
def test_a_jump_of_the_hamiltonian_is_seen_from_a_height_on(unit):
    heights = [0.0, 1e-14, 1e-7, 1e-4, -1.0]
    found = [integrate(step(h, unit=unit), METHOD, START, 0.05 / unit, 40, throw=False) for h in heights]
    assert [path.result == Result.jump for path in found] == [abs(h) > 2e-6 for h in heights]
    assert {int(path.failed_step) for path in found} == {-1, 10}  # 0.3 is between t = 0.5 and 0.55


def test_a_kink_is_no_jump_and_a_jump_beside_the_trajectory_is_none():
    assert integrate(step(0.0, kink=0.3), METHOD, START, 0.05, 40).result == Result.successful
    assert integrate(step(1.0), METHOD, START, 0.05, 10).result == Result.successful
    back = START[0], -START[1]
    assert integrate(step(1.0), METHOD, back, 0.05, 10).result == Result.successful


class Window(eqx.Module):
    """A pendulum's energy with another value in a window of the angle."""

    place: Array
    width: Array

    def __call__(self, q: Array, p: Array) -> Array:
        return p @ p / 2 - jnp.cos(q[0]) + jnp.where(jnp.abs(q[0] - self.place) < self.width, 0.1, 0.0)


@pytest.mark.parametrize("width", [0.0, 1e-9, 1e-4, 1e-2])
@pytest.mark.usual(1)
def test_a_window_between_two_nodes_is_passed(width):
    """The place moves through the angles, of which the pendulum reaches the first ones alone, and beyond its ends."""
    smooth = integrate(step(0.0), METHOD, START, 0.05, 20)
    last = float(smooth.q[-1, 0])
    for place in (-0.3, 0.021, 0.1, 0.2501, 0.4, last - 0.02, last + 0.02, 0.9):
        found = integrate(Window(jnp.asarray(place), jnp.asarray(width)), METHOD, START, 0.05, 20, throw=False)
        assert (found.result == Result.jump) == (width > 0 and 0 < place < last), place


@pytest.mark.slow
def test_jumps_on_the_sphere_are_seen():
    def energy(q: Array, p: Array, height: float) -> Array:
        return pendulum_energy(q, p) + jnp.where(q[1] > 0.3, height, 0.0)

    method, start = (
        SymplecticIntegrator(Gauss(2, Projection(SPHERE))),
        (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.3])),
    )
    for height in (0.0, 1e-8, 1e-3, 1.0):
        path = integrate(lambda q, p, height=height: energy(q, p, height), method, start, 0.05, 40, throw=False)
        assert (path.result == Result.jump) == (height > 1e-6)


def test_the_error_names_the_place_and_the_record_keeps_the_result(tmp_path):
    with pytest.raises(
        ConvergenceError, match=r"(?s)step 10, from t = 0.5: the Hamiltonian jumps by 0.5 .*a comparison"
    ):
        integrate(step(0.5), METHOD, START, 0.05, 40)
    path = integrate(step(0.5), METHOD, START, 0.05, 40, save_every=4, throw=False)
    assert path.failed_step == 8  # the first of the four between two nodes
    path.save(tmp_path / "path.npz")
    assert load_trajectory(tmp_path / "path.npz").result == Result.jump


def test_each_member_of_a_batch_has_a_result_of_its_own():
    covectors = np.array([[0.6], [0.1], [-0.1], [1.2]])
    batch = integrate_many(step(0.5), METHOD, (np.zeros((4, 1)), covectors), 0.05, 40)
    singles = [integrate(step(0.5), METHOD, (START[0], p), 0.05, 40, throw=False) for p in covectors[:2]]
    assert list(batch.failed_step) == [*(path.failed_step for path in singles), -1, 5] == [10, -1, -1, 5]
    assert np.array_equal(jax.vmap(lambda r: r == Result.jump)(batch.result), batch.failed_step >= 0)


@jax.custom_jvp
def beyond(x: Array) -> Array:
    """How many whole numbers from 0 on are below a number, counted in a loop of unknown length."""
    return jax.lax.while_loop(lambda n: n < x, lambda n: n + 1.0, jnp.zeros_like(x))


beyond.defjvp(lambda primals, tangents: (beyond(*primals), jnp.zeros_like(*primals)))


def test_a_jump_is_seen_that_a_loop_of_unknown_length_decides():
    """Its margin changes the sign where the number of rounds changes."""
    margins = [with_margins(beyond, jnp.asarray(x))[1].values for x in (-0.1, 0.1, 0.9, 1.1, 1.9, 2.1)]
    assert np.sign(margins).ravel().tolist() == [1, -1, -1, 1, 1, -1]
    np.testing.assert_allclose(np.abs(margins), 0.1, atol=1e-15)
    for height in (0.0, 0.5):
        energy = lambda q, p, h=height: p @ p / 2 - jnp.cos(q[0]) + h * beyond(q[0] / 0.3 - 1)  # noqa: E731
        path = integrate(energy, METHOD, START, 0.05, 20, throw=False)
        assert (path.result == Result.jump, int(path.failed_step)) == ((True, 10) if height else (False, -1))


def test_of_many_segments_each_is_looked_at():
    """More than a chunk of them, and more jumps than a chunk."""
    starts = np.zeros((400, 1)), np.linspace(0.55, 0.65, 400)[:, None]
    batch = integrate_many(step(0.5), METHOD, starts, 0.05, 20)
    one = integrate(step(0.5), METHOD, (starts[0][-1], starts[1][-1]), 0.05, 20, throw=False)
    assert np.all(batch.failed_step >= 0)
    assert batch.failed_step[-1] == one.failed_step


@pytest.mark.parametrize("time", [0.1, 0.513, 0.9])
def test_a_switch_in_a_time_that_is_a_coordinate_is_integrated_in_two_parts(time):
    """The message says so, and both parts together are as accurate as the method."""

    def energy(q: Array, p: Array, switched: Array) -> Array:
        return p[0] ** 2 / 2 + q[0] ** 2 / 2 + p[1] + jnp.where(switched, 1.0 + q[0], 0.0)

    method, start = SymplecticIntegrator(Gauss(2, Addition(PLANE))), (np.zeros(2), np.array([1.0, 0.0]))
    with pytest.raises(ConvergenceError, match="for a step in time, integrate until then and from there on"):
        integrate(lambda q, p: energy(q, p, q[1] > time), method, start, 0.05, 20)
    first = integrate(lambda q, p: energy(q, p, False), method, start, time / 20, 20)
    last = integrate(lambda q, p: energy(q, p, True), method, (first.q[-1], first.p[-1]), (1 - time) / 20, 20)
    after, away = 1 - time, np.sin(time) + 1  # from the point of rest -1 of the second part
    expected = away * np.cos(after) + np.cos(time) * np.sin(after) - 1
    np.testing.assert_allclose(last.q[-1], [expected, 1.0], atol=1e-7)


@pytest.mark.slow
def test_extremals_and_compositions_are_looked_at_too():
    def problem(height: float) -> OptimalControlProblem:
        price = lambda q, u: u @ u / 2 + height * jnp.where(q[0] > 0.5, 1.0, 0.0)  # noqa: E731
        return OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), price, 1)

    start = np.array([0.0, 1.0]), np.array([0.1, 0.6])
    inner = PresymplecticIntegrator(CotangentLift(Midpoint(Addition(PLANE))))
    for method in (inner, Composition(inner), PresymplecticIntegrator(Gauss(2, Addition(PLANE)))):
        for height in (0.0, 1.0):
            path = integrate(problem(height), method, start, 0.05, 20, throw=False)
            assert (path.result == Result.jump) == (height > 0)


STOPPED = {
    "states": lambda q, p, c: p @ p / 2 + (1 - c) * jnp.sin(q[0]) + c * jax.lax.stop_gradient(jnp.sin(q[0])),
    "momenta": lambda q, p, c: (1 - c) * p @ p / 2 + c * jax.lax.stop_gradient(p) @ p / 2 + q[0],
}


class Stopped(eqx.Module):
    """A Hamiltonian of which a share of the derivative is hidden."""

    about: str = eqx.field(static=True)
    share: Array

    def __call__(self, q: Array, p: Array) -> Array:
        return STOPPED[self.about](q, p, self.share)


@pytest.mark.parametrize("about", STOPPED)
def test_a_hidden_derivative_is_refused_from_a_share_on(about):
    for share in (0.0, 1e-12, 1e-4, 1.0):
        if share < 1e-8:
            METHOD.check(Stopped(about, jnp.asarray(share)), *START)
        else:
            with pytest.raises(InvalidInputError, match=f"the Hamiltonian changes with the {about} .*stop_gradient"):
                METHOD.check(Stopped(about, jnp.asarray(share)), *START)


class Priced(eqx.Module):
    """The running cost of the problem of Aly and Chan, with a step."""

    height: Array

    def __call__(self, q: tuple[Array, Array], u: Array) -> Array:
        return (q[1][0] ** 2 - q[0][0] ** 2) / 2 + self.height * jnp.where(q[0][0] > 0.6, 1.0, 0.0)


@pytest.mark.slow
def test_singular_problems_are_looked_at_too():
    """From zero to below the step, and to beyond it."""
    pair = LINE * LINE
    for height in (1e-9, 1.0):
        problem = OptimalControlProblem(pair, lambda q, u: (q[1], u), Priced(jnp.asarray(height)), 1)
        c = classify(problem, starts=8)
        assert (c.jump != "") == (height > 1e-6) == ("JUMP" in str(c))
        for end in (0.5, 1.0):
            ends = (np.zeros(1), None), (np.full(1, end), None)
            found = solve(
                problem, *ends, 1.0, method=Midpoint(Exponential(pair)), steps=8, classification=c, throw=False
            )
            passes = height > 1e-6 and end > 0.6
            assert found.success != passes
            assert ("the Hamiltonian jumps by -1 where" in found.result) == passes


def test_singular_problems_with_hidden_derivatives_are_refused():
    def price(q: Array, u: Array) -> Array:
        return (q[1] ** 2 - jax.lax.stop_gradient(q[0]) * q[0]) / 2

    with pytest.raises(InvalidInputError, match="running_cost changes with the states at another rate"):
        classify(OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), price, 1))


def test_a_jump_is_named_with_six_digits_of_its_place():
    words = PassedJump(0, -1.0, np.array([1 / 3, 2.0]), ["jnp.floor"]).fact("at")
    assert words.startswith("the Hamiltonian jumps by -1 at q = [0.333333 2.      ]: it computes jnp.floor from")
