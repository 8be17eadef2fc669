"""A chosen piece of ``P_f`` is kept, by ``nearby`` and by steps, up to where the arc on it ends."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify, integrate, singular_integrator
from retrax.manifolds import ConvergenceError, Euclidean, NotOnManifoldError
from retrax.retractions import Addition, Midpoint

PLANE = Euclidean(2)
STEPS = Midpoint(Addition(PLANE))


class Spin(eqx.Module):
    """``y' = -across y - u z``, ``z' = along (1 - z) + u y``, in axes that are turned."""

    across: Array
    along: Array
    turn: Array

    def __call__(self, q, u):
        y, z = self.turn.T @ q
        return self.turn @ jnp.stack([-self.across * y - u[0] * z, self.along * (1 - z) + u[0] * y])


def saturation(across, along, angle):
    """Least time, and the axes: ``P_f`` is ``y = 0`` with ``u = 0``, and ``z = -along / (2 (across - along))``."""
    c, s = np.cos(angle), np.sin(angle)
    spin = Spin(jnp.asarray(across), jnp.asarray(along), jnp.array([[c, -s], [s, c]]))
    return OptimalControlProblem(PLANE, spin, lambda q, u: 1.0, 1), np.array([[c, -s], [s, c]])


def pieces(problem, **options):
    """The flat piece and the curved one."""
    found = classify(problem, exclude_zero_costate=True, **options)
    chosen = [found.choose(i) for i in range(len(found.strata))]
    (flat,), (curved,) = ([c for c in chosen if c.stratum.flat == flat] for flat in (True, False))
    return flat, curved


def height(across, along):
    return -along / (2 * (across - along))


def square(across, along, y0, t):
    """``y^2`` on the curved piece, which ends where it is zero."""
    rest = along * (1 - height(across, along)) * height(across, along) / across
    return (y0**2 - rest) * np.exp(-2 * across * t) + rest, np.log(1 - y0**2 / rest) / (2 * across)


def distances(q, p, turn, across, along):
    """Of points from the flat piece and from the curved one."""
    (y, z), (py, pz) = turn.T @ q, turn.T @ p
    return max(abs(y), abs(py)), max(abs(z - height(across, along)), abs(pz * y - py * z))


def arc(problem, method, start, h, turn):
    """Times and coordinates of the nodes that were reached, and the step that was not."""
    path = integrate(problem, method, start, h, round(1 / h), throw=False)
    failed = int(path.failed_step)
    count = 1 + (round(1 / h) if failed < 0 else failed)
    return h * np.arange(count), (np.asarray(path.q)[:count] @ turn).T, failed


def check_nearby(flat, curved, turn, across, along):
    """Points near points all around are on the piece that was chosen, and not on the other one."""
    drawn = tuple(jnp.asarray(np.random.default_rng(0).normal(size=(2, 50, 2))))
    for i, (this, other) in enumerate([(flat, curved), (curved, flat)]):
        near = jax.jit(jax.vmap(this.manifold.nearby))(drawn)
        away = np.array([distances(*z, turn, across, along) for z in zip(*near, strict=True)])
        assert np.max(away[:, i]) < 1e-9
        far = tuple(part[np.argmax(away[:, 1 - i])] for part in near)
        assert this.manifold.contains(far)
        assert not other.manifold.contains(far)


def check_pieces(across, along, angle, heights, sizes):
    """``nearby``, and arcs on both pieces against closed forms, through where they end."""
    problem, turn = saturation(across, along, angle)
    flat, curved = pieces(problem, starts=40)
    check_nearby(flat, curved, turn, across, along)
    z0 = height(across, along)
    for y0 in heights:
        method, choice = singular_integrator(curved, STEPS)
        q = turn @ [y0, z0]
        start = curved.manifold.nearby((jnp.asarray(q), jnp.asarray(2 * q)))
        y0 = float(turn[:, 0] @ start[0])
        end = square(across, along, y0, 0.0)[1]
        for h in sizes:
            t, (y, z), failed = arc(problem, method, start, h, turn)
            assert failed >= 0, (y0, h, choice)
            assert abs(failed + 0.5 - end / h) < 1.5, (y0, h, end)
            assert np.max(np.abs(z - z0)) < 1e-9
            assert np.all(y * y0 > 0)
            before = t < end - 2 * h
            assert np.max(np.abs(y**2 - square(across, along, y0, t)[0])[before], initial=0.0) < 20 * h**2
        method, _ = singular_integrator(flat, STEPS)
        start = flat.manifold.nearby((jnp.asarray(turn @ [0, z0 - abs(y0)]), jnp.asarray(turn @ [0, -1.0])))
        for h in sizes:
            t, (y, z), failed = arc(problem, method, start, h, turn)
            assert failed < 0
            assert np.max(np.abs(y)) < 1e-9
            assert np.max(np.abs(z - 1 + (1 - z[0]) * np.exp(-along * t))) < h**2


@pytest.mark.slow
@pytest.mark.parametrize("parameters", [(2.5, 0.8, 0.0), (2.5, 0.8, 0.7), (3.0, 0.3, 2.0), (1.5, 0.5, -0.4)])
def test_pieces_of_spins_are_kept_whatever_their_axes(parameters):
    check_pieces(*parameters, [-0.9, -0.2, 0.05, 0.6], [0.1, 0.07, 0.03, 0.011, 0.004])


@pytest.mark.slow
def test_few_points_of_another_piece_are_not_counted_as_points_of_one():
    problem, _ = saturation(2.5, 0.8, 0.0)
    for seed in range(6):
        found = classify(problem, seed=seed)
        for piece in found.strata:
            q, p = piece.states
            away = [distances(*z, np.eye(2), 2.5, 0.8) for z in zip(q, p, strict=True)]
            assert min(np.max(away, axis=0)) < 1e-9 or np.max(np.abs(p)) < 1e-9, str(found)


@pytest.mark.slow
def test_the_error_names_the_time_and_the_reason_and_a_start_on_another_piece_is_refused():
    problem, _ = saturation(2.5, 0.8, 0.0)
    flat, curved = pieces(problem)
    check_nearby(flat, curved, np.eye(2), 2.5, 0.8)
    method, _ = singular_integrator(curved, STEPS, "rattle")
    start = curved.manifold.nearby((jnp.array([-0.5, -4 / 17]), jnp.array([-1, -8 / 17])))
    with pytest.raises(ConvergenceError, match=r"step 26, from t = 0.26: .*\{phi, psi\}.*arc ends near this time"):
        integrate(problem, method, start, 0.01, 50)
    other = flat.manifold.nearby((jnp.array([0.1, -0.8]), jnp.array([0.0, -1.0])))
    with pytest.raises(NotOnManifoldError, match=r"not on the piece of P_f that the integrator is for.*choose\(i\)"):
        integrate(problem, method, other, 0.01, 5)


class Planes(eqx.Module):
    """``(x + share y) (y - 1) u``, zero on two planes that cross."""

    share: Array

    def __call__(self, q, u):
        return (q[0] + self.share * q[1]) * (q[1] - 1) * u[0]


@pytest.mark.slow
def test_of_two_planes_the_chosen_one_is_kept():
    """``q' = 0``, cost ``(x + share y) (y - 1) u``."""
    for share in (0.0, 0.4, -2.0):
        problem = OptimalControlProblem(PLANE, lambda q, u: 0 * q, Planes(jnp.asarray(share)), 1)
        found = classify(problem)
        assert len(found.strata) == 2
        for i in range(2):
            piece = found.choose(i)
            normal, level = ((0, 1), 1) if abs(piece.stratum.q[1] - 1) < 1e-9 else ((1, share), 0)
            drawn = tuple(jnp.asarray(np.random.default_rng(1).normal(size=(2, 20, 2))))
            q, p = jax.jit(jax.vmap(piece.manifold.nearby))(drawn)
            assert np.max(np.abs(q @ np.array(normal) - level)) < 1e-12
            assert piece.manifold.contains((q[0], p[0]))
            assert not found.choose(1 - i).manifold.contains((q[0], p[0]))
