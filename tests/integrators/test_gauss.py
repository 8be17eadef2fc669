"""Gauss methods for Hamilton's and Pontryagin's equations: orders, symmetry, what they preserve, where they fail."""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from retrax.integrators import (
    Composition,
    Integrator,
    OptimalControlProblem,
    PresymplecticIntegrator,
    Result,
    SymplecticIntegrator,
    integrate,
    load_trajectory,
)
from retrax.integrators.initial_value.step import StepEquations
from retrax.manifolds import ConvergenceError, CotangentBundle, Euclidean, InvalidInputError, form_matrix, hat
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import (
    Addition,
    Cayley,
    CotangentLift,
    Gauss,
    Midpoint,
    Projection,
    Retraction,
    default_retraction,
)
from scipy.integrate import solve_ivp

from tests.support.cases import RETRACTIONS
from tests.support.numerics import SEEDS, compiled, flat, norm, slope, unflat

from .problems import (
    ELLIPSOID,
    INERTIA,
    RIGID,
    SO3,
    SPHERE,
    coupled_energy,
    hamiltonian_field,
    pendulum_energy,
    rigid_body_energy,
    rotation,
    top_energy,
)


def plane_energy(q: jax.Array, p: jax.Array) -> jax.Array:
    """Not separable, not quadratic."""
    return jnp.cosh(p[0]) + p @ p / 2 + q[0] ** 4 / 4 + jnp.sin(q[0] * q[1]) + p[1] * q[0]


def controlled_body(q: tuple, u: jax.Array) -> tuple:
    """Rigid body with three torques."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def pointing_cost(q: tuple, u: jax.Array) -> jax.Array:
    """Quadratic in the controls, which are then ``u = J^-1 p_w``."""
    return u @ u / 2 + q[1] @ q[1] / 4 - q[0][0, 0]


BODY = OptimalControlProblem(RIGID, controlled_body, pointing_cost, 3)


def extremal_energy(q: tuple, p: tuple) -> jax.Array:
    """Pontryagin's Hamiltonian of ``BODY`` with its controls eliminated."""
    u = p[1] / INERTIA
    return vec.pairing(p, controlled_body(q, u)) - pointing_cost(q, u)


LINE = Addition(Euclidean(1))
REGULATOR = OptimalControlProblem(LINE.manifold, lambda q, u: u - 0.3 * q, lambda q, u: (q @ q + u @ u) / 2, 1)


class Subject(NamedTuple):
    """A system on ``T*Q`` with what integrates it, and the Hamiltonian whose flow that approximates."""

    retraction: Retraction
    energy: Callable
    problem: OptimalControlProblem | None = None

    @property
    def system(self) -> Any:
        return self.energy if self.problem is None else self.problem

    @property
    def bundle(self) -> CotangentBundle:
        return CotangentBundle(self.retraction.manifold)

    def integrator(self, method: Any) -> Integrator:
        return SymplecticIntegrator(method) if self.problem is None else PresymplecticIntegrator(method)

    def start(self) -> tuple:
        return self.bundle.random_point(jax.random.key(5))


SUBJECTS = {
    "R2": Subject(Addition(Euclidean(2)), plane_energy),
    "regulator": Subject(LINE, lambda q, p: p @ p / 2 - 0.3 * p @ q - q @ q / 2, REGULATOR),
    "S2": Subject(Projection(SPHERE), pendulum_energy),
    "SO3": Subject(Cayley(SO3), top_energy),
    "ellipsoid": Subject(default_retraction(ELLIPSOID), pendulum_energy),
    "SE3": Subject(RETRACTIONS["cayley-SE3"], coupled_energy(RETRACTIONS["cayley-SE3"].manifold)),
    "St42": Subject(RETRACTIONS["polar-St42"], coupled_energy(RETRACTIONS["polar-St42"].manifold)),
    "controlled body": Subject(Cayley(RIGID), extremal_energy, BODY),
}
HORIZON = 1.0
COUNTS = {1: (8, 16, 32), 2: (4, 8, 16), 3: (3, 5, 8), 4: (2, 3, 5)}
QUICK = (*(("R2", stages) for stages in COUNTS), ("S2", 2), ("controlled body", 2))
OTHERS = (
    *((name, stages) for name in ("S2", "SO3", "controlled body") for stages in COUNTS if (name, stages) not in QUICK),
    ("ellipsoid", 3),
    ("SE3", 2),
    ("St42", 4),
)


def usual_or_slow(*values: Any, usual: bool) -> Any:
    return pytest.param(*values, marks=[] if usual else [pytest.mark.slow])


