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
from .claims import Residuals, Sizes, correction, own_sizes, residuals
from .elimination import BlockSolution, BlockSystem, eliminate, is_strict_minimum
from .scaling import Units, natural_units, scaled, unscaled

ARMIJO = 1e-4
RECORD = 0.9
SWITCH, NARROWER, FUNNEL = 1e-3, 0.99, 2.0
RAISE, LOWER, LONG, KEEP = 10.0, 4.0, 0.3, 0.5
SHORTEST = 2.0**-4
FAST = 1e-2
FIRST_SHIFT, SMALLEST_SHIFT, LARGEST_SHIFT = 1e-4, 1e-8, 1e10
CURVATURE = 1e-9


class _Model(NamedTuple):
    """Cost and infeasibility of the iterate, the slope of the cost along the step, and what the multipliers' step is on the gap."""

    cost: Array
    infeasibility: Array
    slope: Array
    held: Array  # the multipliers on the gap
    turned: Array  # their step on the gap


class _State(NamedTuple):
    iterate: Iterate
    assembled: Assembled
    units: Units
    residuals: Residuals
    factors: BlockSolution
    trial: Iterate
    model: _Model
    funnel: Array  # the infeasibility that no iterate exceeds any more
    fraction: Array
    shift: Array
    best: Array
    trials: Array
    fast: Array  # the last step gained two digits: its matrices serve for the next
    stale: Array  # the matrices are those of the iterate before
    determined: Array  # the linearised conditions ask for no further step to speak of
    done: Array


@final
class NewtonResult(eqx.Module):
    """The last accepted iterate with its KKT system, and how the iteration ended.

    ``strict_minimum``: the Hessian of the Lagrangian is positive definite on the null space of the constraints there.
    """

    iterate: Iterate
    assembled: Assembled
    residuals: Residuals
    strict_minimum: Array
    iterations: Array
    result: Result


def solve_kkt(problem: DiscreteTrajectory, guess: Iterate, tolerance: ArrayLike, max_iterations: ArrayLike) -> NewtonResult:
    """Solve the KKT system of a discrete trajectory from a guess.

    Converged where both the gap and the stationarity are at most ``tolerance``, and Newton's next step at most its square root:
    where the system is singular to rounding, residuals say nothing about the distance to a solution.
    """

    def body(state: _State) -> _State:
        chord = state.fast
        assembled = problem.assemble(state.trial, state.assembled, chord)
        sizes = own_sizes(problem.stage.problem, state.trial, assembled)
        first = state.trials == 0
        units = jax.lax.cond(first, lambda: _units(assembled, sizes), lambda: state.units)
        found = residuals(assembled, sizes, units)
        state, good = _judge(assembled, found, state._replace(units=units), tolerance)
        residual, stale = state.residuals.largest, jnp.where(good, chord, state.stale)
        arrived = residual <= tolerance
        # Where a chord step arrives, the matrices are made there: the last elimination is of the solution's own unchanged
        # system, and its inertia tells whether it is a minimum.
        unmade = arrived & stale
        # This near to a solution, and while its steps are taken, Newton's method leads to it, be it a minimum or a saddle.
        keep = arrived | (good & (residual <= jnp.sqrt(tolerance)))
        shift = jnp.where(arrived, 0.0, state.shift)
        system = scaled(state.assembled.blocks, units)
        shift, factors = jax.lax.cond(
            unmade, lambda: (shift, state.factors), lambda: _regularised(system, state.factors, shift, keep)
        )
        model = _promise(state.assembled, units, factors)
        determined = correction(factors, sizes, units) <= jnp.sqrt(tolerance)
        done = arrived & ~unmade & determined
        fraction = jnp.where(unmade, 0.0, state.fraction)
        steps, multipliers = unscaled(factors, units)
        trial = problem.move(state.iterate, state.assembled, steps, multipliers, fraction)
        return state._replace(
            trial=trial,
            factors=factors,
            model=model,
            fraction=fraction,
            shift=shift,
            fast=state.fast & ~arrived,
            stale=stale,
            determined=determined,
            done=done,
        )

    def going(state: _State) -> Array:
        return ~state.done & _solvable(state) & (state.trials <= max_iterations)

    assembled = problem.unassembled(guess)
    factors = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(eliminate, assembled.blocks))
    zero, infinity, no = jnp.zeros(()), jnp.asarray(jnp.inf), jnp.array(False)
    units = Units(jnp.ones(problem.stage.dimension), jnp.ones(problem.stage.manifold.dimension), zero + 1)
    promise = _Model(infinity, infinity, zero, zero, zero)
    begin = guess, assembled, units, Residuals(infinity, infinity), factors, guess, promise, infinity, zero + 1, zero, infinity
    state = jax.lax.while_loop(going, body, _State(*begin, jnp.zeros((), int), no, no, no, no))
    result = _outcome(state, tolerance, max_iterations)
    strict = is_strict_minimum(state.factors) & (state.shift == 0) & ~state.stale & state.done
    return NewtonResult(state.iterate, state.assembled, state.residuals, strict, state.trials - 1, result)


