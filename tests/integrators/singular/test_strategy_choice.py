"""Which strategies apply: swept through numbers that change nothing, and through those that do."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, Result, classify, integrate
from retrax.integrators.singular import SingularIntegrator, singular_integrator
from retrax.integrators.singular.strategies import (
    STRATEGIES,
    NotApplicableError,
    ReducedIntegrator,
    reduce_until_regular,
)
from retrax.integrators.singular.strategies.control_affine_splitting import relative_curvature
from retrax.integrators.singular.strategies.final_dynamics import FinalDynamics
from retrax.integrators.singular.strategies.final_manifold_stages import DirectIntegrator
from retrax.manifolds import ConvergenceError, Euclidean, InvalidInputError
from retrax.retractions import Addition, CotangentLift, Midpoint

from tests.integrators.singular.cases import classified, known

PLANE, SPACE = Euclidean(2), Euclidean(3)
SCALES = 10.0 ** np.array([-6, -3, 3, 6])


def applying(classification) -> list[str]:
    """The strategies that apply."""
    lift, names = CotangentLift(Midpoint(Addition(classification.problem.manifold))), []
    for name, strategy in STRATEGIES.items():
        try:
            strategy.suited(classification, lift, None)
        except NotApplicableError:
            continue
        names.append(name)
    return names


def chosen(classification) -> str:
    """The strategy that is chosen."""
    return singular_integrator(classification, Midpoint(Addition(classification.problem.manifold)))[1].strategy


class Wave(eqx.Module):
    """``time (sin(rate x) + scale u1, y)``: the dynamics of the paper's example in other units of time and controls."""

    rate: Array
    time: Array
    control: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return self.time * jnp.stack([jnp.sin(self.rate * q[0]) + self.control * u[0], q[1]])


class Price(eqx.Module):
    """Its running cost, in other units of cost and controls."""

    cost: Array
    control: Array

    def __call__(self, q: Array, u: Array) -> Array:
        v = self.control * u
        return self.cost * (q @ q / 2 + q @ v + v[0] ** 2 / 2)


def wave(rate: float, time: float = 1.0, cost: float = 1.0, control: float = 1.0) -> OptimalControlProblem:
    r, t, a, c = map(jnp.asarray, (rate, time, cost, control))
    return OptimalControlProblem(PLANE, Wave(r, t, c), Price(a, c), 2)


@pytest.mark.parametrize("weight", [-1e6, 0.0, 1e-6, 1.0, 1e6])
@pytest.mark.usual(1)
def test_the_curvature_of_an_exponential_is_relative_to_the_terms_of_the_hamiltonian(weight):
    """``H = (p - weight) exp(u)`` is its own second derivative; ``|p| exp(u)`` and the cost are its terms."""
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: jnp.exp(u), lambda q, u: weight * jnp.exp(u[0]), 1)
    for p in (-2.0, 3.0):
        found = relative_curvature(problem, (jnp.zeros(1), jnp.array([p])), jnp.zeros(1))
        np.testing.assert_allclose(found, [[(p - weight) / (abs(p) + abs(weight))]], rtol=1e-12)


@pytest.mark.slow
def test_the_choice_does_not_depend_on_the_frequency_of_the_paper_s_example_nor_on_units():
    """Steps that are too long for Newton's method say nothing on whether steps compose."""
    for rate in np.geomspace(0.05, 3, 17):
        assert chosen(classify(wave(rate))) == "direct", rate
    for seed in range(1, 6):
        for rate in (3.0, 1.0, 0.4, 0.2):
            assert chosen(classify(wave(rate, seed), seed=seed)) == "direct", (rate, seed)
    for rate in (0.3, 2.0):
        for scale in SCALES[::3]:
            for units in np.where(np.eye(3, dtype=bool), scale, 1.0):
                assert chosen(classify(wave(rate, *units))) == "direct", (rate, units)