@cache
def reference(name: str) -> Callable:
    """The exact flow by an explicit method of order 8, of the vector field that the canonical form makes of the
    Hamiltonian."""
    subject = SUBJECTS[name]
    space = subject.bundle
    field = compiled(lambda y: flat(hamiltonian_field(space, subject.energy, unflat(space)(y))))
    start, limits = np.asarray(flat(subject.start())), {"rtol": 1e-13, "atol": 1e-13}
    solution = solve_ivp(lambda _, y: field(y), (0, HORIZON), start, "DOP853", dense_output=True, **limits)
    return lambda t: solution.sol(t).T


@cache
def run(name: str, method: Any, weights: tuple[float, ...] | None = None) -> Callable:
    """A compiled run over the horizon: the last state, flat, controls of the last step, success. The number of steps is
    data."""
    subject = SUBJECTS[name]
    integrator = subject.integrator(method)
    integrator = integrator if weights is None else Composition(integrator, weights)
    z0 = subject.start()

    def end(steps: jax.Array) -> tuple:
        def step(_: int, state: tuple) -> tuple:
            z, y, good = state
            new = integrator.step(subject.system, HORIZON / steps, *z, y)
            return (new.q, new.p), new.unknowns, good & new.converged

        z, y, good = jax.lax.fori_loop(0, steps, step, (z0, integrator.begin(subject.system, *z0), jnp.array(True)))
        return flat(z), integrator.control(y), good

    return compiled(end)


def errors_of(name: str, method: Any, counts: Iterable[int], weights: tuple[float, ...] | None = None) -> np.ndarray:
    """Errors at the horizon in positions and covectors, a row for each number of steps."""
    rows = []
    for steps in counts:
        z, _, good = run(name, method, weights)(steps)
        assert good
        rows.append([np.max(np.abs(half)) for half in np.split(z - reference(name)(HORIZON), 2)])
    return np.array(rows)


@pytest.mark.parametrize(("name", "stages"), [usual_or_slow(*case, usual=case in QUICK) for case in QUICK + OTHERS])
@pytest.mark.usual(1)
def test_states_and_covectors_are_of_order_twice_the_number_of_stages(name, stages):
    # Longer steps there do not show the order yet.
    counts = np.array(COUNTS[stages]) * (4 if name == "ellipsoid" else 1)
    errors = errors_of(name, Gauss(stages, SUBJECTS[name].retraction), counts)
    for column in errors.T:
        assert slope(1 / counts, column, 1e-12) > 2 * stages - 0.3
    assert np.all(errors[-1] < 0.02)


@pytest.mark.slow
@pytest.mark.parametrize("stages", [usual_or_slow(s, usual=s == 2) for s in (2, 3, 4)])
def test_controls_at_the_points_are_of_the_order_of_the_stages(stages):
    method, counts, errors = Gauss(stages, SUBJECTS["controlled body"].retraction), COUNTS[stages], []
    for steps in counts:
        _, controls, _ = run("controlled body", method)(steps)
        exact = reference("controlled body")(HORIZON - HORIZON / steps * (1 - method.nodes))[:, -3:] / INERTIA
        errors.append(np.max(np.abs(controls - exact)))
    assert slope(1 / np.array(counts), np.array(errors), 1e-12) > stages + 1 - 0.2


@pytest.mark.parametrize(
    "name", ["R2", "regulator", *(usual_or_slow(n, usual=False) for n in ("controlled body", "St42"))]
)
@pytest.mark.usual(1)
def test_one_stage_is_the_midpoint_map(name):
    retraction = SUBJECTS[name].retraction
    gauss, midpoint = (run(name, m)(16) for m in (Gauss(1, retraction), CotangentLift(Midpoint(retraction))))
    assert norm(gauss[0] - midpoint[0]) < 1e-14 * (1 + norm(midpoint[0]))
    if midpoint[1] is not None:
        assert norm(gauss[1][0] - midpoint[1]) < 1e-14


@cache
def kernel(name: str, stages: int) -> Callable:
    """One compiled function: a step from a random point, its derivative on a basis, and a step back."""
    subject = SUBJECTS[name]
    bundle, manifold = subject.bundle, subject.retraction.manifold
    integrator = subject.integrator(Gauss(stages, subject.retraction))

    def facts(seed: jax.Array, h: jax.Array) -> dict[str, Any]:
        z0 = bundle.random_point(jax.random.key(seed))
        begun = jax.lax.stop_gradient(integrator.begin(subject.system, *z0))

        def step(z: tuple, h: jax.Array) -> tuple:
            new = integrator.step(subject.system, h, *z, begun)
            return (new.q, new.p), (new.unknowns, new.converged)

        frame = bundle.basis(z0)
        z1, push, (y, there) = jax.linearize(lambda z: step(z, h), z0, has_aux=True)
        images = jax.vmap(push)(frame)
        back, (_, returned) = step(z1, -h)
        begin, end = integrator.stage(subject.system, h).ends(y)
        return {
            "converged": there & returned,
            "symplectic": form_matrix(bundle.two_form, z1, images) - form_matrix(bundle.two_form, z0, frame),
            "back": vec.subtract(back, z0),
            "on the bundle": bundle.violations(z1),
            "ends": vec.subtract((begin, end), (z0[0], z1[0])),
            "spin": manifold.momentum(*z1)[2] - manifold.momentum(*z0)[2] if name == "S2" else jnp.zeros(()),
        }

    return compiled(facts)


