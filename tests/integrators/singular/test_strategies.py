"""The strategies on P_f: which one is chosen and why, what each preserves, and which one must fail to."""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import Composition, OptimalControlProblem, classify, integrate, symplecticity_defect
from retrax.integrators.initial_value.step import StepResult
from retrax.integrators.singular import SingularIntegrator, singular_integrator
from retrax.integrators.singular.integrability.derivative_array import hamiltonian_field
from retrax.integrators.singular.strategies import STRATEGIES, strategy_choice
from retrax.manifolds import Euclidean, InvalidInputError, NotOnManifoldError, Sphere
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import CotangentLift, DiscretizationMap, Exponential, Gauss, Midpoint, Theta, default_retraction

from tests.integrators.singular.cases import classified, known, scaled
from tests.support.numerics import slope

PLANE = Euclidean(2)
MIDPOINT = Midpoint(default_retraction(PLANE))
STEPS = np.array([0.2, 0.1, 0.05])
STARTS = {
    "academic": ([0.7, 0.0], [-0.3, 0.2]),
    "sphere": ([-0.93, 0.09, 0.3557], [0.11, -0.01, 0.295]),
    "curved arc": ([0.135, 0.225, -0.18], [0.045, 0.27, -0.225]),
    "massless particle": ([0.3, 0.2], [-0.1, 0.15]),
    "aly-chan": ([0.3, -0.2], [-0.2, 0.0]),
}
STRATEGY = {"aly-chan": "reduced"}  # otherwise the one that is chosen


def choose(name: str, strategy: str | None = None, discretization: DiscretizationMap | None = None, **options):
    """The integrator of a problem with known answers, and the choice of it."""
    classification = classified(name)
    midpoint = Midpoint(default_retraction(classification.problem.manifold))
    return singular_integrator(classification, discretization or midpoint, strategy, **options)


def chosen(name: str, *arguments, **options) -> SingularIntegrator:
    return choose(name, *arguments, **options)[0]


def start(name: str):
    return classified(name).manifold.nearby(
        jax.tree.map(jnp.asarray, STARTS[name], is_leaf=lambda a: isinstance(a, list))
    )


@eqx.filter_jit
def gap_after(classification, method, z, h):
    """The equations of ``P_f`` after one step from ``z``."""
    new = method.step(classification.problem, h, *z, method.begin(classification.problem, *z))
    return vec.size(classification.equations((new.q, new.p)))


def one_step(name, method, h):
    """Largest change of ``omega_f`` over one step, and the equations of ``P_f`` at the end."""
    classification, z = classified(name), start(name)
    change = symplecticity_defect(classification.presymplectic, method, classification.problem, z, h)
    return float(change), float(gap_after(classification, method, z, jnp.asarray(h)))


@pytest.mark.slow
def test_rattle_keeps_a_curved_final_manifold_and_its_form():  # on the sphere: the test of that example
    name = "curved arc"
    method, choice = choose(name)
    assert (choice.strategy, list(choice.refusals)) == ("rattle", ["direct"])
    assert str(choice).startswith(f"rattle: {choice.reason};\nnot direct: steps with stages in S_f leave P_f")
    assert max(map(len, str(choice).splitlines())) <= 110
    assert np.max(np.abs(classified(name).presymplectic.matrix(start(name)))) > 0.1
    for h in STEPS:
        change, gap = one_step(name, method, h)
        assert gap < 1e-14
        assert change < 1e-13


@pytest.mark.slow
def test_a_projection_keeps_the_manifold_but_not_its_form():  # on the sphere: the test of that example
    name = "curved arc"
    method, choice = choose(name, "project")
    assert not method.presymplectic
    assert "not presymplectic" in choice.reason
    assert choice.refusals == {}  # nothing was tried before the one that was asked for
    facts = np.array([one_step(name, method, h) for h in STEPS / 2])
    assert np.max(facts[:, 1]) < 1e-13
    assert slope(STEPS / 2, facts[:, 0], 1e-13) == pytest.approx(3, abs=0.2)


@pytest.mark.slow
def test_stages_on_an_affine_final_manifold_keep_its_form():
    change, gap = one_step("academic", chosen("academic", "direct"), 0.2)
    assert classified("academic").rank
    assert change < 1e-14
    assert gap < 1e-15


@pytest.mark.slow
def test_constraints_at_the_stages_keep_the_canonical_form_of_all_of_the_cotangent_bundle():
    problem, z = classified("massless particle").problem, start("massless particle")
    method = chosen("massless particle")

    def step(z):
        new = method.step(problem, 0.2, *z, method.begin(problem, *z))
        return jnp.concatenate([new.q, new.p])

    by_q, by_p = jax.jit(jax.jacfwd(step))(z)
    matrix = jnp.concatenate([by_q, by_p], axis=1)
    form = np.kron(np.array([[0, 1], [-1, 0]]), np.eye(2))
    np.testing.assert_allclose(matrix.T @ form @ matrix, form, atol=1e-13)