@pytest.mark.slow
def test_a_user_s_function_of_an_integrator_is_compiled_once_for_problems_that_differ_by_rounding():
    """The words of a choice hold measured numbers, and the integrator has none of them."""
    traces, methods, choices = [], [], []

    @jax.jit
    def step(method: SingularIntegrator, problem: OptimalControlProblem, q: Array, p: Array) -> Array:
        traces.append(method)
        return method.step(problem, 0.1, q, p, method.begin(problem, q, p)).q

    for rate in (0.4, 0.4 + 1e-15):
        found = classify(wave(rate))
        method, choice = singular_integrator(found, Midpoint(Addition(PLANE)))
        assert np.all(np.isfinite(step(method, found.problem, *found.manifold.nearby((jnp.ones(2), jnp.zeros(2))))))
        methods.append(method)
        choices.append(choice)
    assert choices[0].reason != choices[1].reason
    assert jax.tree.structure(methods[0]) == jax.tree.structure(methods[1])
    assert hash(jax.tree.structure(methods[0])) == hash(jax.tree.structure(methods[1]))
    assert len(traces) == 1


@pytest.mark.slow
def test_steps_that_are_solved_at_no_length_are_said_to_be():
    c = classified("academic")
    rest = {"t": 0.0}
    gauge = lambda t, q, p: jnp.where(t > rest["t"], jnp.nan, 0.0)[None]  # noqa: E731
    with pytest.raises(
        InvalidInputError, match=r"(?s)not direct: no step with its stage in S_f was solved from any of \d+\s+points"
    ):
        singular_integrator(c, Midpoint(Addition(PLANE)), "direct", gauge=gauge)


class Bent(eqx.Module):
    """The cost of Aly and Chan's problem in some units, of which ``bend`` makes ``P_f`` curved."""

    bend: Array
    size: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return self.size * ((q[1] ** 2 - q[0] ** 2) / 2 + self.bend * (q[0] ** 3 * q[1] + q[1] ** 3))


def bent(bend: float, size: float = 1.0) -> OptimalControlProblem:
    plane = known("aly-chan").problem
    return OptimalControlProblem(PLANE, plane.dynamics, Bent(jnp.asarray(bend), jnp.asarray(size)), 1)


@pytest.mark.slow
def test_steps_compose_to_rounding_or_not_at_all_and_the_choice_flips_once():
    bends = np.array([0.0, *10.0 ** np.array([-16, -14, -13, -12, -11, -10, -8, -4, 0])])
    choices = [chosen(classify(bent(bend))) for bend in bends]
    composing = choices.count("direct")
    assert choices == ["direct"] * composing + ["rattle"] * (len(bends) - composing)
    assert 1e-14 < bends[composing] < 1e-10
    for size in SCALES:
        assert [chosen(classify(bent(bend, size))) for bend in (0.0, 1e-14, 1e-9, 0.1)] == ["direct"] * 2 + [
            "rattle"
        ] * 2


@pytest.mark.slow
def test_a_term_that_no_rank_depends_on_leaves_them_decided_however_small_it_is():
    for bend in (0.0, 1e-300, 1e-30, *np.geomspace(1e-17, 1e-3, 8)):
        c = classify(bent(bend))
        assert [(level.consistent, level.left_out) for level in c.levels] == [(20, 0)] * 3, (bend, str(c))
        assert {s.signature for s in c.strata} == {(2, 0, 2)}, bend


@pytest.mark.slow
def test_a_final_manifold_is_kept_to_rounding_or_the_step_that_leaves_it_is_not_solved():
    """Whatever is chosen keeps it; the definition of the paper, taken by hand, does so or says that it does not."""
    lift, solved = CotangentLift(Midpoint(Addition(PLANE))), []
    for bend in (0.0, 1e-13, 1e-12, 1e-11, 1e-10, 1e-7, 1e-4, 1e-1):
        c = classify(bent(bend))
        start = c.manifold.nearby((jnp.array([0.5, 0.3]), jnp.array([0.3, 0.0])))
        direct = DirectIntegrator(lift=lift, dynamics=FinalDynamics.of(c, None))
        paths = [integrate(c.problem, direct, start, 0.5, 1000, throw=False)]
        solved.append(paths[0].result == Result.successful)
        if 1e-12 <= bend <= 1e-11:
            paths.append(integrate(c.problem, singular_integrator(c, lift.discretization)[0], start, 0.5, 1000))
        for path in paths:
            assert np.max(np.abs(jax.vmap(lambda q, p, c=c: c.equations((q, p)))(path.q, path.p))) < 1e-14, bend
    assert solved == sorted(solved, reverse=True)
    assert solved[0]
    with pytest.raises(ConvergenceError, match="a step of this length leaves P_f"):
        integrate(c.problem, direct, start, 0.5, 1000)