def check_step(name: str, stages: int, seed: int, h: float) -> None:
    facts = kernel(name, stages)(seed, h)
    assert facts.pop("converged")
    assert norm(facts.pop("symplectic")) < 1e-11
    assert norm(facts) < 1e-12, facts


@pytest.mark.parametrize(("name", "stages"), [("S2", 2), usual_or_slow("controlled body", 3, usual=False)])
@given(seed=SEEDS, h=st.floats(0.01, 0.2))
@pytest.mark.slow
def test_a_step_is_symplectic_and_symmetric_and_keeps_the_spin_of_the_pendulum(name, stages, seed, h):
    check_step(name, stages, seed, h)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "stages"), [("SO3", 4), ("ellipsoid", 2), ("St42", 2)])
def test_on_other_manifolds_a_step_is_symplectic_and_symmetric(name, stages, seeds):
    for seed in seeds[:3]:
        check_step(name, stages, seed, 0.05)


@pytest.mark.slow
def test_the_spatial_momentum_of_a_free_body_is_conserved_to_rounding():
    start = jnp.asarray(rotation([0.3, 0.1, -0.2])), jnp.asarray(SO3.covector(jnp.eye(3), jnp.array([1.0, -0.5, 0.7])))
    path = integrate(rigid_body_energy, SymplecticIntegrator(Gauss(3, Cayley(SO3))), start, 0.3, 200)
    momenta = jax.vmap(lambda q, p: q @ SO3.body(q, p))(path.q, path.p)
    assert norm(momenta - momenta[0]) < 1e-13
    assert jnp.ptp(jax.vmap(rigid_body_energy)(path.q, path.p)) < 1e-6


@pytest.mark.parametrize("name", ["R2", usual_or_slow("SO3", usual=False)])
def test_the_first_inverse_jacobian_is_that_of_small_steps(name):
    """Its product with the Jacobian differs from the identity by ``O(h)``."""
    subject = SUBJECTS[name]
    integrator, z0 = SymplecticIntegrator(Gauss(3, subject.retraction)), subject.start()

    def departure(h: jax.Array) -> jax.Array:
        stage = integrator.stage(subject.energy, h)
        equations = StepEquations.near(stage, *z0, integrator.begin(subject.energy, *z0))
        jacobian = jax.jacfwd(lambda c: equations.residual(c, *z0))(equations.first)
        return jnp.asarray(stage.small_step_inverse()) @ jacobian - jnp.eye(jacobian.shape[0])

    measure, steps = compiled(departure), np.array([1e-2, 1e-4, 1e-6])
    departures = np.array([norm(measure(h)) for h in steps])
    assert slope(steps, departures, 0.0) == pytest.approx(1, abs=0.05)
    assert departures[-1] < 1e-4


def test_weights_of_a_symmetric_composition_raise_the_order_of_a_gauss_method():
    """Three steps with ``w_1^5 + w_2^5 + w_3^5 = 0`` make order 6 of order 4 [Hairer, Lubich, Wanner 2006, II.4.4]."""
    outer = 1 / (2 - 2 ** (1 / 5))
    errors = errors_of("R2", Gauss(2, SUBJECTS["R2"].retraction), (4, 8, 16), (outer, 1 - 2 * outer, outer))
    for column in errors.T:
        assert slope(1 / np.array([4, 8, 16]), column, 1e-12) > 5.5


