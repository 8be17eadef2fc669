"""Newton's method for small square systems, with implicit-function derivatives and a verdict on convergence."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

MAX_JACOBIANS = 15
MAX_CHORDS = 12
SLOW = 0.2

Vector = Float[Array, " k"]


def tolerance(x: Array, power: float) -> float:
    """``eps^power`` for the precision of ``x``."""
    return float(jnp.finfo(x.dtype).eps ** power)


def solve_small(matrix: Float[Array, "m m"], right: Float[Array, " m"]) -> Float[Array, " m"]:
    """Solve a small dense system; a single equation is a division."""
    return right / matrix[0, 0] if matrix.shape[0] == 1 else jnp.linalg.solve(matrix, right)


def find_root(residual: Callable[[Vector], Vector], start: Vector, scale: ArrayLike = 1.0) -> tuple[Vector, Bool[Array, ""]]:
    """Root of ``residual`` near ``start`` and whether the iteration converged to it.

    Newton's method that keeps its Jacobian while the steps shrink fivefold each (chord iteration) and renews it where
    they do not. ``scale`` holds the typical sizes of the unknowns, shape ``(k,)`` or one number. Derivatives with respect
    to anything that ``residual`` closes over come from the implicit function theorem, in every autodiff mode.
    """
    unit = jax.lax.stop_gradient(jnp.broadcast_to(jnp.asarray(scale, start.dtype), start.shape))

    def scaled(c: Vector) -> Vector:
        return residual(unit * c)

    def tangent_solve(linear: Callable[[Vector], Vector], right: Vector) -> Vector:
        return jnp.linalg.solve(jax.jacfwd(linear)(jnp.zeros_like(right)), right)

    first = jax.lax.stop_gradient(start) / unit
    root, converged = jax.lax.custom_root(scaled, first, _newton, tangent_solve, has_aux=True)
    return unit * root, converged > 0


class _Iteration(NamedTuple):
    c: Vector
    step: Array  # largest entry of the last step, in units of the unknowns' sizes
    ratio: Array  # the last step over the one before
    converged: Array
    chords: Array  # steps taken with the present Jacobian


def _newton(residual: Callable[[Vector], Vector], start: Vector) -> tuple[Vector, Array]:
    """Newton's method with a Jacobian for each of the outer iterations and chord steps inside."""
    quadratic, rounding = tolerance(start, 0.65), tolerance(start, 1.0) / 4
    infinity = jnp.asarray(jnp.inf, start.dtype)

    def chords(state: _Iteration) -> _Iteration:
        factor = jax.scipy.linalg.lu_factor(jax.jacfwd(residual)(state.c))

        def chord(s: _Iteration) -> _Iteration:
            d = jax.scipy.linalg.lu_solve(factor, residual(s.c))
            step = jnp.max(jnp.abs(d))
            ratio = step / s.step
            # After a Newton step the error is quadratic in it, after a chord step the ratio tells it; rounding ends both.
            remaining = jnp.where(s.chords == 0, step * step, step * jnp.minimum(ratio, 1.0))
            done = (remaining <= rounding) | ((step <= quadratic) & (ratio > SLOW) & (s.chords > 0))
            return _Iteration(s.c - d, step, ratio, done, s.chords + 1)

        def going(s: _Iteration) -> Array:
            return ~s.converged & (s.chords < MAX_CHORDS) & ((s.chords < 2) | (s.ratio < SLOW))

        return jax.lax.while_loop(going, chord, state._replace(step=infinity, ratio=infinity, chords=jnp.zeros((), int)))

    def outer(pair: tuple[_Iteration, Array]) -> tuple[_Iteration, Array]:
        return chords(pair[0]), pair[1] + 1

    def unfinished(pair: tuple[_Iteration, Array]) -> Array:
        state, jacobians = pair
        return ~state.converged & (jacobians < MAX_JACOBIANS) & jnp.all(jnp.isfinite(state.c))

    zero = jnp.zeros((), int)
    state = _Iteration(start, infinity, infinity, jnp.array(False), zero)
    state, _ = jax.lax.while_loop(unfinished, outer, (state, zero))
    return state.c, state.converged.astype(start.dtype)
