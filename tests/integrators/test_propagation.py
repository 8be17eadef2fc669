"""The error of a discrete solution: beside SciPy's DOP853 in the ambient space, from rounding to errors of a radian."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, discretization_error, solve
from retrax.integrators.boundary_value.audit.discretization_error import DiscretizationError, Propagator, _AtOnce
from retrax.integrators.boundary_value.solution.factor_distances import factor_distances
from retrax.manifolds import SE, SO, DomainError, Euclidean, Power, Product, Sphere, hat
from retrax.retractions import Cayley, Exponential, Gauss, Projection
from scipy.integrate import solve_ivp
from scipy.special import roots_legendre

from .problems import RIGID, half_square, rotation

INERTIA = np.array([1.0, 1.7, 2.3])
TIMES = np.array([0.0, 0.2, 0.5, 0.7, 1.1, 1.4, 1.5])  # unequal steps
SO3, S2, NAMES = SO(3), Sphere(2), ["factor 0, SO(3)", "factor 1, R^3"]


def body(q: tuple, u: Any) -> tuple:
    """A rigid body under a torque."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def body_through_eigenvalues(q: tuple, u: Any) -> tuple:
    """The same body; the torque comes back from LAPACK, which is no scalar operation."""
    return body(q, u * jnp.linalg.eigvalsh(jnp.eye(2))[0])


def torque(t: float, degree: int) -> np.ndarray:
    """A polynomial of time."""
    powers = t ** np.arange(degree + 1)
    return np.array([[0.7, -1.1, 0.4, 0.9], [-0.3, 0.8, 1.2, -0.7], [0.5, 0.2, -0.6, 1.1]])[:, : degree + 1] @ powers


def stage_times(times: np.ndarray, stages: int) -> np.ndarray:
    """The Gauss points of all steps."""
    places = (roots_legendre(stages)[0] + 1) / 2
    return (times[:-1, None] + np.diff(times)[:, None] * places).ravel()


