"""Goh's reduction identifies ``P_f`` with a cotangent bundle; what is integrated there is integrated on ``P_f``."""

from collections.abc import Callable
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import Composition, Integrator, OptimalControlProblem, integrate, singular_integrator
from retrax.integrators.problem.pontryagin import find_control
from retrax.integrators.singular.strategies import (
    ControlAffineSplitting,
    GohReduction,
    NotApplicableError,
    RattleIntegrator,
    ReducedIntegrator,
    reduce_until_regular,
)
from retrax.integrators.singular.strategies.goh_reduction import CONSTANT_POWER
from retrax.manifolds import CotangentBundle, Euclidean, InvalidInputError, NotOnManifoldError, Product
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.tolerances import EPS
from retrax.problems import SINGULAR
from retrax.retractions import Adjoint, Cayley, CotangentLift, Euler, Midpoint, default_retraction

from tests.integrators.problems import SPHERE
from tests.integrators.singular.cases import classified
from tests.support.numerics import slope

STEPS = np.array([0.2, 0.1, 0.05])


def curved_problem(rate: float) -> OptimalControlProblem:
    """A quadratic drift, one control along (1, 1/2, 0) that costs ``rate (0.3 x2 + 0.2 x1 x3) u``."""

    def dynamics(q: Array, u: Array) -> Array:
        drift = jnp.stack([0.2 * q[1], -q[2] + 0.3 * q[0] ** 2, q[1] + 0.2 * q[0] * q[2]])
        return drift + u[0] * jnp.array([1.0, 0.5, 0.0])

    def cost(q: Array, u: Array) -> Array:
        square = q[0] ** 2 / 2 + q[0] ** 4 / 8 + q[1] ** 2 / 2 + 0.4 * q[2] ** 2
        return square + 0.1 * q[0] * q[1] * q[2] + rate * (0.3 * q[1] + 0.2 * q[0] * q[2]) * u[0]

    return OptimalControlProblem(Euclidean(3), dynamics, cost, 1)


def nested_problem() -> OptimalControlProblem:
    """On (S^2 x R^2) x R^(1x2), two singular controls that mix the Euclidean factors, their cost a gradient along
    them."""
    fields = jnp.array([[1.0, 0.2], [0.0, 1.0], [0.5, 0.0], [0.0, -0.3]])

    def potential(n: Array, x: Array) -> Array:
        return x[0] * x[3] ** 2 / 5 + n[2] * x[1] / 2 + x[2] * x[1] ** 3 / 10

    def dynamics(q: tuple, u: Array) -> tuple:
        (n, a), b = q
        x = jnp.concatenate([a, b[0]])
        turn = jnp.cross(jnp.array([a[0], u[1], 1.0]), n)
        x = jnp.stack([x[1], x[2] * n[0], x[0] ** 2 / 5, x[3] * n[1]]) + fields @ u[np.array([0, 2])]
        return (turn, x[:2]), x[None, 2:]

    def cost(q: tuple, u: Array) -> Array:
        (n, a), b = q
        x = jnp.concatenate([a, b[0]])
        paid = jax.grad(potential, argnums=1)(n, x) @ fields @ u[np.array([0, 2])]
        return u[1] ** 2 / 2 + 2 * x @ x + x[0] ** 4 / 4 + n[2] + paid

    return OptimalControlProblem(Product(Product(SPHERE, Euclidean(2)), Euclidean((1, 2))), dynamics, cost, 3)


