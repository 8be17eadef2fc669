"""The classification of problems with steep functions and in odd units, against Poisson brackets and exact algebra."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify
from retrax.manifolds import Euclidean, InvalidInputError

EXPONENTS = (1.0, 20.0, 50.0, 200.0, 500.0)
SLOW = pytest.mark.slow


def free(q, u):
    """A cost of nothing."""
    return jnp.zeros(())


def last(q):
    """Minus the first coordinate at the end."""
    return -q[0]


class Rocket(eqx.Module):
    """Goddard's: ``h' = v``, ``v' = (3.5 u - 310 v^2 exp(-k (h - 1))) / m - 1/h^2``, ``m' = -7 u``, in units of h, v,
    m, t."""

    steepness: Array
    units: Array

    def __call__(self, q, u):
        (h, v, m), time = q / self.units[:3], self.units[3]
        drag = 310.0 * v**2 * jnp.exp(-self.steepness * (h - 1))
        return jnp.stack([v, (3.5 * u[0] - drag) / m - 1 / h**2, -7 * u[0]]) * self.units[:3] / time


def rocket(steepness, units=(1.0, 1.0, 1.0, 1.0)):
    dynamics = Rocket(jnp.array(steepness), jnp.array(units))
    return OptimalControlProblem(Euclidean(3), dynamics, free, 1, terminal_cost=last)


def near(units=(1.0, 1.0, 1.0)):
    sizes = jnp.array(units[:3])
    return jnp.array([1.004, 0.13, 0.9]) * sizes, jnp.array([3.0, 0.3, 0.1667]) / sizes


def bracket(f, g):
    """``{f, g} = <f_q, g_p> - <f_p, g_q>``."""

    def value(q, p):
        fq, fp = jax.grad(f, argnums=(0, 1))(q, p)
        gq, gp = jax.grad(g, argnums=(0, 1))(q, p)
        return fq @ gp - fp @ gq

    return value


def terms(function, q, p):
    """What a function is made of: its derivatives times the values of the variables."""
    by_q, by_p = jax.grad(function, argnums=(0, 1))(q, p)
    return jnp.abs(by_q) @ jnp.abs(q) + jnp.abs(by_p) @ jnp.abs(p)


@eqx.filter_jit
def brackets(dynamics, q, p, u):
    """``H1``, ``{H0, H1}`` and ``{H0 + u H1, {H0, H1}}`` at points, over the sizes of their terms; the last by u alone.

    ``H = <p, X>``. Its arguments are arrays, so that all exponents and units have one compiled function.
    """

    def drift(q, p):
        return p @ dynamics(q, jnp.zeros(1))

    def control(q, p):
        return p @ dynamics(q, jnp.ones(1)) - drift(q, p)

    second = bracket(drift, control)
    third, by_control = bracket(drift, second), bracket(control, second)

    def at(q, p, u):
        values = [f(q, p) / terms(f, q, p) for f in (control, second)]
        singular, determining = third(q, p), by_control(q, p)
        sizes = terms(third, q, p), terms(by_control, q, p)
        return (
            jnp.stack(values),
            (singular + u[0] * determining) / (sizes[0] + jnp.abs(u[0]) * sizes[1]),
            determining / sizes[1],
        )

    return jax.vmap(at)(q, p, u)


def certify(c):
    """Its points satisfy the brackets in their own units, and the control printed the one that determines it."""
    s = c.stratum
    first = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (s.q, s.p))
    states = (np.concatenate(leaves)[:21] for leaves in zip(first, s.states, strict=True))
    q, p = (np.pad(leaf, ((0, 21 - len(leaf)), (0, 0)), mode="edge") for leaf in states)
    values, singular, determining = brackets(c.problem.dynamics, q, p, np.tile(s.u, (21, 1)))
    assert np.max(np.abs(values)) < 1e-9, str(c)
    assert np.min(np.abs(determining)) > 1e-9
    assert abs(singular[0]) < 1e-9


UNITS = [
    (1e6, 1e6, 1.0, 1.0),
    (1e-6, 1e-6, 1.0, 1.0),
    (1.0, 1e-6, 1.0, 1e6),
    (1.0, 1e6, 1.0, 1e-6),
    (1.0, 1.0, 1e6, 1.0),
    (1.0, 1.0, 1e-6, 1.0),
    (6.4e6, 7.9e3, 1e5, 8.1e2),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exponents", "scales"), [((500.0,), UNITS[-1:]), pytest.param(EXPONENTS, UNITS, marks=SLOW)], ids=["few", "many"]
)
def test_the_singular_arc_of_goddard_s_rocket_for_all_exponents_and_units(exponents, scales):
    """``P_f``: ``H1 = {H0, H1} = 0``, symplectic, and ``u`` is determined at level 2."""
    for steepness, units in [(k, (1.0, 1.0, 1.0, 1.0)) for k in exponents] + [(500.0, units) for units in scales]:
        c = classify(rocket(steepness, units), near=near(units))
        assert (c.dimension, c.rank, c.gauge_controls, c.k_f, c.stratified) == (4, 4, 0, 2, False), (
            steepness,
            units,
            str(c),
        )
        assert c.reliable
        certify(c)


@pytest.mark.slow
def test_where_functions_overflow_nothing_is_said_of_p_f():
    """Random starts of Goddard's rocket are below its planet: drag is ``exp(500)`` there."""
    c = classify(rocket(500.0))
    assert c.empty
    assert "not shown to be empty" in str(c)


