"""Nonholonomic constraints: what a Dirac integrator keeps, and what it does not.

The nonholonomic particle: ``H = |p|^2 / 2`` in R^3 with ``z' = y x'``. With ``y = y0 + v t`` it has ``x' = c / sqrt(1 +
y^2)``, so that ``x = (c/v) asinh y`` and ``z = (c/v) sqrt(1 + y^2)`` up to constants.
"""

from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, ArrayLike
from retrax.integrators import (
    Composition,
    DiracIntegrator,
    DiracSystem,
    HamiltonianStage,
    Integrator,
    OptimalControlProblem,
    integrate,
    symplecticity_defect,
)
from retrax.integrators.initial_value.step import StepEquations, StepResult
from retrax.manifolds import (
    CotangentBundle,
    Euclidean,
    InvalidInputError,
    Manifold,
    NotOnManifoldError,
    PresymplecticManifold,
    Sphere,
    Submanifold,
)
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.root import find_root
from retrax.retractions import Addition, CotangentLift, Midpoint, Projection

from tests.support.numerics import slope

R3 = Euclidean(3)
LIFT = CotangentLift(Midpoint(Addition(R3)))
NODES = DiracIntegrator(LIFT)


def kinetic_energy(q: Array, p: Array) -> Array:
    return p @ p / 2


def contact_form(q: Array) -> Array:
    return jnp.array([[-1.0, 0.0, 0.0]]) * q[1] + jnp.array([[0.0, 0.0, 1.0]])


PARTICLE = DiracSystem(R3, kinetic_energy, contact_form)
HEIGHT, SPEED, ALONG = 0.3, 0.7, 1.1
START = (
    jnp.array([0.0, HEIGHT, 0.0]),
    jnp.array([1.0, 0.0, HEIGHT]) * ALONG / np.hypot(1, HEIGHT) + jnp.array([0.0, SPEED, 0.0]),
)
COUNTS = np.array([20, 40, 80])


class StageImpulses(Integrator):
    """Constraint forces at the stage: ``(q0, p0; q1, p1) = R_d^{T*}(h V)`` with ``V`` in the implicit system there."""

    lift: CotangentLift

    @property
    def manifold(self) -> Manifold:
        return self.lift.discretization.manifold

    @property
    def control_times(self) -> np.ndarray:
        return np.asarray(0.5)

    def check(self, system: DiracSystem, q: Array, p: Array) -> None: ...

    def begin(self, system: DiracSystem, q: Array, p: Array) -> Array:
        return jnp.zeros_like(system.constraint(q, p))

    def control(self, unknowns: Array) -> Array:
        return unknowns

    def step(self, system: DiracSystem, h: ArrayLike, q: Array, p: Array, previous: Array) -> StepResult:
        stage = HamiltonianStage(hamiltonian=system.hamiltonian, discretization=self.lift.discretization, step=h)
        equations, m = StepEquations.near(stage, q, p, None), previous.size
        guess = stage.predict(q, p, (q, p, p))

        def residual(c: Array) -> Array:
            x, pull = jax.vjp(lambda d: stage.move(guess, stage.frame(guess), d)[0], c[m : m + stage.dimension])
            (force,) = pull(vec.combine(system.forms(x), c[:m]))
            v = equations.end(c[m:])[2][1]
            free = equations.residual(c[m:], q, p)
            return jnp.concatenate([system.constraint(x, v / h), free.at[self.manifold.dimension :].add(-force)])

        root, found = find_root(residual, jnp.concatenate([previous, equations.first]))
        q1, p1, _ = equations.end(root[m:])
        return StepResult(q1, p1, root[:m], found)


@eqx.filter_jit
def run(
    integrator: Integrator, system: DiracSystem, start: tuple, h: Array, count: Array
) -> tuple[tuple, Array, Array]:
    """The end of ``count`` steps, the largest violation of the constraints, and whether all were solved."""

    def step(_: int, state: tuple) -> tuple:
        (q, p), unknowns, slip, solved = state
        new = integrator.step(system, h, q, p, unknowns)
        off = jnp.max(jnp.abs(system.constraint(new.q, system.velocity(new.q, new.p))))
        return (new.q, new.p), new.unknowns, jnp.maximum(slip, off), solved & new.converged

    first = start, integrator.begin(system, *start), jnp.zeros(()), jnp.array(True)
    end, _, slip, solved = jax.lax.fori_loop(0, count, step, first)
    return end, slip, solved