def second_order_problem() -> OptimalControlProblem:
    """After one reduction the Hamiltonian is affine in the new control ``x2``; ``P_f`` is curved, of dimension 2."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([q[1] + 0.2 * q[2] ** 2, u[0], u[1] + 0.3 * q[0]])

    def cost(q: Array, u: Array) -> Array:
        return u[1] ** 2 / 2 + q[0] ** 2 * (1 + q[2] ** 2) + q[0] * q[2] + 0.1 * q[2] ** 4 + 0.4 * q[1] * q[2]

    return OptimalControlProblem(Euclidean(3), dynamics, cost, 2)


PROBLEMS = {
    "curved": (lambda: curved_problem(0.0), (0,), 1),
    "costly": (lambda: curved_problem(1.0), (0,), 1),
    "nested": (nested_problem, (0, 2), 1),
    "second order": (second_order_problem, (0,), 2),
    "free actuator": (lambda: SINGULAR["free actuator"]().problem, (2,), 1),
    "aly-chan": (lambda: SINGULAR["aly-chan"]().problem, (0,), 1),
}
LARGE = [
    pytest.param(name, marks=pytest.mark.slow)
    for name in ("curved", "costly", "nested", "second order", "free actuator")
]


@cache
def chain_of(name: str):
    problem, singular, _ = PROBLEMS[name]
    chain = reduce_until_regular(problem())
    assert chain.reductions[0].singular == singular
    return chain


def midpoint(problem: OptimalControlProblem) -> CotangentLift:
    return CotangentLift(Midpoint(default_retraction(problem.manifold)))


@cache
def integrator_of(name: str) -> ReducedIntegrator:
    chain = chain_of(name)
    return ReducedIntegrator(midpoint(chain.problem), chain)


def two_form(bundle: CotangentBundle, z: tuple, frame: tuple) -> Array:
    """Matrix of the canonical form on the vectors of a frame."""
    return jax.vmap(lambda a: jax.vmap(lambda b: bundle.two_form(z, a, b))(frame))(frame)


@cache
def chart_facts(name: str) -> Callable:
    chain = chain_of(name)
    problem, reduced = chain.problem, chain.reduced
    below, above = CotangentBundle(reduced.manifold), CotangentBundle(problem.manifold)
    split, rest = ControlAffineSplitting(problem, PROBLEMS[name][1]), jnp.zeros(problem.controls.dimension)

    def facts(key: Array) -> dict:
        z = below.random_point(key)

        def lifted(z: tuple) -> tuple:
            at = chain.up(z, rest)
            return (at.q, at.p), at

        up, push, at = jax.linearize(lifted, z, has_aux=True)
        control, frame = find_control(reduced, *z, rest)[0], below.basis(z)
        rate = below.sharp(z, jax.grad(lambda z: reduced.hamiltonian(*z, control))(z))
        none = jnp.zeros(len(split.singular))
        return {
            "the control is found": (1.0 * at.found, jnp.ones(())),
            "points satisfy phi = 0": (split.primary(*up), none),
            "points satisfy psi = 0": (split.secondary(*up), none),
            "down is the inverse of up": (chain.down(*up)[0], z),
            "the forms are the same": (two_form(above, up, jax.vmap(push)(frame)), two_form(below, z, frame)),
            "the motions are the same": (
                push(rate),
                above.sharp(up, jax.grad(lambda y: problem.hamiltonian(*y, at.u))(up)),
            ),
            "the energies are the same": (problem.hamiltonian(*up, at.u), reduced.hamiltonian(*z, control)),
        }

    return jax.jit(facts)


@pytest.mark.parametrize("name", ["aly-chan", *LARGE])
@pytest.mark.slow
def test_the_final_manifold_is_a_cotangent_bundle_in_the_reduced_coordinates(name):
    assert len(chain_of(name).reductions) == PROBLEMS[name][2]
    for seed in range(5):
        for fact, (found, expected) in chart_facts(name)(jax.random.key(seed)).items():
            size = vec.size((found, expected))
            assert vec.size(vec.subtract(found, expected)) <= 1e-12 * (1 + size), fact


@cache
def kernel(name: str) -> Callable:
    """Image of a step from a point of ``P_f``, the form before and after on a basis of its tangent space, and the
    constraints."""
    chain, integrator = chain_of(name), integrator_of(name)
    problem, below, above = (
        chain.problem,
        CotangentBundle(chain.reduced.manifold),
        CotangentBundle(chain.problem.manifold),
    )
    split, rest = ControlAffineSplitting(problem, PROBLEMS[name][1]), jnp.zeros(chain.problem.controls.dimension)

    def facts(h: Array, y: tuple) -> tuple:
        z, lift = jax.linearize(lambda y: chain.up(y, rest)[:2], y)
        memory = integrator.begin(problem, *z)
        z1, push = jax.linearize(lambda z: integrator.step(problem, h, *z, memory)[:2], z)
        frame = jax.vmap(lift)(below.basis(y))
        return (
            two_form(above, z, frame),
            two_form(above, z1, jax.vmap(push)(frame)),
            (split.primary(*z1), split.secondary(*z1)),
        )

    return jax.jit(facts)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["curved", "costly", "free actuator"])
def test_steps_keep_the_final_manifold_and_its_form(name):
    q, p = CotangentBundle(chain_of(name).reduced.manifold).random_point(jax.random.key(1))
    y = q, vec.scale(0.5, p)
    for h in STEPS:
        before, after, constraints = kernel(name)(h, y)
        assert np.max(np.abs(before)) > 0.1
        assert np.max(np.abs(after - before)) < 1e-13
        assert vec.size(constraints) < 1e-14


def runner(integrator: Integrator, name: str = "curved") -> Callable:
    """Compiled ``(z, h, n) -> `` the state after ``n`` steps of size ``h``."""
    problem = chain_of(name).problem

    def run(z: tuple, h: Array, n: Array) -> Array:
        def advance(_: int, last: tuple) -> tuple:
            new = integrator.step(problem, h, *last[:2], last[2])
            return new.q, new.p, new.unknowns

        q, p, _ = jax.lax.fori_loop(0, n, advance, (*z, integrator.begin(problem, *z)))
        return jnp.concatenate([q, p])

    return jax.jit(run)


def start_of(name: str) -> tuple:
    at = chain_of(name).up((jnp.array([0.2, -0.4]), jnp.array([0.3, 0.1])), jnp.zeros(1))
    return at.q, at.p


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 4])
def test_order(order):
    step = integrator_of("curved")
    run, start, counts = (
        runner(step if order == 2 else Composition(step)),
        start_of("curved"),
        np.array([10, 20, 40, 160]),
    )
    ends = [np.asarray(run(start, 1.0 / n, n)) for n in counts]
    errors = np.array([np.max(np.abs(end - ends[-1])) for end in ends[:-1]])
    assert slope(1 / counts[:-1], errors, 1e-13) == pytest.approx(order, abs=0.06)


def against_rattle(name: str, counts: np.ndarray) -> np.ndarray:
    """How far the trajectories of both methods are apart after unit time."""
    rattle, z = RattleIntegrator(midpoint(chain_of(name).problem), (0,)), start_of(name)
    runs = runner(integrator_of(name), name), runner(rattle, name)
    return np.array([np.max(np.abs(np.subtract(*(run(z, 1.0 / n, n) for run in runs)))) for n in counts])


@pytest.mark.slow
def test_rattle_is_the_same_method_where_the_leaves_are_straight():
    assert np.max(against_rattle("curved", np.array([5, 20]))) < 1e-13


@pytest.mark.slow
def test_rattle_converges_to_the_same_trajectory_where_they_are_not():
    counts = np.array([10, 20, 40])
    apart = against_rattle("costly", counts)
    assert apart[-1] < 1e-4
    assert slope(1 / counts, apart, 1e-13) == pytest.approx(2, abs=0.06)


@pytest.mark.slow
def test_aly_chan_is_an_oscillator_that_the_midpoint_rule_turns_exactly():
    n, h = 20, np.pi / 40
    path = integrate(
        chain_of("aly-chan").problem, integrator_of("aly-chan"), (jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0])), h, n
    )
    angles = 2 * np.arctan(h / 2) * np.arange(n + 1)
    np.testing.assert_allclose(path.q, np.stack([np.sin(angles), np.cos(angles)], axis=1), atol=1e-14)
    np.testing.assert_allclose(path.p, np.stack([np.cos(angles), 0 * angles], axis=1), atol=1e-14)
    np.testing.assert_allclose(path.controls[:, 0], -np.sin(angles[1:]), atol=1e-14)
    np.testing.assert_allclose(path.stage_times, path.times[1:], atol=1e-15)


@pytest.mark.slow
def test_a_chain_of_integrators_reduces_to_a_point():
    problem = SINGULAR["chain of 2"]().problem
    chain = reduce_until_regular(problem)
    assert chain.reduced.manifold == Euclidean(0)
    rest = (jnp.zeros(2), jnp.zeros(2))
    path = integrate(problem, ReducedIntegrator(midpoint(problem), chain), rest, 0.1, 3)
    assert vec.size((path.q, path.p, path.controls)) == 0


def test_it_is_made_from_a_classification_where_it_applies():
    found = classified("aly-chan")
    method, choice = singular_integrator(found, Midpoint(default_retraction(found.problem.manifold)), "reduced")
    assert isinstance(method, ReducedIntegrator)
    assert str(choice) == "reduced: P_f is the cotangent bundle of R^1, by Goh's reduction once"
    with pytest.raises(NotApplicableError, match="gauge control"):
        ReducedIntegrator.suited(classified("academic"), method.lift, None)


class Weighted(eqx.Module):
    """Aly and Chan's running cost with another weight of ``x1``, the frequency squared."""

    weight: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return (q[1] ** 2 - self.weight * q[0] ** 2) / 2


