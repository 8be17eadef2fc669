"""Newton's method for small square systems, with implicit-function derivatives and a verdict on convergence."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

MAX_JACOBIANS = 15
MAX_CHORDS = 16
SLOW, STALLED = 0.2, 0.5  # ratios of successive steps: renew the Jacobian above the one, do not take the step above the other
MAX_APPROACHES = 60
DAMPING, DAMPING_FACTOR, NEAR = 0.1, 4.0, 1e-3  # of Levenberg-Marquardt; the residual that Newton's method takes over at

Vector = Float[Array, " k"]


def tolerance(x: Array, power: float) -> float:
    """``eps^power`` for the precision of ``x``."""
    return float(jnp.finfo(x.dtype).eps ** power)


def solve_small(matrix: Float[Array, "m m"], right: Float[Array, " m"]) -> Float[Array, " m"]:
    """Solve a small dense system; a single equation is a division."""
    return right / matrix[0, 0] if matrix.shape[0] == 1 else jnp.linalg.solve(matrix, right)


def find_root(
    residual: Callable[[Vector], Vector],
    start: Vector,
    scale: ArrayLike = 1.0,
    inverse: np.ndarray | None = None,
) -> tuple[Vector, Bool[Array, ""]]:
    """Root of ``residual`` near ``start`` and whether the iteration converged to it.

    Newton's method that keeps its Jacobian while the steps shrink fivefold each (chord iteration) and renews it where
    they do not. ``inverse``, if given, is an approximate inverse Jacobian to begin with. ``scale`` holds the typical sizes
    of the unknowns, shape ``(k,)`` or one number. Derivatives with respect to anything that ``residual`` closes over come
    from the implicit function theorem, in every autodiff mode.
    """
    if not start.size:
        return start, jnp.array(True)
    unit = jax.lax.stop_gradient(jnp.broadcast_to(jnp.asarray(scale, start.dtype), start.shape))

    def scaled(c: Vector) -> Vector:
        return residual(unit * c)

    def solve(f: Callable[[Vector], Vector], first: Vector) -> tuple[Vector, Array]:
        return _newton(f, first, None if inverse is None else jnp.asarray(inverse, first.dtype) / unit[:, None])

    first = jax.lax.stop_gradient(start) / unit
    root, converged = jax.lax.custom_root(scaled, first, solve, _solve_linear, has_aux=True)
    return unit * root, converged > 0


def known_root(residual: Callable[[Vector], Vector], root: Vector) -> Vector:
    """``root``, a root of ``residual`` to rounding, with the derivatives of the implicit function theorem."""
    return jax.lax.custom_root(residual, jax.lax.stop_gradient(root), lambda _, c: c, _solve_linear)


def approach_root(residual: Callable[[Vector], Float[Array, " m"]], start: Vector) -> Vector:
    """Levenberg-Marquardt steps towards a root of ``m >= k`` equations, to where Newton's method converges.

    A step that makes the residual grow is not taken and raises the damping.
    """

    def step(state: tuple[Vector, Array, Array, Array]) -> tuple[Vector, Array, Array, Array]:
        c, r, damping, count = state
        j = jax.jacfwd(residual)(c)
        tried = c - jnp.linalg.solve(j.T @ j + damping * jnp.eye(c.size, dtype=c.dtype), j.T @ r)
        missed = residual(tried)
        better = missed @ missed < r @ r
        damping = damping * jnp.where(better, 1 / DAMPING_FACTOR, DAMPING_FACTOR)
        return jnp.where(better, tried, c), jnp.where(better, missed, r), damping, count + 1

    def far(state: tuple[Vector, Array, Array, Array]) -> Array:
        _, r, _, count = state
        return (r @ r > NEAR**2) & (count < MAX_APPROACHES)

    first = (start, residual(start), jnp.asarray(DAMPING, start.dtype), jnp.zeros((), int))
    return jax.lax.while_loop(far, step, first)[0]


def _solve_linear(linear: Callable[[Vector], Vector], right: Vector) -> Vector:
    return jnp.linalg.solve(jax.jacfwd(linear)(jnp.zeros_like(right)), right)


class _Iteration(NamedTuple):
    c: Vector
    step: Array  # largest entry of the last step, in units of the unknowns' sizes
    ratio: Array  # the last step over the one before
    converged: Array
    chords: Array  # steps taken with the present Jacobian


def _newton(residual: Callable[[Vector], Vector], start: Vector, inverse: Array | None) -> tuple[Vector, Array]:
    """Chord iterations, each with a Jacobian of its own; the first one with ``inverse`` if that is given."""
    infinity, zero = jnp.asarray(jnp.inf, start.dtype), jnp.zeros((), int)
    state = _Iteration(start, infinity, infinity, jnp.array(False), zero)
    if inverse is not None:
        tried = _chords(residual, lambda r: inverse @ r, state, exact=False)
        better = tried.converged | (tried.step < 1)
        state = tried._replace(c=jnp.where(better, tried.c, start))

    def outer(pair: tuple[_Iteration, Array]) -> tuple[_Iteration, Array]:
        factor = jax.scipy.linalg.lu_factor(jax.jacfwd(residual)(pair[0].c))
        return _chords(residual, lambda r: jax.scipy.linalg.lu_solve(factor, r), pair[0], exact=True), pair[1] + 1

    def unfinished(pair: tuple[_Iteration, Array]) -> Array:
        state, jacobians = pair
        return ~state.converged & (jacobians < MAX_JACOBIANS) & jnp.all(jnp.isfinite(state.c))

    state, _ = jax.lax.while_loop(unfinished, outer, (state, zero))
    return state.c, state.converged.astype(start.dtype)


def _chords(
    residual: Callable[[Vector], Vector], solve: Callable[[Vector], Vector], state: _Iteration, exact: bool
) -> _Iteration:
    """Steps with one Jacobian, ``exact`` at the first of them, until they converge or shrink too slowly."""
    quadratic, rounding = tolerance(state.c, 0.65), tolerance(state.c, 1.0) / 4

    def chord(s: _Iteration) -> _Iteration:
        d = solve(residual(s.c))
        step = jnp.max(jnp.abs(d))
        ratio = step / s.step
        # After a Newton step the error is quadratic in it, after a chord step the ratio tells it; rounding ends both.
        remaining = jnp.where(s.chords == 0, step * step if exact else step, step * jnp.minimum(ratio, 1.0))
        done = (remaining <= rounding) | ((step <= quadratic) & (ratio > STALLED) & (s.chords > 0))
        taken = ratio <= STALLED  # a step that hardly shrinks is the fault of an old Jacobian, and may lead back
        return _Iteration(jnp.where(taken, s.c - d, s.c), step, ratio, done, s.chords + 1)

    def going(s: _Iteration) -> Array:
        return ~s.converged & (s.chords < MAX_CHORDS) & ((s.chords < 2) | (s.ratio < SLOW))

    infinity = jnp.asarray(jnp.inf, state.c.dtype)
    fresh = state._replace(step=infinity, ratio=infinity, converged=jnp.array(False), chords=jnp.zeros((), int))
    return jax.lax.while_loop(going, chord, fresh)
