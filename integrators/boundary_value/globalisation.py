"""Newton's method on the KKT system, made global: nothing is taken that does not improve, and every step descends.

Merit: the l1 penalty ``cost + mu |gap|_1`` [Nocedal, Wright 2006, 18.3]. A trial is accepted if it decreases the merit as
Armijo asks, or brings the KKT residual below nine tenths of the best so far (full Newton steps near a solution, which
the merit can refuse). Indefinite reduced Hessians: the diagonal is raised until the step has positive curvature, a test
that needs no inertia [Chiang, Zavala 2016]. Where a step has brought the residual below a hundredth, the matrices serve for
one more (the chord method): it gains more digits than that step did.
"""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from ..results import Result
from .assembly import Assembled, DiscreteTrajectory, Iterate
from .elimination import BlockSolution, eliminate, is_strict_minimum

ARMIJO = 1e-4
RECORD = 0.9
SHORTEST = 2.0**-7
FAST = 1e-2
FIRST_SHIFT, SMALLEST_SHIFT, LARGEST_SHIFT = 1e-4, 1e-8, 1e10
CURVATURE = 1e-9


class _Model(NamedTuple):
    """What the merit function promises along a step: its value and slope, and the penalty."""

    merit: Array
    slope: Array
    penalty: Array


class _State(NamedTuple):
    iterate: Iterate
    assembled: Assembled
    factors: BlockSolution
    trial: Iterate
    model: _Model
    fraction: Array
    shift: Array
    best: Array
    trials: Array
    fast: Array  # the last step gained two digits: its matrices serve for the next
    stale: Array  # the matrices are those of the iterate before
    done: Array


@final
class NewtonResult(eqx.Module):
    """The last accepted iterate with its KKT system, and how the iteration ended.

    ``strict_minimum``: the Hessian of the Lagrangian is positive definite on the null space of the constraints there.
    """

    iterate: Iterate
    assembled: Assembled
    strict_minimum: Array
    iterations: Array
    result: Result


def solve_kkt(problem: DiscreteTrajectory, guess: Iterate, tolerance: ArrayLike, max_iterations: ArrayLike) -> NewtonResult:
    """Solve the KKT system of a discrete trajectory from a guess.

    Converged where both the ambient gap and the relative stationarity are at most ``tolerance``.
    """

    def body(state: _State) -> _State:
        chord = state.fast
        assembled = problem.assemble(state.trial, state.assembled, chord)
        state, good = _judge(assembled, state, tolerance)
        residual, stale = _residual(state.assembled), jnp.where(good, chord, state.stale)
        arrived = residual <= tolerance
        # Where a chord step arrives, the matrices are made there: the last elimination is of the solution's own unchanged
        # system, and its inertia tells whether it is a minimum.
        unmade = arrived & stale
        # This near to a solution, and while its steps are taken, Newton's method leads to it, be it a minimum or a saddle.
        keep = arrived | (good & (residual <= jnp.sqrt(tolerance)))
        shift = jnp.where(arrived, 0.0, state.shift)
        shift, factors = jax.lax.cond(
            unmade, lambda: (shift, state.factors), lambda: _regularised(state.assembled, state.factors, shift, keep)
        )
        model = _promise(state.assembled, factors, shift, state.model.penalty)
        fraction = jnp.where(arrived, 0.0, state.fraction)
        trial = problem.move(state.iterate, state.assembled, factors.steps, factors.multipliers, fraction)
        fast = state.fast & ~arrived
        return state._replace(
            trial=trial, factors=factors, model=model, shift=shift, fast=fast, stale=stale, done=arrived & ~unmade
        )

    def going(state: _State) -> Array:
        return ~state.done & _solvable(state) & (state.trials <= max_iterations)

    assembled = problem.unassembled(guess)
    factors = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(eliminate, assembled.blocks))
    zero, infinity, no = jnp.zeros(()), jnp.asarray(jnp.inf), jnp.array(False)
    promise = _Model(infinity, zero, zero)
    state = _State(guess, assembled, factors, guess, promise, zero + 1, zero, infinity, jnp.zeros((), int), no, no, no)
    state = jax.lax.while_loop(going, body, state)
    result = _outcome(state, tolerance, max_iterations)
    strict = is_strict_minimum(state.factors) & (state.shift == 0) & ~state.stale
    return NewtonResult(state.iterate, state.assembled, strict, state.trials - 1, result)


def _solvable(state: _State) -> Array:
    finite = jnp.isfinite(_largest(state.factors.steps)) & jnp.isfinite(_largest(state.factors.multipliers))
    return finite & (state.shift < LARGEST_SHIFT)


def _largest(a: Array) -> Array:
    """Largest absolute entry."""
    return jnp.max(jnp.abs(a))


def _residual(assembled: Assembled) -> Array:
    return jnp.maximum(assembled.gap, assembled.stationarity)


def _merit(assembled: Assembled, penalty: Array) -> Array:
    return assembled.cost + penalty * jnp.sum(jnp.abs(assembled.blocks.gap))