@pytest.mark.slow
def test_derivatives_by_the_data_of_the_problem_and_batches():
    problem, n, h = chain_of("aly-chan").problem, 5, 0.1

    def end(weight: Array) -> Array:
        cost = Weighted(weight)
        system = OptimalControlProblem(problem.manifold, problem.dynamics, cost, problem.controls)
        return integrate(system, integrator_of("aly-chan"), (jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0])), h, n).q[
            -1, 0
        ]

    def exact(weight: Array) -> Array:
        frequency = jnp.sqrt(weight)
        return jnp.sin(2 * n * jnp.arctan(frequency * h / 2)) / frequency

    weights = jnp.array([1.0, 2.0])
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(end)))(weights)
    expected = jax.vmap(jax.value_and_grad(exact))(weights)
    np.testing.assert_allclose((values, slopes), expected, rtol=1e-12)


@pytest.mark.slow
def test_the_discretization_is_restricted_factor_by_factor():
    rigid = chain_of("free actuator")
    cayley = ReducedIntegrator(CotangentLift(Euler(Cayley(rigid.problem.manifold))), rigid)
    assert eqx.tree_equal(cayley.regular.discretization, Euler(Cayley(rigid.reduced.manifold)))
    adjoint = Adjoint(Euler(Cayley(rigid.problem.manifold)))
    with pytest.raises(InvalidInputError, match="give ReducedIntegrator a discretization"):
        ReducedIntegrator(CotangentLift(adjoint), rigid)
    given = Adjoint(Euler(Cayley(rigid.reduced.manifold)))
    assert ReducedIntegrator(CotangentLift(adjoint), rigid, given).regular.discretization is given