def rolled(integrator: Integrator, horizon: float, count: int, start: tuple = START) -> tuple[tuple, float]:
    end, slip, solved = run(integrator, PARTICLE, start, jnp.asarray(horizon / count), jnp.asarray(count))
    assert solved
    return end, float(slip)


def particle(t: float) -> np.ndarray:
    """Its position."""
    y = HEIGHT + SPEED * t
    return (
        np.array([np.arcsinh(y) - np.arcsinh(HEIGHT), SPEED * y / ALONG, np.hypot(1, y) - np.hypot(1, HEIGHT)])
        * ALONG
        / SPEED
    )


METHODS: dict[str, tuple[Integrator, int]] = {
    "nodes": (NODES, 2),
    "stage": (StageImpulses(LIFT), 2),
    "Suzuki": (Composition(NODES), 4),
}


@cache
def runs(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of position and energy, and the slip, for each number of steps."""
    ends = [rolled(METHODS[name][0], 2.0, int(count)) for count in COUNTS]
    position = [np.max(np.abs(q - particle(2.0))) for (q, _), _ in ends]
    energy = [abs(float(kinetic_energy(*z) - kinetic_energy(*START))) for z, _ in ends]
    return np.array(position), np.array(energy), np.array([slip for _, slip in ends])


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.usual("Suzuki")
def test_order(name):
    assert slope(1 / COUNTS, runs(name)[0], 1e-13) == pytest.approx(METHODS[name][1], abs=0.05)


@pytest.mark.parametrize("name", ["nodes", "Suzuki"])
@pytest.mark.usual("nodes")
def test_multipliers_are_of_order_two_at_their_times(name):
    """``lambda = p_z' = z''``, of each step, and of each substep of a composition at its own time."""
    errors = []
    for count in COUNTS:
        path = integrate(PARTICLE, METHODS[name][0], START, 2.0 / count, int(count))
        force = ALONG * SPEED * (1 + (HEIGHT + SPEED * path.stage_times) ** 2) ** -1.5
        errors.append(np.max(np.abs(path.controls[..., 0] - force)))
    assert slope(1 / COUNTS, np.array(errors), 1e-13) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("name", ["nodes", "Suzuki"])
def test_nodes_satisfy_the_constraints(name):
    assert np.max(runs(name)[2]) <= 2e-15


def test_forces_at_the_stage_leave_the_nodes_off_the_constraints():
    """By O(h^2), as the stages of singular problems do; what they keep of a free particle is its energy."""
    _, energy, slip = runs("stage")
    assert slope(1 / COUNTS, slip, 1e-13) == pytest.approx(2, abs=0.1)
    assert np.max(energy) <= 1e-14


def test_energy_is_kept_to_second_order_only():
    assert slope(1 / COUNTS, runs("nodes")[1], 1e-13) == pytest.approx(2, abs=0.05)


def test_steps_are_reversible():
    end, _ = rolled(NODES, 2.0, 40)
    back, _ = rolled(NODES, -2.0, 40, end)
    assert vec.size(vec.subtract(back, START)) <= 1e-13


@pytest.mark.slow
def test_the_form_changes_at_first_order_in_the_step():
    """The flow of a nonholonomic system is not symplectic: ``(F_h^* omega - omega) / h`` on the constraints has a
    limit."""
    bundle = CotangentBundle(R3)
    allowed = Submanifold(bundle, lambda z: PARTICLE.constraint(z[0], PARTICLE.velocity(*z)))
    space = PresymplecticManifold(allowed, bundle.two_form)
    sizes = np.array([0.02, 0.01])
    limits = np.asarray(symplecticity_defect(space, NODES, PARTICLE, START, sizes)) / sizes
    assert limits[1] == pytest.approx(limits[0], rel=0.05)
    assert limits[1] > 0.1


class Fast(eqx.Module):
    """A relativistic particle, in units of length, momentum and of the form."""

    length: jax.Array
    momentum: jax.Array
    form: jax.Array

    def hamiltonian(self, q: Array, p: Array) -> Array:
        return self.length * self.momentum * jnp.sqrt(1 + (p / self.momentum) @ (p / self.momentum))

    def forms(self, q: Array) -> Array:
        return self.form * contact_form(q / self.length)


@pytest.mark.parametrize("units", [*((s * k) for k in np.eye(3, dtype=int) for s in (-12, -9, 9, 12)), (-6, 9, -9)])
@pytest.mark.usual(2)
def test_nothing_depends_on_the_units(units):
    def end(length: float, momentum: float, form: float) -> tuple[np.ndarray, np.ndarray]:
        fast = Fast(*map(jnp.asarray, (length, momentum, form)))
        system, start = DiracSystem(R3, fast.hamiltonian, fast.forms), (START[0] * length, START[1] * momentum)
        (q, p), slip, solved = run(NODES, system, start, jnp.asarray(0.1), jnp.asarray(20))
        assert solved
        assert slip <= 1e-14 * length * form
        return np.asarray(q) / length, np.asarray(p) / momentum

    for found, expected in zip(end(*10.0 ** np.array(units)), end(1.0, 1.0, 1.0), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("size", 10.0 ** np.arange(-12, 13, 6))
def test_starts_are_judged_by_the_size_of_their_velocity(size):
    off = jnp.array([0.0, 0.0, 1.0])
    NODES.check(PARTICLE, START[0], size * (START[1] + 1e-12 * off))
    with pytest.raises(NotOnManifoldError, match="violates the constraints"):
        NODES.check(PARTICLE, START[0], size * (START[1] + 1e-6 * off))


class Pair(eqx.Module):
    """The form of the particle, and one at an angle to it and in a unit of its own."""

    angle: jax.Array
    unit: jax.Array

    def forms(self, q: Array) -> Array:
        other = jnp.cos(self.angle) * contact_form(q) + jnp.sin(self.angle) * jnp.array([[0.0, 1.0, 0.0]])
        return jnp.concatenate([contact_form(q), self.unit * other])


@pytest.mark.parametrize("unit", 10.0 ** np.arange(-12, 13, 6))
@pytest.mark.usual("1e-12", "1.0", "1000000000000.0")
def test_forms_are_independent_whatever_their_units(unit):
    for angle in (np.pi / 2, 1.0, 1e-2, 1e-4, 1e-6, 0.0):
        system = DiracSystem(R3, kinetic_energy, Pair(jnp.asarray(angle), jnp.asarray(unit)).forms)
        if angle >= 1e-4:
            NODES.check(system, START[0], jnp.array([1.0, 0.0, HEIGHT]))
        else:
            with pytest.raises(InvalidInputError, match="independent one-forms"):
                NODES.check(system, START[0], jnp.array([1.0, 0.0, HEIGHT]))


def test_no_forms_are_no_constraints():
    free = DiracSystem(R3, kinetic_energy, lambda q: jnp.zeros((0, 3)))
    trajectory = integrate(free, NODES, START, 0.1, 5)
    np.testing.assert_allclose(trajectory.q[-1], START[0] + 0.5 * START[1], atol=1e-14)


def test_the_multiplier_of_a_rod_is_its_force():
    """Centripetal, ``-|p|^2 / r^2`` of the form ``q``; the midpoint keeps the length of the rod."""
    rod, errors = DiracSystem(Euclidean(2), kinetic_energy, lambda q: q[None]), []
    method = DiracIntegrator(CotangentLift(Midpoint(Addition(Euclidean(2)))))
    for count in COUNTS:
        path = integrate(rod, method, (jnp.array([2.0, 0.0]), jnp.array([0.0, 3.0])), 1.0 / count, int(count))
        np.testing.assert_allclose(np.linalg.norm(path.q, axis=1), 2.0, rtol=1e-14)
        errors.append(np.max(np.abs(path.controls[:, 0] + 9 / 4)))
    assert slope(1 / COUNTS, np.array(errors), 1e-13) == pytest.approx(2, abs=0.1)


def hoop_forms(q: Array) -> Array:
    """On the sphere: no motion along the parallels."""
    return jnp.cross(jnp.array([0.0, 0.0, 1.0]), q)[None]


@pytest.mark.slow
def test_an_integrable_constraint_on_a_sphere_gives_great_circles():
    """A free particle that must not move along the parallels stays on its meridian, and keeps its speed."""
    sphere = Sphere(2)
    system = DiracSystem(sphere, kinetic_energy, hoop_forms)
    q0 = jnp.array([0.6, 0.0, 0.8])
    p0 = system.project(q0, jnp.array([0.8, 0.5, -0.6]))
    path = integrate(system, DiracIntegrator(CotangentLift(Midpoint(Projection(sphere)))), (q0, p0), 0.05, 20)
    np.testing.assert_allclose(p0, [0.8, 0.0, -0.6], atol=1e-15)
    np.testing.assert_allclose(path.q[:, 1], 0.0, atol=1e-15)
    np.testing.assert_allclose(jnp.linalg.norm(path.p, axis=1), 1.0, atol=1e-14)


PLANAR = DiracIntegrator(CotangentLift(Midpoint(Addition(Euclidean(2)))))


def slope_of_height(q: Array) -> Array:
    return jnp.array([[-1.0, 0.0]]) * q[1] + jnp.array([[0.0, 1.0]])


@pytest.mark.slow  # two programs with nested iterations
def test_controls_follow_from_the_hamiltonian():
    """Cost ``sum cosh u`` of the velocity ``u``: ``u = asinh p``, in ``H`` a sum of ``p asinh p - sqrt(1 + p^2)``."""
    plane, forms = Euclidean(2), slope_of_height
    cost = OptimalControlProblem(plane, lambda q, u: u, lambda q, u: jnp.sum(jnp.cosh(u)), 2)
    closed = DiracSystem(plane, lambda q, p: jnp.sum(p * jnp.arcsinh(p) - jnp.sqrt(1 + p * p)), forms)
    q0 = jnp.array([0.0, HEIGHT])
    start = q0, closed.project(q0, jnp.array([ALONG, SPEED]))
    paths = [integrate(system, PLANAR, start, 0.1, 10) for system in (DiracSystem.controlled(cost, forms), closed)]
    for found, expected in zip(*((path.q, path.p, path.controls) for path in paths), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_only_a_problem_that_determines_its_controls_is_controlled():
    free = OptimalControlProblem(Euclidean(2), lambda q, u: u, lambda q, u: jnp.sum(q), 2)
    start = jnp.array([0.0, HEIGHT]), jnp.zeros(2)
    with pytest.raises(InvalidInputError, match="whose controls dH/du = 0 determines"):
        integrate(DiracSystem.controlled(free, slope_of_height), PLANAR, start, 0.1, 1)
    with pytest.raises(InvalidInputError, match="controlled takes an OptimalControlProblem"):
        DiracSystem.controlled(kinetic_energy, contact_form)


def test_a_start_off_the_constraints_is_refused():
    with pytest.raises(NotOnManifoldError, match=r"expected 0; try system\.project"):
        integrate(PARTICLE, NODES, (START[0], jnp.array([1.0, 0.0, 0.0])), 0.1, 1)


def doubled(q: Array) -> Array:
    return jnp.tile(contact_form(q), (2, 1))


WRONG: dict[str, tuple[Any, str]] = {
    "no system": (kinetic_energy, "integrates a DiracSystem"),
    "dependent forms": (DiracSystem(R3, kinetic_energy, doubled), "independent one-forms"),
    "one covector": (DiracSystem(R3, kinetic_energy, lambda q: contact_form(q)[0]), "leading axis"),
    "rates": (DiracSystem(R3, kinetic_energy, contact_form, lambda q: q), "one number for each of the 1 one-forms"),
    "another manifold": (DiracSystem(Euclidean(4), kinetic_energy, contact_form), "use one manifold"),
    "a vector": (DiracSystem(R3, lambda q, p: p, contact_form), "must return a scalar"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_system_of_the_method_is_refused(name):
    system, words = WRONG[name]
    with pytest.raises(InvalidInputError, match=words):
        integrate(system, NODES, START, 0.1, 1)


def test_arguments_of_the_wrong_kind_are_refused():
    with pytest.raises(InvalidInputError, match="takes a cotangent lift"):
        DiracIntegrator(Midpoint(Addition(R3)))  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidInputError, match="must be a function of q,"):
        DiracSystem(R3, kinetic_energy, 1.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidInputError, match="must be a Manifold"):
        DiracSystem(3, kinetic_energy, contact_form)  # pyright: ignore[reportArgumentType]