def reference(field: Callable, start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """States at the nodes from SciPy, in the ambient space, one step after the other: controls may jump between
    them."""
    states = [start]
    for begin, end in pairwise(times):
        states.append(solve_ivp(field, (begin, end), states[-1], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1])
    return np.array(states)


def body_states(times: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Attitudes and rates of the body under the polynomial torque."""

    def field(t: float, y: np.ndarray) -> np.ndarray:
        attitude, rate = y[:9].reshape(3, 3), y[9:]
        momentum = INERTIA * rate
        return np.concatenate(
            [np.cross(attitude, rate[None]).ravel(), (torque(t, degree) - np.cross(rate, momentum)) / INERTIA]
        )

    y = reference(field, np.concatenate([rotation([0.4, -0.2, 0.1]).ravel(), [0.3, -0.5, 0.8]]), times)
    return y[:, :9].reshape(-1, 3, 3), y[:, 9:]


def problem(dynamics: Callable = body) -> OptimalControlProblem:
    return OptimalControlProblem(RIGID, dynamics, half_square, 3)


@pytest.fixture(scope="module")
def propagator() -> Propagator:
    return Propagator(problem(), Cayley(RIGID))


def body_error(propagator: Propagator, stages: int, states: tuple) -> DiscretizationError:
    """The error of these states under the polynomial torque, which the stages interpolate."""
    at = stage_times(TIMES, stages)
    return propagator.discretization_error(TIMES, states, at, np.array([torque(t, stages - 1) for t in at]))


@pytest.mark.parametrize("stages", [1, 2, 3, 4])
@pytest.mark.usual(1)
def test_states_off_by_known_distances(propagator: Propagator, stages: int) -> None:
    """From rounding to most of a turn: through the decision whether steps are propagated at once or one after the
    other."""
    attitudes, rates = body_states(TIMES, stages - 1)
    axis = np.array([2.0, -1.0, 2.0]) / 3
    for angle in (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.03, 0.1, 0.3, 1.0, 2.0, 3.0):
        growth = np.linspace(0, angle, len(TIMES))
        turned = np.stack([attitude @ rotation(a * axis) for attitude, a in zip(attitudes, growth, strict=True)])
        found = body_error(propagator, stages, (turned, rates + growth[:, None] * axis))
        for name in NAMES:
            off = np.abs(found.distances[name] - growth)
            assert np.max(off) <= found.resolution[name] + 1e-12
            assert found.resolution[name] <= max(0.01 * angle, 1e-13)


@pytest.mark.parametrize("parts", [1, 2, 8])
def test_steps_at_once_lead_where_they_lead_one_after_the_other(propagator: Propagator, parts: int) -> None:
    """From states that are off by more than rounding, where the first move is not the last one."""
    attitudes, rates = body_states(TIMES, 1)
    axis, at = np.array([2.0, -1.0, 2.0]) / 3, stage_times(TIMES, 2)
    for angle in (0.0, 1e-6, 1e-3, 0.1):
        growth = np.linspace(0, angle, len(TIMES))
        turned = np.stack([attitude @ rotation(a * axis) for attitude, a in zip(attitudes, growth, strict=True)])
        given = propagator._flat_steps(
            TIMES, (turned, rates + growth[:, None] * axis), at, np.array([torque(t, 1) for t in at]), None
        )
        found = _AtOnce(propagator, given)(parts)
        assert found is not None
        np.testing.assert_allclose(found, propagator.in_turn(given, parts), rtol=0, atol=1e-5 * angle + 1e-11)


@pytest.mark.parametrize("manifold", [S2, SO3], ids=str)
def test_states_that_jump(manifold: Any) -> None:
    """Up to the opposite point, from where the chord to the start has no tangential part."""
    still = OptimalControlProblem(manifold, lambda q, u: 0 * u[0] * q, half_square, 1)
    propagator = Propagator(still, Exponential(manifold))
    for angle in (0.0, 1e-9, 1e-3, 0.1, 0.5, 0.8, 1.0, 1.5, np.pi / 2, 1.6, 2.0, 3.0, 3.14, np.pi):
        turned = rotation([0.0, 0.0, angle])
        states = np.stack([np.eye(3), *[turned] * 6])
        points = states if manifold is SO3 else states[:, :, 0]
        found = propagator.discretization_error(TIMES, points, stage_times(TIMES, 1), np.zeros((6, 1)))
        off = np.abs(found.distances[str(manifold)] - np.array([0.0, *[angle] * 6]))
        assert np.max(off) <= found.resolution[str(manifold)] + 1e-12
        assert found.resolution[str(manifold)] <= 0.01 * angle


def test_its_own_error_is_bounded_by_the_resolution(propagator: Propagator) -> None:
    """Steps from short to so long that an explicit method of order 8 needs parts of them."""
    for stretch in (0.1, 1.0, 2.0, 5.0):
        times, at = stretch * TIMES, stretch * stage_times(TIMES, 2)
        states = body_states(times, 1)
        found = propagator.discretization_error(times, states, at, np.array([torque(t, 1) for t in at]))
        sizes = 1.0, np.max(np.abs(states[1]))
        for name, size in zip(NAMES, sizes, strict=True):
            # What is left is SciPy's: its tolerance, times the number of radians that the body turns.
            assert found.largest[name] <= found.resolution[name] + 1e-12 * size * (1 + stretch * sizes[1])


@pytest.mark.parametrize("stiffness", [1.0, 1e2, 1e4, 1e6])
def test_stiff_dynamics_are_resolved_or_said_not_to_be(stiffness: float) -> None:
    line = OptimalControlProblem(Euclidean(1), lambda q, u: stiffness * (u - q), half_square, 1)
    times = np.linspace(0, 1, 11)
    exact = 1 + np.exp(-stiffness * times)[:, None]
    found = Propagator(line, Exponential(Euclidean(1))).discretization_error(
        times, exact, times[:-1] + 0.05, np.ones((10, 1))
    )
    assert np.isinf(found.resolution["R^1"]) or found.largest["R^1"] <= found.resolution["R^1"] + 1e-13


def test_escape_to_infinity() -> None:
    line = OptimalControlProblem(Euclidean(1), lambda q, u: q**2 + u, half_square, 1)
    times = np.linspace(0, 2, 21)
    found = Propagator(line, Exponential(Euclidean(1))).discretization_error(
        times, np.ones((21, 1)), times[:-1] + 0.05, np.zeros((20, 1))
    )
    assert found.largest["R^1"] == np.inf
    assert found.distances["R^1"][0] == 0


def body_of_inertia(q: tuple, u: Any, inertia: Any) -> tuple:
    """The body, its inertia a parameter."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia


def test_parameters() -> None:
    """One propagator for all values: the error grows with the distance of a parameter from that of the states."""
    propagator = Propagator(problem(body_of_inertia), Cayley(RIGID), INERTIA)
    states, at = body_states(TIMES, 1), stage_times(TIMES, 2)
    controls, errors = np.array([torque(t, 1) for t in at]), []
    for change in (0.0, 1e-9, 1e-6, 1e-3, 0.5):
        given = propagator.discretization_error(TIMES, states, at, controls, (1 + change) * INERTIA)
        errors.append(given.largest["factor 1, R^3"])
    assert errors[0] < 1e-13
    np.testing.assert_allclose(np.diff(np.log10(errors[1:4])), 3, atol=0.01)
    assert errors[4] > 0.1


def test_functions_without_scalars() -> None:
    states = body_states(TIMES, 1)
    found = body_error(Propagator(problem(body_through_eigenvalues), Cayley(RIGID)), 2, states)
    assert max(found.largest.values()) < 1e-12


def test_controls_on_a_sphere() -> None:
    """Two stages determine the great circle that the control follows at constant speed, in any step."""
    turning = OptimalControlProblem(SO3, lambda q, u: q @ hat(u), lambda q, u: q[0, 0], S2)
    propagator = Propagator(turning, Cayley(SO3))
    at = stage_times(TIMES, 2)
    for speed in (0.0, 0.1, 2.0, 8.0):

        def control(t: Any, speed: float = speed) -> np.ndarray:
            return np.stack([np.cos(speed * t), np.sin(speed * t) * 0.6, np.sin(speed * t) * 0.8], axis=-1)

        states = reference(lambda t, y: np.cross(y.reshape(3, 3), control(t)[None]).ravel(), np.eye(3).ravel(), TIMES)
        found = propagator.discretization_error(TIMES, states.reshape(-1, 3, 3), at, control(at))
        assert found.largest["SO(3)"] < 1e-12 + found.resolution["SO(3)"]
    opposite = np.where(np.arange(12)[:, None] % 2, -1.0, 1.0) * np.array([1.0, 0, 0])
    with pytest.raises(DomainError, match="not in one retraction chart"):
        propagator.discretization_error(TIMES, np.broadcast_to(np.eye(3), (7, 3, 3)), at, opposite)


@cache
def gauss_run(name: str, stages: int) -> tuple[Propagator, Callable]:
    """States of collocation under controls at its stages, by fixed-point iteration, the number of steps as data;
    compiled."""
    problem, retraction, start = SUBJECTS[name]
    method, n = Gauss(stages, retraction), problem.manifold.dimension

    def slopes(x: Any, frame: Any, xi: Any, u: Any) -> Any:
        """Chart velocities of the points."""

        def slope(c: Any, u: Any) -> Any:
            push = jax.vmap(lambda nu: flat(method.velocity(x, frame, c, nu)[1]))(jnp.eye(n))
            return jnp.linalg.solve(push @ push.T, push @ flat(problem.velocity(method.point(x, frame, c), u)))

        return jax.vmap(slope)(xi, u)

    @jax.jit
    def run(count: Any, h: Any, controls: Any) -> Any:
        def step(k: Any, states: Any) -> Any:
            q = jax.tree.map(lambda leaf: leaf[k], states)

            def closer(_: int, guess: Any) -> Any:
                x, nu = guess
                frame = method.frame(x)
                begin, _ = method.ends(x, frame, h * method.weights @ nu)
                nu = slopes(x, frame, h * method.centred @ nu, controls[k])
                return retraction(x, problem.manifold.projection(x, jax.tree.map(jnp.subtract, q, begin))), nu

            x, nu = jax.lax.fori_loop(0, 40, closer, (q, jnp.zeros((stages, n))))
            _, end = method.ends(x, method.frame(x), h * method.weights @ nu)
            return jax.tree.map(lambda leaf, e: leaf.at[k + 1].set(e), states, end)

        states = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (COUNTS[-1] + 1, *leaf.shape)), start)
        return jax.lax.fori_loop(0, count, step, states)

    return Propagator(problem, retraction), run