PLANE, QUADRATIC = Euclidean(2), lambda q, u: q @ q / 2
REFUSED = {
    "not constant": (PLANE, lambda q, u: jnp.stack([u[0], q[0] * u[0]]), QUADRATIC, 1, (0,)),
    "not affine": (PLANE, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: q @ q + u @ u, 1, (0,)),
    "not Euclidean": (SPHERE, lambda q, u: jnp.cross(jnp.array([0.0, 0.0, 1.0]), q) * u[0], QUADRATIC, 1, (0,)),
    "gauge, or P_f empty": (PLANE, lambda q, u: jnp.stack([u[0] + u[1], q[0]]), QUADRATIC, 2, (0, 1)),
    "do not commute": (PLANE, lambda q, u: u, lambda q, u: q @ q / 2 + q[0] * u[1], 2, (0, 1)),
    "rough": (PLANE, lambda q, u: jnp.stack([u[0], q[0]]), lambda q, u: q @ q / 2 + jnp.sin(40 * q[0]) * u[0], 1, (0,)),
    "singular in combinations": (PLANE, lambda q, u: u, lambda q, u: (q[0] + q[1]) ** 2 / 2, 2, (0, 1)),
    "nothing to reduce": (PLANE, lambda q, u: u, lambda q, u: u @ u / 2, 2, None),
}


@pytest.mark.parametrize("reason", REFUSED)
@pytest.mark.usual(1)
def test_problems_without_a_reduction_are_refused_with_the_reason(reason):
    *problem, singular = REFUSED[reason]
    with pytest.raises(InvalidInputError, match=reason):
        reduce_until_regular(OptimalControlProblem(*problem), singular)


class Along(eqx.Module):
    """``x' = u``, ``y' = bend x u``: a field that is constant for ``bend`` zero only."""

    bend: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return jnp.stack([u[0], self.bend * q[0] * u[0]])


def test_fields_are_constant_to_rounding_or_not_at_all():
    for share in (0.0, 1e-3, 0.1, 10.0, 1e3, 1e9, 1e13):
        problem = OptimalControlProblem(PLANE, Along(jnp.array(share * EPS**CONSTANT_POWER)), QUADRATIC, 1)
        if share < 1:
            np.testing.assert_allclose(GohReduction(problem, (0,)).directions, [[1], [0]], atol=1e-13)
        else:
            with pytest.raises(InvalidInputError, match="their fields are not constant"):
                GohReduction(problem, (0,))


@pytest.mark.slow
def test_a_start_off_the_final_manifold_and_another_problem_are_refused():
    integrator = integrator_of("aly-chan")
    off = (jnp.array([0.0, 1.0]), jnp.array([0.9, 0.0]))
    with pytest.raises(NotOnManifoldError, match="is not on the constraint manifold"):
        integrate(chain_of("aly-chan").problem, integrator, off, 0.1, 1)
    with pytest.raises(InvalidInputError, match="another problem"):
        integrate(SINGULAR["chain of 2"]().problem, integrator, off, 0.1, 1)
    with pytest.raises(InvalidInputError, match="reduce_until_regular"):
        ReducedIntegrator(integrator.lift, (0,))