def test_a_trajectory_has_a_control_for_each_point_at_its_time(tmp_path):
    """Of the regulator ``q' = -0.3 q + u``, whose extremals are combinations of ``exp(+- sqrt(1.09) t)`` with ``u =
    p``."""
    start = jnp.ones(1), jnp.full(1, -0.4)
    path = integrate(REGULATOR, PresymplecticIntegrator(Gauss(3, LINE)), start, 0.1, 6, save_every=2)
    assert path.controls.shape == (3, 3, 1)
    nodes = Gauss(3, LINE).nodes
    np.testing.assert_allclose(path.stage_times, 0.1 * (np.array([[1], [3], [5]]) + nodes), atol=1e-15)
    growth = np.sqrt(1.09)
    exact = -0.4 * np.cosh(growth * path.stage_times) + (1 - 0.12) / growth * np.sinh(growth * path.stage_times)
    np.testing.assert_allclose(path.controls[..., 0], exact, atol=1e-6)
    path.save(tmp_path / "path.npz")
    np.testing.assert_array_equal(load_trajectory(tmp_path / "path.npz").controls, path.controls)

    halves = Composition(PresymplecticIntegrator(Gauss(3, LINE)), (0.5, 0.5))
    fine, pairs = (integrate(REGULATOR, m, start, h, n) for m, h, n in ((halves.integrator, 0.05, 4), (halves, 0.1, 2)))
    assert pairs.controls.shape == (2, 2, 3, 1)
    np.testing.assert_allclose(pairs.controls.reshape(4, 3, 1), fine.controls, atol=1e-14)
    np.testing.assert_allclose(pairs.stage_times.reshape(4, 3), fine.stage_times, atol=1e-15)


@cache
def long_step() -> Callable:
    """Three steps of the pendulum of any length: what is left of the equations of the last one, where it is called
    solved."""
    method = Gauss(2, Projection(SPHERE))
    integrator = SymplecticIntegrator(method)
    z0 = jnp.array([0.6, 0.0, -0.8]), jnp.array([0.4, 0.6, 0.3])

    def facts(h: jax.Array) -> dict:
        path = integrate(pendulum_energy, integrator, z0, h, 3, throw=False)
        z = path.q[0], path.p[0]
        new = integrator.step(pendulum_energy, h, *z, integrator.begin(pendulum_energy, *z))
        x, w, pi, _ = new.unknowns
        xi = jnp.asarray(method.centred) @ w
        q, v = jax.vmap(lambda a, b: jax.jvp(lambda c: method.retraction(x, c), (a,), (b,)))(xi, w)
        velocity = h * jax.vmap(SPHERE.projection)(q, jax.vmap(SPHERE.projection)(q, pi))
        ends = integrator.stage(pendulum_energy, h).ends(new.unknowns)
        return {
            "path": (path.q, path.p, path.failed_step, path.result == Result.successful),
            "solved": new.converged,
            "left": norm_of(vec.subtract((v, *ends), (velocity, z[0], new.q))),
        }

    return compiled(facts)


def norm_of(a: Any) -> jax.Array:
    return jnp.asarray(vec.size(a))


@pytest.mark.slow
def test_a_step_that_is_too_long_is_reported_and_nothing_is_nan():
    """Swept through where Newton's method stops converging, and up to steps in which nothing is left of the problem."""
    failed = []
    for h in np.geomspace(0.1, 1e4, 60):
        facts = long_step()(h)
        q, p, step, good = facts["path"]
        assert np.all(np.isfinite([q, p]))
        assert good == (step == -1)
        assert facts["solved"] == (step != 0)
        if step >= 0:
            np.testing.assert_array_equal(q[int(step) :] - q[int(step)], 0)
        if facts["solved"]:
            assert facts["left"] < 1e-12 * (1 + h)
        failed.append(step >= 0)
    assert not any(failed[:10])
    assert all(failed[-10:])


def test_the_error_of_a_step_that_cannot_be_solved_names_it():
    start = jnp.array([0.5, -0.3]), jnp.array([0.4, 0.6])
    with pytest.raises(ConvergenceError, match=r"step 0, from t = 0"):
        integrate(plane_energy, SymplecticIntegrator(Gauss(2, Addition(Euclidean(2)))), start, 1e3, 2)


def test_a_step_may_be_an_array_of_one_entry():
    integrator, (q, p) = SymplecticIntegrator(Gauss(2, Addition(Euclidean(2)))), SUBJECTS["R2"].start()
    y = integrator.begin(plane_energy, q, p)
    one, entry = (integrator.stage(plane_energy, h).cost(y) for h in (0.1, jnp.full(1, 0.1)))
    assert one == entry
    assert entry.shape == ()


def test_what_takes_no_gauss_method_says_what_it_takes():
    with pytest.raises(InvalidInputError, match=r"a collocation method is given to an integrator as it is; try"):
        CotangentLift(Gauss(2, LINE))
    with pytest.raises(InvalidInputError, match=r"the method acts on Sphere(.|\n)*; use one manifold"):
        integrate(REGULATOR, PresymplecticIntegrator(Gauss(2, Projection(SPHERE))), (np.eye(3)[0], np.ones(3)), 0.1, 1)