def flat(point: Any) -> Any:
    return jnp.concatenate([leaf.ravel() for leaf in jax.tree.leaves(point)])


def rolled(q: Any, u: Any) -> Any:
    """A ball that is rolled by a control, and drawn to the pole."""
    return S2.projection(q, u + jnp.array([0.0, 0.0, 1.0]) * q[0])


BALL = OptimalControlProblem(S2, rolled, half_square, 3)
SUBJECTS: dict[str, tuple] = {
    "S^2": (BALL, Projection(S2), np.array([0.6, 0.0, 0.8])),
    "SO(3) x R^3": (problem(), Cayley(RIGID), (np.eye(3), np.array([0.3, -0.5, 0.8]))),
}
COUNTS = np.array([6, 9, 13, 19, 28])


@pytest.mark.parametrize(("name", "stages"), [("S^2", 1), ("S^2", 2), *(("SO(3) x R^3", s) for s in (1, 2, 3))])
@pytest.mark.usual("S^2-2", "SO(3) x R^3-1")
def test_error_of_collocation_is_of_order_twice_the_stages(name: str, stages: int) -> None:
    propagator, run = gauss_run(name, stages)
    errors = []
    for count in COUNTS:
        times = np.linspace(0, 1.5, count + 1)
        at = stage_times(times, stages)
        controls = np.array([torque(t, 3) for t in at])
        padded = np.zeros((COUNTS[-1], stages, 3))
        padded[:count] = controls.reshape(count, stages, 3)
        states = jax.tree.map(lambda leaf, n=count: np.asarray(leaf)[: n + 1], run(count, 1.5 / count, padded))
        found = propagator.discretization_error(times, states, at, controls)
        errors.append(list(found.largest.values()))
        assert all(found.resolution[k] <= 0.01 * found.largest[k] for k in found.largest)
    slopes = np.polyfit(np.log(COUNTS), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, -2 * stages, rtol=0.08)


