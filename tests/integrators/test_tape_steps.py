"""Steps on the tape: the numbers of XLA, the failures of XLA, one trajectory and many."""

from functools import cache
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    KAHAN_LI_6,
    Composition,
    PresymplecticIntegrator,
    Result,
    SymplecticIntegrator,
    integrate,
    integrate_many,
)
from retrax.integrators.initial_value import tape_steps
from retrax.manifolds import SE, Euclidean, InvalidInputError, LevelSet, NotOnManifoldError, U
from retrax.retractions import Cayley, CotangentLift, Gauss, Projection, Theta, default_retraction

from tests.support.numerics import norm

from .problems import ENERGIES, KINEMATIC, RIGID, SO3, SPHERE, pendulum_energy

KEY = jax.random.key(3)
PLANE, POSES, UNITARY = Euclidean(2), SE(3), U(2)


def lifted(retraction, theta=0.5) -> CotangentLift:
    return CotangentLift(Theta(retraction, theta))


def quartic(q, p):
    """A nonlinear oscillator."""
    return p @ p / 2 + (q @ q) ** 2 / 4 + q[0] ** 2


def squares(q, p):
    """A Hamiltonian of any arrays, real or complex."""
    pairs = zip(*map(jax.tree.leaves, (q, p)), strict=True)
    return sum(jnp.sum(jnp.abs(b) ** 2) / 2 + jnp.sum(jnp.real(a) ** 4) for a, b in pairs)


CASES = {
    "rotations": (ENERGIES["SO3"], SymplecticIntegrator(lifted(Cayley(SO3)))),
    "sphere": (pendulum_energy, SymplecticIntegrator(lifted(Projection(SPHERE)))),
    "sphere, order 6": (pendulum_energy, Composition(SymplecticIntegrator(lifted(Projection(SPHERE))), KAHAN_LI_6)),
    "plane, backward Euler": (quartic, SymplecticIntegrator(lifted(default_retraction(PLANE), 1.0))),
    "poses": (squares, SymplecticIntegrator(lifted(default_retraction(POSES)))),
    "unitary": (squares, SymplecticIntegrator(lifted(default_retraction(UNITARY)))),
    "rigid body": (ENERGIES["SO3*R3"], Composition(SymplecticIntegrator(lifted(default_retraction(RIGID))))),
    "Gauss": (ENERGIES["SO3"], SymplecticIntegrator(Gauss(3, Cayley(SO3)))),
    "optimal control by Gauss": (KINEMATIC, PresymplecticIntegrator(Gauss(2, Cayley(SO3)))),
    "optimal control": (KINEMATIC, Composition(PresymplecticIntegrator(lifted(Cayley(SO3))))),
}


SLOW = ("poses", "rigid body", "optimal control by Gauss")  # to compile by XLA


@cache
def point_of(manifold) -> tuple:
    return jax.jit(lambda key: start_of_key(manifold, key))(KEY)


def start_of(method, size=0.5) -> tuple:
    q, v = point_of(method.manifold)
    return q, jax.tree.map(lambda a: size * a, v)


@pytest.mark.long("plane, backward Euler")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in CASES]
)
@pytest.mark.usual("rotations", "plane, backward Euler")
def test_the_tape_computes_the_numbers_of_xla(name):
    """Relative to the size of the numbers, over steps enough for each Jacobian to grow old."""
    system, method = CASES[name]
    start = start_of(method)
    paths = [integrate(system, method, start, 0.1, 12, evaluator=kind) for kind in ("tape", "xla")]
    for mine, theirs in zip(*map(jax.tree.leaves, paths), strict=True):
        assert mine.shape == theirs.shape
        assert mine.dtype == theirs.dtype
        assert norm(mine - theirs) <= 1e-12 * max(1.0, norm(theirs))
    assert paths[0].evaluator.startswith("tape")
    assert str(paths[1].evaluator) == "XLA: it was asked for"


@pytest.mark.parametrize("name", ["sphere", "rotations", "optimal control"])
@pytest.mark.slow
def test_both_fail_at_the_same_step_or_both_succeed(name):
    """Through the step sizes at which Newton's method begins to fail: all of them as one batch, and XLA's as
    another."""
    system, method = CASES[name]
    q, p = start_of(method, 2.0)
    sizes = np.geomspace(0.1, 8.0, 40)  # beyond, rounding decides to where Newton's method wanders
    starts = jax.tree.map(lambda a: np.repeat(np.asarray(a)[None], len(sizes), 0), (q, p))
    mine, theirs = (integrate_many(system, method, starts, sizes, 3, evaluator=kind) for kind in ("tape", "xla"))
    failed = np.asarray(mine.failed_step), np.asarray(theirs.failed_step)
    assert np.any(failed[0] >= 0)
    assert np.any(failed[0] < 0)
    assert np.array_equal(*failed)