def decided(c):
    """Whether something is said of ``P_f``; what is not decided is said to be so, and refused."""
    if c.reliable and not c.empty:
        return True
    assert "not decided" in str(c) or "not shown to be empty" in str(c), str(c)
    if not c.reliable:
        with pytest.raises(InvalidInputError):
            c.require_reliable()
    return False


class Flat(eqx.Module):
    """A rocket over a plane: ``v' = (3.5 u - 310 v^2 exp(-k h)) / m - 1``; without drag ``h`` and ``v`` do not enter
    ``H``."""

    steepness: Array

    def __call__(self, q, u):
        _, v, m = q
        return jnp.stack([v, (3.5 * u[0] - 310.0 * v**2 * jnp.exp(-self.steepness * q[0])) / m - 1, -7 * u[0]])


@pytest.mark.slow
@pytest.mark.parametrize(("height", "exponents"), [(0.1, (20.0, 290.0, 500.0)), (0.08, np.geomspace(1.0, 500.0, 12))])
def test_where_drag_drowns_in_rounding_nothing_is_decided(height, exponents):
    """Drag is from ``exp(-1/10)`` to ``exp(-50)`` of the rest: ranks are those of the problem with drag, or not
    decided."""
    p, answers = near()[1], []
    for k in exponents:
        problem = OptimalControlProblem(Euclidean(3), Flat(jnp.array(k)), free, 1, terminal_cost=last)
        c = classify(problem, near=(jnp.array([height, 0.13, 0.9]), p))
        answers.append(decided(c))
        assert not answers[-1] or {s.signature for s in c.strata} == {(2, 0, 4)}, (k, str(c))
    assert answers[0]
    assert not answers[-1]


@SLOW
@pytest.mark.parametrize("exponents", [(1.0, 500.0), np.geomspace(1.0, 500.0, 12)], ids=["few", "many"])
def test_where_drag_drowns_beside_gravity_nothing_is_decided(exponents):
    """Goddard's rocket at ``h = 1.05``, where drag is ``exp(-k/20)``, from where it counts to where it is part of no
    sum."""
    q, p = near()
    answers = []
    for k in exponents:
        c = classify(rocket(k), near=(q.at[0].set(1.05), p))
        answers.append(decided(c))
        assert not answers[-1] or (c.dimension, c.rank, c.gauge_controls) == (4, 4, 0), (k, str(c))
    assert answers[0]
    assert not answers[-1]


class Arrhenius(eqx.Module):
    """``x' = -k0 exp(-E/T) x``, ``T' = u``."""

    rate: Array
    energy: Array

    def __call__(self, q, u):
        return jnp.stack([-self.rate * jnp.exp(-self.energy / q[1]) * q[0], u[0]])


@pytest.mark.slow
@pytest.mark.parametrize(
    "energies", [(1.0, 8750.0), pytest.param(np.geomspace(1.0, 1e4, 16), marks=SLOW)], ids=["few", "many"]
)
def test_a_reaction_that_underflows_is_not_taken_for_none(energies):
    """``p_T = 0`` and ``p_x x = 0``, two pieces of dimension 2 with ``p = 0`` excluded; a reaction that is zero leaves
    3."""
    answers = []
    for energy in energies:
        problem = OptimalControlProblem(
            Euclidean(2), Arrhenius(jnp.array(energy), jnp.array(energy)), free, 1, terminal_cost=lambda q: q[0]
        )
        c = classify(problem)
        answers.append(decided(c))
        assert not answers[-1] or {s.signature for s in c.strata} == {(2, 1, 0)}, (energy, str(c))
    assert answers[0]
    assert not answers[-1]