def _judge(assembled: Assembled, state: _State, tolerance: ArrayLike) -> tuple[_State, Array]:
    """Take the assembled trial if it improves, and set the length and the shift of the next step; and whether it does."""
    residual, merit = _residual(assembled), _merit(assembled, state.model.penalty)
    decreases = merit <= state.model.merit + ARMIJO * state.fraction * state.model.slope
    improves = (decreases & (state.trials > 0)) | (residual <= jnp.maximum(RECORD * state.best, tolerance))
    remade = state.fraction == 0  # the same iterate, with matrices of its own
    good = (improves | remade) & jnp.isfinite(residual) & jnp.isfinite(merit)
    new, old = (state.trial, assembled), (state.iterate, state.assembled)
    iterate, kept = jax.tree.map(lambda a, b: jnp.where(good | (state.trials == 0), a, b), new, old)

    halved = state.fraction / 2
    restart = good | (halved < SHORTEST)
    lowered = jnp.where(state.shift < SMALLEST_SHIFT, 0.0, state.shift / 10)
    raised = jnp.where(halved < SHORTEST, jnp.maximum(10 * state.shift, FIRST_SHIFT), state.shift)
    judged = state._replace(
        iterate=iterate,
        assembled=kept,
        fraction=jnp.where(restart, 1.0, halved),
        shift=jnp.where(good, lowered, raised),
        best=jnp.where(good, jnp.minimum(state.best, residual), state.best),
        trials=state.trials + 1,
        fast=good & (residual <= FAST * state.best) & (state.trials > 0),
    )
    return judged, good


def _scales(assembled: Assembled) -> Array:
    """Typical curvature of each coordinate, the unit of the shift."""
    diagonal = jnp.max(jnp.abs(jnp.diagonal(assembled.blocks.hessian, axis1=1, axis2=2)), axis=0)
    floor = 1e-3 * jnp.max(diagonal)
    return jnp.where(floor > 0, jnp.maximum(diagonal, floor), 1.0)


def _regularised(assembled: Assembled, factors: BlockSolution, shift: Array, keep: Array) -> tuple[Array, BlockSolution]:
    """The step of the block system, with the smallest tried shift of the Hessian that gives it positive curvature.

    If ``keep`` the shift that came is used as it is.
    """
    blocks, scales = assembled.blocks, _scales(assembled)

    def shifted(shift: Array) -> tuple[BlockSolution, Array]:
        hessian = blocks.hessian + shift * jnp.diag(scales)
        factors = eliminate(blocks._replace(hessian=hessian))
        curvature = jnp.einsum("ks,kst,kt->", factors.steps, hessian, factors.steps)
        size = jnp.einsum("ks,s,ks->", factors.steps, scales, factors.steps)
        return factors, keep | (curvature >= CURVATURE * size)

    def body(state: tuple[Array, BlockSolution, Array, Array]) -> tuple[Array, BlockSolution, Array, Array]:
        shift, _, _, tried = state
        shift = jnp.where(tried > 0, jnp.maximum(10 * shift, FIRST_SHIFT), shift)
        factors, descends = shifted(shift)
        return shift, factors, descends, tried + 1

    def going(state: tuple[Array, BlockSolution, Array, Array]) -> Array:
        return ~state[2] & (state[0] < LARGEST_SHIFT)

    start = (shift, factors, jnp.array(False), jnp.zeros((), int))
    shift, factors, _, _ = jax.lax.while_loop(going, body, start)
    return shift, factors


def _promise(assembled: Assembled, factors: BlockSolution, shift: Array, penalty: Array) -> _Model:
    """Merit and its slope along the step, with a penalty large enough to make it a descent direction."""
    blocks, d = assembled.blocks, factors.steps
    hessian = blocks.hessian + shift * jnp.diag(_scales(assembled))
    gap = jnp.sum(jnp.abs(blocks.gap))
    ahead = jnp.sum(assembled.gradient * d)
    wanted = (ahead + jnp.einsum("ks,kst,kt->", d, hessian, d) / 2) / (0.9 * jnp.where(gap > 0, gap, 1.0))
    penalty = jnp.where(gap > 0, jnp.maximum(penalty, wanted), penalty)
    return _Model(_merit(assembled, penalty), ahead - penalty * gap, penalty)


def _outcome(state: _State, tolerance: ArrayLike, max_iterations: ArrayLike) -> Result:
    """The result code of a finished iteration."""
    finite = jnp.isfinite(_residual(state.assembled)) & jnp.isfinite(state.assembled.cost)
    meets = jnp.max(jnp.abs(state.assembled.blocks.gap)) <= tolerance
    wrong = (state.assembled.stationarity <= tolerance) & meets & (state.assembled.gap > tolerance)
    result = Result.where(state.trials > max_iterations, Result.too_many_iterations, Result.no_improvement)
    result = Result.where(~_solvable(state) & ~meets, Result.singular, result)
    result = Result.where(wrong, Result.wrong_point, result)
    result = Result.where(~finite, Result.not_finite, result)
    return Result.where((_residual(state.assembled) <= tolerance) & finite, Result.successful, result)