@pytest.mark.parametrize("evaluator", ["tape", "xla"])
def test_a_step_fails_exactly_where_its_equations_have_no_solution(evaluator):
    """``c = h (c^2 + 1) / 2`` has none for ``h > 1``, and Newton's method then wanders through finite numbers."""
    method = SymplecticIntegrator(lifted(default_retraction(Euclidean(1))))
    sizes = 1 + np.array([-0.5, -0.01, -1e-4, -1e-6, 1e-6, 1e-4, 0.01, 1.0])
    starts = np.zeros((len(sizes), 1)), np.ones((len(sizes), 1))
    path = integrate_many(lambda q, p: p[0] * (q[0] ** 2 + 1), method, starts, sizes, 1, evaluator=evaluator)
    np.testing.assert_array_equal(path.failed_step, np.where(sizes > 1, 0, -1))


@pytest.mark.parametrize("name", ["rotations", "sphere", "sphere, order 6"])
@pytest.mark.parametrize("size", [0.3, 3.0])
@pytest.mark.usual(2)
def test_what_steps_before_tell_of_the_next_one_changes_nothing(name, size):
    """Each step again from its node, with nothing before it: over trajectories long enough for bases to jump and for
    Jacobians to be renewed, slow and fast."""
    system, method = CASES[name]
    path = integrate(system, method, start_of(method, size), 0.1, 150)
    nodes = jax.tree.map(lambda a: a[:-1], (path.q, path.p))
    again = integrate_many(system, method, nodes, 0.1, 1)
    for whole, single in zip(jax.tree.leaves((path.q, path.p)), jax.tree.leaves((again.q, again.p)), strict=True):
        assert norm(whole[1:] - single[:, 1]) <= 1e-12 * norm(whole)


@pytest.mark.parametrize(
    "method", [lambda r: CotangentLift(Theta(r, 0.5)), lambda r: Gauss(3, r)], ids=["midpoint", "Gauss"]
)
def test_a_system_moves_the_same_beside_another_one_whose_steps_are_found_at_once(method):
    """A pendulum alone, and beside an oscillator, whose equations are linear."""

    def pair(q: tuple, p: tuple) -> jax.Array:
        return (p[0] @ p[0] + 100 * q[0] @ q[0]) / 2 + pendulum(q[1], p[1])

    def pendulum(q: jax.Array, p: jax.Array) -> jax.Array:
        return p @ p / 2 - jnp.cos(q[0])

    line, one, rest = Euclidean(1), np.ones(1), np.zeros(1)
    methods = (SymplecticIntegrator(method(default_retraction(space))) for space in (line * line, line))
    both = integrate(pair, next(methods), ((one, one), (rest, rest)), 0.1, 2000, evaluator="tape")
    alone = integrate(pendulum, next(methods), (one, rest), 0.1, 2000, evaluator="tape")
    assert norm(both.q[1] - alone.q) < 2e-12 * norm(alone.q)


@final
class Circle(LevelSet):
    """``{|x| = 1}`` in the plane, by its equation."""

    def __init__(self) -> None:
        self.shape = (2,)

    def constraint(self, x: jax.Array) -> jax.Array:
        return x @ x - 1


@pytest.mark.slow
def test_a_level_set_is_on_the_tape():
    """Its projections are found by iteration, which is written out."""
    method = SymplecticIntegrator(lifted(default_retraction(Circle())))
    start = np.array([0.6, 0.8]), np.array([-0.4, 0.3])
    found = [integrate(quartic, method, start, 0.1, 20, evaluator=evaluator) for evaluator in ("tape", "xla")]
    assert found[0].evaluator.startswith("tape")
    for one, other in zip((found[0].q, found[0].p), (found[1].q, found[1].p), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-13)
    assert np.ptp(found[0].q[:, 0]) > 0.3


def test_what_has_no_scalars_is_computed_by_xla_and_says_so():
    """Eigenvalues are LAPACK's."""
    method = SymplecticIntegrator(lifted(default_retraction(Euclidean(2))))
    start = np.array([0.6, 0.8]), np.array([-0.4, 0.3])

    def quartic(q, p):
        return p @ p / 2 + jnp.linalg.eigvalsh(jnp.diag(2 + q**2))[0]

    path = integrate(quartic, method, start, 0.1, 2)
    assert "it calls eigh" in path.evaluator
    with pytest.raises(InvalidInputError, match=r"(?s)cannot run on the tape: .*eigh.*try evaluator='automatic'"):
        integrate(quartic, method, start, 0.1, 2, evaluator="tape")
    with pytest.raises(InvalidInputError, match="evaluator must be one of 'automatic', 'tape', 'xla', got 'gpu'"):
        integrate(quartic, method, start, 0.1, 2, evaluator="gpu")