class Weak(eqx.Module):
    """``x' = exp(-k x) u``, or ``x' = y``, ``y' = exp(-k x) u``."""

    steepness: Array

    def __call__(self, q, u):
        return jnp.append(q[1:], jnp.exp(-self.steepness * q[0]) * u[0])


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [1, 2])
def test_a_control_whose_effect_vanishes_at_infinity(dimension):
    """Cost ``|q|^2/2``: ``P_f`` is ``p = x = 0``, or ``p_y = 0``, ``p_x = y``, and ``u`` is determined at level 2."""
    for k in (1.0, 5.0, 20.0, 100.0, 300.0, 400.0, 500.0):
        c = classify(OptimalControlProblem(Euclidean(dimension), Weak(jnp.array(k)), lambda q, u: q @ q / 2, 1))
        if decided(c):
            assert {s.signature for s in c.strata} == {(2, 0, 2 * dimension - 2)}, (k, str(c))
            assert c.k_f == 2


class Plane(eqx.Module):
    """``x' = y``, ``y' = u - y^2 exp(-k x)``, in units of length and time."""

    steepness: Array
    units: Array

    def __call__(self, q, u):
        length, time = self.units[:2]
        x, y = q[0] / length, q[1] * time / length
        return jnp.stack([q[1], (u[0] - y**2 * jnp.exp(-self.steepness * x)) * length / time**2])


class PlaneCost(eqx.Module):
    """``(y^2 + exp(-k x)) / 2``, in units of length, time and cost."""

    steepness: Array
    units: Array

    def __call__(self, q, u):
        length, time, cost = self.units
        x, y = q[0] / length, q[1] * time / length
        return cost / time * (y**2 + jnp.exp(-self.steepness * x)) / 2


@pytest.mark.slow
def test_a_steep_problem_in_the_plane_for_all_exponents_and_units():
    """``P_f = {p2 = 0, {H0, p2} = 0}``, symplectic, and ``u`` is determined at level 2."""
    scales = [(1.0, 1.0, 1.0), (1e-6, 1.0, 1e6), (1e6, 1e6, 1e-6), (1.0, 1e-6, 1.0), (1e3, 1e-3, 1e6)]
    for steepness, units in [(k, scales[0]) for k in EXPONENTS] + [(20.0, units) for units in scales[1:]]:
        data = jnp.array(steepness), jnp.array(units)
        c = classify(OptimalControlProblem(Euclidean(2), Plane(*data), PlaneCost(*data), 1))
        assert {s.signature for s in c.strata} == {(2, 0, 2)}, (steepness, units, str(c))
        assert c.k_f == 2
        assert c.reliable


class Bilinear(eqx.Module):
    """``q' = A q + sum_a u_a (b_a + C_a q)``."""

    drift: Array
    constant: Array
    linear: Array

    def __call__(self, q, u):
        return self.drift @ q + self.constant @ u + jnp.einsum("aij,j,a->i", self.linear, q, u)


class Quadratic(eqx.Module):
    """``<q, W q> / 2``."""

    weights: Array

    def __call__(self, q, u):
        return q @ self.weights @ q / 2


def totally_singular(seed, bilinear):
    """A problem in the plane with two controls that cost nothing and small whole numbers for data."""
    draw = np.random.default_rng(seed)
    drift, constant, linear, weights = (
        draw.integers(-2, 3, s).astype(float) for s in ((2, 2), (2, 2), (2, 2, 2), (2, 2))
    )
    arrays = [jnp.array(a) for a in (drift, constant, linear * bilinear, weights + weights.T)]
    return OptimalControlProblem(Euclidean(2), Bilinear(*arrays[:3]), Quadratic(arrays[3]), 2), constant, linear


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 5, 7])
def test_both_pieces_of_a_bilinear_problem_with_two_controls(seed):
    """``<p, g_a> = 0``: ``p = 0``, or ``det(g_1, g_2) = 0``, on which
    ``{H1, H2}`` determines both controls; any other piece has ``p = 0``.
    """
    problem, constant, linear = totally_singular(seed, 1.0)
    c = classify(problem)
    assert (c.stratum.signature, c.k_f, c.reliable) == ((2, 0, 2), 1, True), str(c)
    assert all(np.max(np.abs(s.p)) < 1e-9 for s in c.strata if s.codimension > 2)
    curve = next(s for s in c.strata if s.codimension == 2)
    for q, p in zip(*curve.states, strict=True):
        fields = constant + np.einsum("aij,j->ia", linear, q)
        assert np.max(np.abs(p @ fields)) < 1e-9 * np.max(np.abs(p)) * np.max(np.abs(fields))
        assert abs(np.linalg.det(fields)) < 1e-9 * np.max(np.abs(fields)) ** 2
