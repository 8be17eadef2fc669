"""Newton's method for small square systems, by chord iterations."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...newton_constants import MAX_JACOBIANS, PROBE, QUADRATIC_POWER, SMALLEST_PART
from . import ambient as vec
from .tolerances import tolerance

MAX_CHORDS = 16  # steps with one Jacobian before it is renewed
LARGEST_CURVATURE = (
    1e8  # second derivatives, in units of the unknowns' sizes, up to which Newton steps are known to be quadratic
)
# Ratios of successive steps: renew the Jacobian above the one, do not take the step above the other.
SLOW_RATIOS, STALLED = 0.2, 0.5

Vector = Float[Array, " k"]


def row_sizes(matrix: Float[Array, "k k"]) -> Vector:
    """The largest entries of the rows, by which to divide them: equations in units of their own have pivots to compare
    then."""
    rows = jnp.max(jnp.abs(jax.lax.stop_gradient(matrix)), axis=1)
    return jnp.where(rows > 0, rows, 1.0)


class _Iteration(NamedTuple):
    c: Vector
    step: Array  # largest entry of the last step, in units of the unknowns' sizes
    ratio: Array  # the last step over the one before
    converged: Array
    chords: Array  # steps taken with the present Jacobian
    missed: Vector  # the step at ``c``, once it is doubted
    changed: Vector  # by how much each of its entries changed beside ``c``, at most
    probed: Array  # number of points at which it was asked for, the first one ``c``; negative where it is not doubted


def newton(
    residual: Callable[[Vector], Vector], start: Vector, inverse: Array | None
) -> tuple[Vector, Bool[Array, ""]]:
    """Chord iterations, each with a Jacobian of its own; the first one with ``inverse`` if that is given."""
    state = _fresh(start)
    if inverse is not None:
        tried = _chords(residual, lambda r: inverse @ r, state, exact=False)
        better = tried.converged | (tried.step < 1)
        state = tried._replace(c=jnp.where(better, tried.c, start))

    def outer(pair: tuple[_Iteration, Array]) -> tuple[_Iteration, Array]:
        jacobian = jax.jacfwd(residual)(pair[0].c)
        rows = row_sizes(jacobian)
        # A product for each chord instead of two triangular solutions, which LAPACK is called for one after the other.
        inverse = jnp.linalg.inv(jacobian / rows[:, None]) / rows
        return _chords(residual, lambda r: inverse @ r, pair[0], exact=True), pair[1] + 1

    def unfinished(pair: tuple[_Iteration, Array]) -> Array:
        state, jacobians = pair
        return ~state.converged & (jacobians < MAX_JACOBIANS) & jnp.all(jnp.isfinite(state.c))

    state, _ = jax.lax.while_loop(unfinished, outer, (state, jnp.zeros((), int)))
    return state.c, state.converged


def _fresh(c: Vector) -> _Iteration:
    infinity = jnp.asarray(jnp.inf, c.dtype)
    none = jnp.zeros((), int)
    return _Iteration(c, infinity, infinity, jnp.array(False), none, jnp.zeros_like(c), jnp.zeros_like(c), none - 1)


def _chords(
    residual: Callable[[Vector], Vector], solve: Callable[[Vector], Vector], state: _Iteration, exact: bool
) -> _Iteration:
    """Steps with one Jacobian, ``exact`` at the first of them, until they converge or shrink too slowly."""
    quadratic, smallest = tolerance(state.c, QUADRATIC_POWER), SMALLEST_PART * tolerance(state.c, 1.0)
    turns = 1.0 - 2.0 * (jnp.arange(state.c.size) % 2)
    patterns = PROBE * tolerance(state.c, 1.0) * jnp.stack([0.0 * turns, turns, -turns, jnp.ones_like(turns)])
    patterns = patterns.astype(state.c.dtype)

    def chord(s: _Iteration) -> _Iteration:
        moved = patterns[jnp.maximum(s.probed, 0)] * jnp.maximum(jnp.abs(s.c), 1.0)
        d = solve(residual(s.c + jnp.where(s.probed < 0, 0.0, moved)))
        step = vec.size(d)
        ratio = step / s.step
        # What further steps take away. After a Newton step it is quadratic in it, but how curved the equations are is
        # no matter of the sizes of their unknowns. One ratio alone may be that of unknowns that are found at once,
        # beside slower ones.
        ratios = jnp.stack([LARGEST_CURVATURE * step if exact else jnp.ones_like(step), jnp.sqrt(ratio), ratio])
        remaining = step * jnp.minimum(ratios[jnp.minimum(s.chords, 2)], 1.0)
        stalled = (step <= quadratic) & (ratio > STALLED) & (s.chords > 0)
        done = (remaining <= smallest) | stalled  # by rounding
        taken = ratio <= STALLED  # a step that hardly shrinks is the fault of an old Jacobian, and may lead back
        new = s._replace(c=jnp.where(taken, s.c - d, s.c), step=step, ratio=ratio, converged=done, chords=s.chords + 1)
        # An unknown may be as small as the rounding of others: its size says nothing of how exactly it can be known.
        doubted = ~done & (ratio >= SLOW_RATIOS) & (s.chords > 0) if exact else jnp.array(False)
        new = new._replace(probed=jnp.where(doubted, 0, -1))
        missed = jnp.where(s.probed > 0, s.missed, d)
        # Each entry by itself: that of an unknown that is next to nothing changes by any amount.
        changed = jnp.maximum(s.changed, jnp.abs(d - missed))
        rounding = jnp.all(jnp.abs(missed) <= PROBE * jnp.maximum(changed, smallest))
        probed = s._replace(missed=missed, changed=changed, probed=s.probed + 1, converged=rounding)
        return jax.tree.map(lambda a, b: jnp.where(s.probed < 0, a, b), new, probed)

    def going(s: _Iteration) -> Array:
        chords = (s.chords < MAX_CHORDS) & ((s.chords < 2) | (s.ratio < SLOW_RATIOS))
        return ~s.converged & jnp.where(s.probed < 0, chords, s.probed < len(patterns))

    return jax.lax.while_loop(going, chord, _fresh(state.c))