@eqx.filter_jit
def end(problem, methods, z, count):
    """The state after ``count`` steps over a unit of time, each in equal substeps of the methods."""

    def step(_, last):
        for method in methods:
            last = method.step(problem, 1 / count / len(methods), last.q, last.p, last.unknowns)
        return last

    first = StepResult(*z, methods[0].begin(problem, *z), jnp.array(True))
    last = jax.lax.fori_loop(0, count, step, first)
    return jnp.concatenate([last.q, last.p])


def measured_order(name, methods, expected):
    problem, z = classified(name).problem, start(name)
    coarse, fine, finest = (end(problem, methods, z, jnp.array(n)) for n in (16, 32, 128))
    errors = np.array([np.max(np.abs(coarse - finest)), np.max(np.abs(fine - finest))])
    # The reference has an error of its own: (1 - 8^-order) / (1 - 4^-order) corrects it.
    return np.log2(errors[0] / errors[1]) - np.log2((1 - 8.0**-expected) / (1 - 4.0**-expected))


def pairs(method):
    """Steps of two halves: near the identity for small steps where one half alone is near a reflection."""
    return Composition(method, (0.5, 0.5))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "strategy", "composed", "order"),
    [
        ("sphere", "rattle", Composition, 4),
        ("curved arc", "rattle", Composition, 4),
        ("academic", "direct", Composition, 4),
        ("aly-chan", "reduced", Composition, 4),
        ("massless particle", "stage", Composition, 2),
        ("massless particle", "stage", lambda method: Composition(pairs(method)), 4),
        ("massless particle", "project", Composition, 3),
    ],
)
def test_order_of_steps_and_of_their_composition(name, strategy, composed, order):
    method = chosen(name, strategy)
    assert measured_order(name, (method,), 2) == pytest.approx(2, abs=0.1)
    assert measured_order(name, (composed(method),), order) == pytest.approx(order, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", ["sphere", "academic", "massless particle", "aly-chan"])
def test_a_lift_beside_the_midpoint_is_of_order_one_and_of_order_two_with_its_adjoint(name, order):
    problem = classified(name).problem
    pair = (Theta(default_retraction(problem.manifold), theta) for theta in (0.3, 0.7))
    methods = tuple(chosen(name, STRATEGY.get(name), discretization) for discretization in pair)[:order]
    assert measured_order(name, methods, order) == pytest.approx(order, abs=0.1)


@pytest.mark.slow
def test_rattle_is_of_order_two_through_another_retraction():
    method = chosen("sphere", "rattle", Midpoint(Exponential(classified("sphere").problem.manifold)))
    assert measured_order("sphere", (method,), 2) == pytest.approx(2, abs=0.05)


@pytest.mark.slow
def test_steps_of_the_paper_s_definition_do_not_compose_on_a_curved_final_manifold():
    """``(z, z') = R_d^{T*}(h V)`` with ``V`` in ``S_f``: its ends leave ``P_f`` by ``O(h^2)``, and no step begins at
    ``z'``.

    The nearest beginning of one is ``O(h^3)`` away.
    """
    c = classified("massless particle")
    lift = CotangentLift(Midpoint(default_retraction(c.problem.manifold)))

    @jax.jit
    def ends(q, h):
        """Both ends of the step with its stage over ``q``."""
        z = q, (1 + q @ q) / 2 * jnp.stack([-q[1], q[0]])
        velocity = hamiltonian_field(c.problem, z, c.control(*z))
        return [jnp.concatenate(end) for end in lift(z, vec.scale(h, velocity))]

    off, missed = [], []
    for h in STEPS:
        q = jnp.array(STARTS["massless particle"][0])
        end, q = ends(q, h)[1], q + (ends(q, h)[1] - ends(q, h)[0])[:2]
        off.append(np.max(np.abs(c.equations((end[:2], end[2:])))))
        for _ in range(6):  # Gauss-Newton
            gap, slopes = ends(q, h)[0] - end, jax.jacfwd(ends)(q, h)[0]
            q = q - jnp.linalg.lstsq(slopes, gap)[0]
        missed.append(np.linalg.norm(ends(q, h)[0] - end))
    assert slope(STEPS, np.array(off), 1e-13) == pytest.approx(2, abs=0.2)
    assert slope(STEPS, np.array(missed), 1e-13) == pytest.approx(3, abs=0.2)


@pytest.mark.slow
def test_constraints_at_the_stages_leave_the_nodes_beside_the_manifold():
    method, choice = choose("massless particle")
    assert choice.strategy == "stage"
    classification, z, gaps = classified("massless particle"), start("massless particle"), []
    equations = jax.vmap(lambda q, p: classification.equations((q, p)))
    for n in (20, 40):
        path = integrate(classification.problem, method, z, 1 / n, n)
        gaps.append(float(jnp.max(jnp.abs(equations(path.q, path.p)))))
    assert np.log2(gaps[0] / gaps[1]) == pytest.approx(2, abs=0.2)


class Coiled(eqx.Module):
    """The paper's example in the coordinate ``w = y + bend x^2``: ``P_f = {w = 0}`` is flat for ``bend`` zero
    only."""

    bend: Array

    def level(self, q):
        return q[1] + self.bend * q[0] ** 2

    def __call__(self, q, u):
        rate = jnp.sin(q[0]) + u[0]
        return jnp.stack([rate, self.level(q) - 2 * self.bend * q[0] * rate])

    def cost(self, q, u):
        return (q @ q + u[0] ** 2) / 2 + q[0] * u[0] + self.level(q) * u[1]


@lru_cache
def coiled(bend: float):
    functions = Coiled(jnp.asarray(bend))
    return classify(OptimalControlProblem(PLANE, functions, functions.cost, 2))


def by_cosine(t, q, p):
    return jnp.cos(t)


@pytest.mark.slow
def test_a_composable_problem_is_integrated_directly_with_the_gauge_that_is_given():
    found, z = coiled(0.0), tuple(map(jnp.asarray, STARTS["academic"]))
    ends = {}
    for n in (16, 32):
        path = integrate(found.problem, singular_integrator(found, MIDPOINT, gauge=by_cosine)[0], z, 1 / n, n)
        ends[n] = np.array([path.q[-1, 0], path.p[-1, 0], path.p[-1, 1]])
        assert np.max(np.abs(path.q[:, 1])) < 1e-15
        np.testing.assert_allclose(path.controls[:, 1], np.cos(path.stage_times), atol=1e-14)
    # The paper's values, and p_y' = -p_y + cos t from 1/5.
    p_y = 0.2 * np.exp(-1) + (np.sin(1) + np.cos(1) - np.exp(-1)) / 2
    np.testing.assert_allclose(ends[32] + (ends[32] - ends[16]) / 3, [0.3473665, -0.3445070, p_y], atol=3e-7)


def test_the_choice_flips_where_a_final_manifold_is_curved_by_more_than_rounding(monkeypatch):
    # Without one that no gauge control admits, and that takes longest to compile.
    others = {name: strategy for name, strategy in STRATEGIES.items() if name != "rattle"}
    monkeypatch.setattr(strategy_choice, "STRATEGIES", others)
    for bend, name in ((0.0, "direct"), (1e-16, "direct"), (1e-10, "project"), (1e-4, "project"), (0.1, "project")):
        found = coiled(bend)
        assert {s.signature for s in found.strata} == {(1, 1, 2)}, (bend, str(found))
        method, choice = singular_integrator(found, MIDPOINT, gauge=by_cosine)
        assert choice.strategy == name, (bend, str(choice))
        assert (
            ("direct" in choice.refusals)
            == ("do not compose" in choice.refusals.get("direct", ""))
            == (name != "direct")
        )
        assert method.presymplectic == (name == "direct")


@pytest.mark.slow
def test_without_a_gauge_the_control_has_least_norm():
    method, choice = choose("academic")
    assert any("gauge controls of least norm" in remark for remark in choice.remarks)
    path = integrate(classified("academic").problem, method, start("academic"), 0.1, 3)
    np.testing.assert_allclose(path.controls[:, 1], 0, atol=1e-14)


@pytest.mark.parametrize(
    ("gauge", "message"),
    [
        (
            1.0,
            r"gauge must be a function gauge\(t, q, p\) that returns the gauge control u\[1\], shape \(1,\), got 1.0; "
            r"try",
        ),
        (lambda t: t, r"it fails with .* takes 1 positional argument but 3 were given; try"),
        (lambda t, q, p: jnp.zeros(2), r"shape \(1,\); it returns 2 numbers"),
        (lambda t, q, p: 1 / t, r"at t = 0, q = .* it returns \[inf\], expected finite numbers"),
        (lambda t, q, p: "none", "it fails with"),
    ],
)
def test_a_gauge_that_is_none_is_refused(gauge, message):
    with pytest.raises(InvalidInputError, match=message):
        singular_integrator(coiled(0.0), MIDPOINT, gauge=gauge)


@pytest.mark.slow
def test_what_does_not_apply_is_refused_with_what_does():
    beside = Theta(default_retraction(Euclidean(2)), 0.3)
    with pytest.raises(InvalidInputError, match=r"(?s)not stage: the deviation of the nodes .* grows") as refusal:
        chosen("massless particle", "stage", beside)
    assert str(refusal.value).count("not stage: ") == 1
    with pytest.raises(InvalidInputError, match=r"(?s)not rattle: .*what applies is\ndirect"):
        chosen("academic", "rattle")
    with pytest.raises(InvalidInputError, match="unknown strategy 'magic'"):
        chosen("academic", "magic")
    with pytest.raises(InvalidInputError, match=r"(?s)the lift of a discretization map, got Gauss.*; try Midpoint"):
        chosen("academic", None, Gauss(2, default_retraction(Euclidean(2))))
    with pytest.raises(InvalidInputError, match="no gauge controls"):
        chosen("aly-chan", gauge=lambda t, q, p: jnp.zeros(1))
    problem, method = classified("academic").problem, chosen("academic")
    with pytest.raises(NotOnManifoldError, match="not on P_f"):
        integrate(problem, method, (jnp.array([0.7, 0.1]), jnp.zeros(2)), 0.1, 1)
    other = OptimalControlProblem(problem.manifold, problem.dynamics, lambda q, u: u @ u, 2)
    with pytest.raises(InvalidInputError, match="made for another problem"):
        integrate(other, method, start("academic"), 0.1, 1)


@pytest.mark.slow
def test_derivatives_of_a_trajectory_and_batches():
    method, problem, z = chosen("academic"), classified("academic").problem, start("academic")

    def end(x0):
        path = integrate(problem, method, (jnp.stack([x0, 0.0]), z[1]), 0.1, 5)
        return path.q[-1, 0]

    h = 1e-5
    expected = (end(0.7 + h) - end(0.7 - h)) / (2 * h)
    np.testing.assert_allclose(jax.grad(end)(0.7), expected, rtol=1e-8)
    np.testing.assert_allclose(jax.jvp(end, (0.7,), (1.0,))[1], expected, rtol=1e-8)
    np.testing.assert_allclose(jax.vmap(end)(jnp.array([0.7, 0.2])), [end(0.7), end(0.2)], atol=1e-14)


class Drift(eqx.Module):
    """``(a x + u1, y)``, the dynamics of the paper's example with ``f = a x``."""

    a: jax.Array

    def __call__(self, q, u):
        return jnp.stack([self.a * q[0] + u[0], q[1]])


@pytest.mark.slow
def test_a_trajectory_depends_on_the_data_of_the_problem_that_is_stepped():
    cost = classified("academic").problem.running_cost

    def problem(a):
        return OptimalControlProblem(Euclidean(2), Drift(a), cost, 2)

    method, _ = singular_integrator(classify(problem(jnp.array(0.5))), Midpoint(default_retraction(Euclidean(2))))

    def end(a):
        return integrate(problem(a), method, start("academic"), 0.02, 50).q[-1, 0]

    def closed(a):
        rate = 1 - a
        return 0.7 * jnp.exp(-rate) - 0.3 * jnp.sinh(rate) / rate

    for a in (jnp.array(0.5), jnp.array(0.2)):
        np.testing.assert_allclose(jax.grad(end)(a), jax.grad(closed)(a), rtol=1e-3)
    np.testing.assert_allclose(jax.vmap(end)(jnp.array([0.5, 0.2])), [closed(0.5), closed(0.2)], rtol=1e-3)


@pytest.mark.slow
def test_costates_of_rattle_are_proportional_to_the_cost():
    problem, method = known("aly-chan").problem, classified("aly-chan")
    method, _ = singular_integrator(method, Midpoint(default_retraction(problem.manifold)), "rattle")
    q, p = start("aly-chan")

    def end(a):
        return integrate(scaled(problem, (1.0, a, 1.0)), method, (q, a * p), 0.1, 4).p[-1, 0]

    expected = end(1.0)
    assert abs(expected) > 1e-2
    np.testing.assert_allclose(jax.grad(end)(2.0), expected, rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(end)(jnp.array([2.0, 3.0])), [2 * expected, 3 * expected], rtol=1e-12)


@pytest.mark.slow
def test_gauge_controls_that_lie_on_a_manifold_have_to_be_given():
    turned = OptimalControlProblem(Euclidean(1), lambda q, u: q, lambda q, u: q @ q / 2, Sphere(1))
    with pytest.raises(InvalidInputError, match=r"(?s)no strategy applies:.*give gauge"):
        singular_integrator(classify(turned), Midpoint(default_retraction(Euclidean(1))))