def _units(assembled: Assembled, sizes: Sizes) -> Units:
    return natural_units(assembled.blocks, assembled.gradient, sizes.displacements, sizes.controls)


def _solvable(state: _State) -> Array:
    finite = jnp.isfinite(_largest(state.factors.steps)) & jnp.isfinite(_largest(state.factors.multipliers))
    return finite & (state.shift < LARGEST_SHIFT)


def _largest(a: Array) -> Array:
    """Largest absolute entry."""
    return jnp.max(jnp.abs(a))


def _cost(assembled: Assembled, units: Units) -> Array:
    return assembled.cost / units.cost


def _held(assembled: Assembled, units: Units) -> Array:
    return jnp.sum(assembled.coordinates * assembled.blocks.gap) / units.cost


def _infeasibility(assembled: Assembled, units: Units) -> Array:
    return jnp.sum(jnp.abs(assembled.blocks.gap) / units.nodes)


def _judge(assembled: Assembled, found: Residuals, state: _State, tolerance: ArrayLike) -> tuple[_State, Array]:
    """Take the assembled trial if it improves, and set the length and the shift of the next step; and whether it does."""
    first = state.trials == 0
    residual, cost, infeasibility = found.largest, _cost(assembled, state.units), _infeasibility(assembled, state.units)
    held = state.model.held + state.fraction * state.model.turned
    promised = -state.fraction * (state.model.slope - held)
    cheaper = promised >= SWITCH * state.model.infeasibility**2
    decreases = cost + _held(assembled, state.units) <= state.model.cost + held - ARMIJO * promised
    nearer = infeasibility <= NARROWER * state.funnel
    improves = ((infeasibility <= state.funnel) & jnp.where(cheaper, decreases, nearer)) & ~first
    record = residual <= jnp.maximum(RECORD * state.best, tolerance)
    remade = state.fraction == 0  # the same iterate, with matrices of its own
    good = (improves | record | remade) & jnp.isfinite(residual) & jnp.isfinite(cost)
    narrowed = good & ~cheaper & ~first & ~remade
    funnel = jnp.where(narrowed, jnp.minimum(state.funnel, (infeasibility + state.funnel) / 2), state.funnel)
    funnel = jnp.where(good & ~improves, jnp.maximum(funnel, infeasibility), funnel)
    funnel = jnp.where(first, FUNNEL * infeasibility, funnel)
    new, old = (state.trial, assembled, found), (state.iterate, state.assembled, state.residuals)
    iterate, kept, reached = jax.tree.map(lambda a, b: jnp.where(good | first, a, b), new, old)

    halved = state.fraction / 2
    restart = good | (halved < SHORTEST)
    settled = jnp.where(
        state.fraction < LONG, jnp.maximum(state.shift, FIRST_SHIFT) * jnp.minimum(KEEP / state.fraction, RAISE), state.shift
    )
    lowered = jnp.where(state.fraction == 1, jnp.where(state.shift < SMALLEST_SHIFT, 0.0, state.shift / LOWER), settled)
    raised = jnp.where(halved < SHORTEST, jnp.maximum(RAISE * state.shift, FIRST_SHIFT), state.shift)
    judged = state._replace(
        iterate=iterate,
        assembled=kept,
        residuals=reached,
        funnel=funnel,
        fraction=jnp.where(restart, 1.0, halved),
        shift=jnp.where(good, lowered, raised),
        best=jnp.where(good, jnp.minimum(state.best, residual), state.best),
        trials=state.trials + 1,
        fast=good & (residual <= FAST * state.best) & ~first,
    )
    return judged, good