@pytest.mark.parametrize("count", [1, 2, 8, 9, 130])
@pytest.mark.usual(1)
def test_many_trajectories_are_those_of_one_after_the_other(count):
    """On lanes in blocks that are full and not; with step sizes of their own."""
    method = CASES["sphere"][1]
    starts = jax.tree.map(lambda a: jnp.asarray(a[:count]), many_starts())
    sizes = np.linspace(0.05, 0.2, count)
    many = integrate_many(pendulum_energy, method, starts, sizes, 6, save_every=3)
    assert many.q.shape == (count, 3, 3)
    assert many.stage_times.shape == (count, 2)
    for k in {0, count // 2, count - 1}:
        one = integrate(pendulum_energy, method, jax.tree.map(lambda a, k=k: a[k], starts), sizes[k], 6, save_every=3)
        for mine, theirs in zip(
            jax.tree.leaves(jax.tree.map(lambda a, k=k: a[k], many)), jax.tree.leaves(one), strict=True
        ):
            assert norm(mine - theirs) <= 1e-13


def start_of_key(manifold, key) -> tuple:
    q = manifold.random_point(key)
    return q, manifold.random_tangent(key, q)


@cache
def many_starts() -> tuple:
    """Of which each test takes the first, as many as it needs."""
    starts = jax.jit(jax.vmap(lambda key: start_of_key(SPHERE, key)))(jax.random.split(KEY, 130))
    return jax.tree.map(np.asarray, starts)


def test_trajectories_that_stop_are_marked_one_by_one():
    """Among lanes that go on, whose states do not depend on them."""
    method = CASES["sphere"][1]
    starts = jax.tree.map(lambda a: jnp.asarray(a[:70]), many_starts())
    sizes = np.full(70, 0.1)
    whole = integrate_many(pendulum_energy, method, starts, sizes, 4)
    sizes[[3, 66]] = 50.0
    some = integrate_many(pendulum_energy, method, starts, sizes, 4)
    stopped = np.flatnonzero(np.asarray(some.failed_step) >= 0)
    assert stopped.tolist() == [3, 66]
    assert np.flatnonzero(np.asarray(some.result == Result.step_not_solved)).tolist() == [3, 66]
    assert norm(some.q[3] - some.q[3, :1]) == 0
    others = np.setdiff1d(np.arange(70), stopped)
    assert norm(some.q[others] - whole.q[others]) <= 1e-13


def test_starts_and_step_sizes_of_many_are_checked():
    method = CASES["sphere"][1]
    q, p = np.tile([1.0, 0.0, 0.0], (4, 1)), np.zeros((4, 3))
    off = np.concatenate([q[:2], 2 * q[:1], q[:1]])
    with pytest.raises(NotOnManifoldError, match=r"start 2: not on Sphere"):
        integrate_many(pendulum_energy, method, (off, p), 0.1, 2)
    with pytest.raises(NotOnManifoldError, match=r"starts: a covector .*NaN"):
        integrate_many(pendulum_energy, method, (q, np.where(np.arange(4)[:, None] == 2, np.nan, p)), 0.1, 2)
    with pytest.raises(InvalidInputError, match=r"starts is a single one, expected one more axis .*; try integrate"):
        integrate_many(pendulum_energy, method, (q[0], p[0]), 0.1, 2)
    with pytest.raises(InvalidInputError, match=r"one more axis, of one length, in front; got shapes"):
        integrate_many(pendulum_energy, method, (q, p[:3]), 0.1, 2)
    with pytest.raises(
        InvalidInputError, match=r"one number or one for each of the 4 starts, got an array of shape \(3,\)"
    ):
        integrate_many(pendulum_energy, method, (q, p), np.ones(3), 2)
    with pytest.raises(InvalidInputError, match=r"each of step_sizes must be a finite number other than 0"):
        integrate_many(pendulum_energy, method, (q, p), [0.1, 0.1, 0.0, 0.1], 2)


def test_pieces_grow_until_they_take_as_long_as_nobody_waits_for(monkeypatch):
    """Between two of them progress is told and Ctrl-C is heard: some ten times in a second, not after each step."""
    system, integrator = CASES["plane, backward Euler"]
    counts, piece = [], tape_steps.TapeSteps.piece

    def counted(self, done, count, *rest):
        counts.append(count)
        return piece(self, done, count, *rest)

    monkeypatch.setattr(tape_steps.TapeSteps, "piece", counted)
    integrate(system, integrator, (np.ones(2), np.zeros(2)), 1e-3, 4000)
    assert sum(counts) == 4000
    assert len(counts) <= 40