def test_distances_of_factors() -> None:
    """Angles and lengths by name, from rounding to half a turn; of a power the largest."""
    for angle in (1e-9, 1e-3, 1.0, 3.0):
        turn, shift = rotation(angle * np.array([2.0, -1.0, 2.0]) / 3), np.array([0.0, 3.0, 4.0])
        pose, circle = np.eye(4), np.array([np.cos(angle), np.sin(angle), 0.0])
        pose[:3, :3], pose[:3, 3] = turn, shift
        manifold = Product(SE(3), S2, Power(SO3, 2), SO(4), Euclidean(3))
        first = np.eye(4), np.eye(3)[0], np.stack([np.eye(3)] * 2), np.eye(4), np.zeros(3)
        c, s = np.cos(angle), np.sin(angle)
        plane = np.kron(np.eye(2), np.array([[c, -s], [s, c]]))
        second = pose, circle, np.stack([np.eye(3), turn]), plane, shift
        found = list(factor_distances(manifold, first, second))
        assert [name for name, *_ in found] == [
            "factor 0, SE(3), rotation",
            "factor 0, SE(3), translation",
            f"factor 1, {S2}",
            f"factor 2, {Power(SO3, 2)}",
            "factor 3, SO(4)",
            "factor 4, R^3",
        ]
        expected = [angle, 5.0, angle, angle, np.sqrt(2) * angle, 5.0]
        np.testing.assert_allclose([distance for _, distance, _ in found], expected, rtol=1e-6)
        assert [is_angle for *_, is_angle in found] == [True, False, True, True, False, False]


@pytest.mark.parametrize("stages", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_the_error_of_a_solution_falls_with_the_order_of_its_method(stages: int) -> None:
    rest, method = np.zeros(3), Gauss(stages, Cayley(RIGID))
    ends = (np.eye(3), rest), (rotation([1.0, -0.4, 0.7]), rest)
    coarse, fine = (
        discretization_error(problem(), Cayley(RIGID), solve(problem(), *ends, 1.0, method=method, steps=n))
        for n in (8, 16)
    )
    for name in NAMES:
        assert np.log2(coarse.largest[name] / fine.largest[name]) == pytest.approx(2 * stages, abs=0.25)