def _scales(system: BlockSystem) -> Array:
    """Typical curvature of each coordinate, the unit of the shift."""
    diagonal = jnp.max(jnp.abs(jnp.diagonal(system.hessian, axis1=1, axis2=2)), axis=0)
    floor = 1e-3 * jnp.max(diagonal)
    return jnp.where(floor > 0, jnp.maximum(diagonal, floor), 1.0)


def _regularised(system: BlockSystem, factors: BlockSolution, shift: Array, keep: Array) -> tuple[Array, BlockSolution]:
    """The step of the block system, with the smallest tried shift of the Hessian that gives it positive curvature.

    If ``keep`` the shift that came is used as it is.
    """
    scales = _scales(system)

    def shifted(shift: Array) -> tuple[BlockSolution, Array]:
        hessian = system.hessian + shift * jnp.diag(scales)
        factors = eliminate(system._replace(hessian=hessian))
        curvature = jnp.einsum("ks,kst,kt->", factors.steps, hessian, factors.steps)
        size = jnp.einsum("ks,s,ks->", factors.steps, scales, factors.steps)
        return factors, keep | (curvature >= CURVATURE * size)

    def body(state: tuple[Array, BlockSolution, Array, Array]) -> tuple[Array, BlockSolution, Array, Array]:
        shift, _, _, tried = state
        shift = jnp.where(tried > 0, jnp.maximum(RAISE * shift, FIRST_SHIFT), shift)
        factors, descends = shifted(shift)
        return shift, factors, descends, tried + 1

    def going(state: tuple[Array, BlockSolution, Array, Array]) -> Array:
        return ~state[2] & (state[0] < LARGEST_SHIFT)

    start = (shift, factors, jnp.array(False), jnp.zeros((), int))
    shift, factors, _, _ = jax.lax.while_loop(going, body, start)
    return shift, factors


def _promise(assembled: Assembled, units: Units, factors: BlockSolution) -> _Model:
    """Cost and infeasibility, and the slope of the cost along the step."""
    ahead = jnp.sum(assembled.gradient * (units.unknowns / units.cost) * factors.steps)
    turned = jnp.sum(factors.multipliers * (assembled.blocks.gap / units.nodes))
    return _Model(_cost(assembled, units), _infeasibility(assembled, units), ahead, _held(assembled, units), turned)


def _outcome(state: _State, tolerance: ArrayLike, max_iterations: ArrayLike) -> Result:
    """The result code of a finished iteration."""
    finite = jnp.isfinite(state.residuals.largest) & jnp.isfinite(state.assembled.cost)
    meets = jnp.max(jnp.abs(state.assembled.blocks.gap) / state.units.nodes) <= tolerance
    wrong = (state.residuals.stationarity <= tolerance) & meets & (state.residuals.gap > tolerance)
    undetermined = (state.residuals.largest <= tolerance) & ~state.determined
    result = Result.where(state.trials > max_iterations, Result.too_many_iterations, Result.no_improvement)
    result = Result.where((~_solvable(state) & ~meets) | undetermined, Result.singular, result)
    result = Result.where(wrong, Result.wrong_point, result)
    result = Result.where(~finite, Result.not_finite, result)
    return Result.where(state.done & finite, Result.successful, result)