class Carried(eqx.Module):
    """``time (y, u1 , u2 + bend x u1)``."""

    bend: Array
    time: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return self.time * jnp.stack([q[1], u[0], u[1] + self.bend * q[0] * u[0]])


class Paid(eqx.Module):
    """A cost of states, and of the second control, of a size that is a number."""

    weight: Array
    size: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return self.size * (self.weight * u[1] ** 2 / 2 + q @ q / 2 + q[0] ** 4 / 4)


def carried(bend: float, time: float = 1.0, weight: float = 1.0, size: float = 1.0) -> OptimalControlProblem:
    b, t, w, s = map(jnp.asarray, (bend, time, weight, size))
    return OptimalControlProblem(SPACE, Carried(b, t), Paid(w, s), 2)


def reducible(problem: OptimalControlProblem) -> bool:
    """Whether Goh's reduction applies; if not, because fields are not constant."""
    try:
        reduce_until_regular(problem)
    except InvalidInputError as error:
        if "their fields are not constant" in str(error):
            return False
        raise
    return True


@pytest.mark.slow
def test_a_reduction_is_refused_where_fields_change_by_more_than_rounding_whatever_their_units():
    bends = np.array([0.0, *10.0 ** np.array([-16, -14, -13, -12, -11, -10, -8, -4, 0])])
    verdicts = [reducible(carried(bend)) for bend in bends]
    assert verdicts == sorted(verdicts, reverse=True)
    assert 1e-14 < bends[verdicts.index(False)] < 1e-10
    for scale in (1e-12, 1e12):
        for units in np.where(np.eye(3, dtype=bool), scale, 1.0)[:, :2]:
            assert reducible(carried(0.0, units[0], 1.0, units[1]))
            assert not reducible(carried(0.1, units[0], 1.0, units[1]))


@pytest.mark.slow
def test_constraints_that_do_not_commute_are_refused_in_all_units():
    class Coupled(eqx.Module):
        twist: Array
        size: Array

        def __call__(self, q: Array, u: Array) -> Array:
            return self.size * (q @ q / 2 + q[1] * u[0] + (1 + self.twist) * q[0] * u[1])

    def verdict(twist: float, size: float) -> str:
        cost = Coupled(jnp.asarray(twist), jnp.asarray(size))
        try:
            reduce_until_regular(OptimalControlProblem(PLANE, lambda q, u: u, cost, 2))
        except InvalidInputError as error:
            return str(error)
        return ""

    for size in 10.0 ** np.array([-9, 0, 9]):
        assert verdict(0.0, size) == verdict(1e-15, size) == ""
        for twist in (1e-10, 1e-6, 1e-2):
            assert "do not commute" in verdict(twist, size), (twist, size)


@pytest.mark.slow
def test_all_verdicts_stay_through_units_and_small_costs():
    expected = applying(classify(carried(0.0)))
    assert expected == ["direct", "rattle", "reduced", "project"]
    for units in np.where(np.eye(3, dtype=bool), [[SCALES[0]], [SCALES[-1]], [SCALES[1]]], 1.0):
        assert applying(classify(carried(0.0, *units))) == expected, units
        assert applying(classify(carried(0.1, *units))) == ["rattle", "project"], units


@pytest.mark.slow
def test_functions_with_a_domain_are_looked_at_where_they_are_finite():
    """``x' = log y``, ``y' = u``: half of all random states are outside of the domain."""
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u: jnp.stack([jnp.log(q[1]), u[0]]),
        lambda q, u: (q[0] - jnp.sqrt(q[1])) ** 2 / 2 + q[1] ** 2,
        1,
    )
    near = jnp.array([0.3, 1.2]), jnp.array([0.2, 0.0])
    found = classify(problem, near=near)
    assert {"rattle", "reduced"} <= set(applying(found))
    method, _ = singular_integrator(found, Midpoint(Addition(PLANE)), "reduced")
    assert isinstance(method, ReducedIntegrator)
