"""Newton's method on the KKT system, made global: nothing is taken that does not improve, and every step descends.

A trial is accepted inside a funnel, a bound on the infeasibility that only narrows [Kiessling, Leyffer, Vanaret 2025]: where the
step promises less cost by more than a share of the squared infeasibility, if the cost decreases as Armijo asks; else if it
comes well into the funnel, which it narrows. The cost is that of the Lagrangian with the multipliers of the trial: the bare
cost refuses good steps along curved constraints [Ulbrich 2004]. Accepted too is what brings the KKT residual below nine tenths
of the best so far. Indefinite reduced Hessians: the diagonal is raised until the step has positive curvature, a test that
needs no inertia [Chiang, Zavala 2016], and further after steps that had to be cut, so that the next is as long as what was
taken. Where a step has brought the residual below a hundredth, the matrices serve for one more (the chord method): it gains
more digits than that step did.
"""

from typing import NamedTuple, cast, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from ...manifolds.numerics import ambient as vec
from ..results import Result
from ..stages import ControlStage
from .assembly import Assembled, DiscreteTrajectory, Iterate
from .claims import Residuals, Sizes, correction, growth, own_sizes, residuals
from .elimination import BlockSolution, BlockSystem, eliminate, is_strict_minimum
from .scaling import Units, natural_units, scaled, unscaled

ARMIJO = 1e-4
SWITCH, NARROWER = 1e-3, 0.99
RECORD = 0.9
SHORTEST = 2.0**-4
FAST = 1e-2
SHRINKS = 0.1
GROWN = 1e6  # times what its data ask for: then a trajectory near a singular system follows its null vector
RAISE, LOWER = 10.0, 4.0
FIRST_SHIFT, SMALLEST_SHIFT, LARGEST_SHIFT = 1e-4, 1e-8, 1e10
CURVATURE = 1e-9


class _Model(NamedTuple):
    """What is known along a step: the iterate's own values, and how they change to first order."""

    cost: Array
    infeasibility: Array
    slope: Array  # of the cost
    held: Array  # the multipliers on the gap
    turned: Array  # their step on the gap
    descends: Array  # the step has positive curvature


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
    correction: Array  # what the linearised conditions still asked for where the residuals met the tolerance
    isolated: Array
    claimed: Array
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
    where the system is singular to rounding, residuals say nothing about the distance to a solution, and one is claimed only
    if the trajectory has kept its size.
    """

    def going(state: _State) -> Array:
        return ~state.done & _solvable(state) & (state.trials <= max_iterations)

    assembled = problem.unassembled(guess)
    factors = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(eliminate, assembled.blocks))
    zero, infinity, no = jnp.zeros(()), jnp.asarray(jnp.inf), jnp.array(False)
    units = Units(jnp.ones(problem.stage.dimension), jnp.ones(problem.stage.manifold.dimension), zero + 1)
    promise = _Model(infinity, infinity, zero, zero, zero, ~no)
    begin = guess, assembled, units, Residuals(infinity, infinity), factors, guess, promise, infinity, zero + 1, zero, infinity
    state = _State(*begin, jnp.zeros((), int), no, no, infinity, no, no, no)
    state = jax.lax.while_loop(going, lambda state: _next(problem, state, tolerance), state)
    result = _outcome(state, tolerance, max_iterations)
    strict = is_strict_minimum(state.factors) & (state.shift == 0) & ~state.stale & state.isolated
    return NewtonResult(state.iterate, state.assembled, state.residuals, strict, state.trials - 1, result)


def _next(problem: DiscreteTrajectory, state: _State, tolerance: ArrayLike) -> _State:
    """Assemble the trial, judge it, and compute the next one."""
    chord = state.fast
    assembled = problem.assemble(state.trial, state.assembled, chord)
    sizes = own_sizes(cast(ControlStage, problem.stage).problem, state.trial, assembled)
    units = jax.lax.cond(state.trials == 0, lambda: _units(assembled, sizes), lambda: state.units)
    found = residuals(assembled, sizes, units)
    state, good = _judge(assembled, found, state._replace(units=units), tolerance)
    residual, stale = state.residuals.largest, jnp.where(good, chord, state.stale)
    arrived = residual <= tolerance
    # Where a chord step arrives, the matrices are made there: the last elimination is of the solution's own unchanged
    # system, and its inertia tells whether it is a minimum.
    unmade = arrived & stale
    # This near to a solution, and while its steps are taken, Newton's method leads to it, be it a minimum or a saddle. The first
    # step is Newton's own too: where it gains two digits, the problem is nearly linear and has one extremal.
    keep = arrived | (good & (residual <= jnp.sqrt(tolerance))) | (state.trials == 1)
    shift = jnp.where(arrived, 0.0, state.shift)
    system = scaled(state.assembled.blocks, units)
    unchanged = shift, state.factors, state.model.descends
    shift, factors, descends = jax.lax.cond(unmade, lambda: unchanged, lambda: _regularised(system, state.factors, shift, keep))
    model = _promise(state.assembled, units, factors, descends)
    state = _settled(state, arrived & ~unmade, correction(factors, sizes, units), growth(sizes, units), tolerance)
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
    )


def _settled(state: _State, arrived: Array, wanted: Array, grown: Array, tolerance: ArrayLike) -> _State:
    """Whether the iteration ends where its residuals meet the tolerance, given the step that is still wanted there.

    Newton's steps shrink where the residuals vanish, unless the system is singular to rounding. Then the trajectory is one of a
    family of extremals; or it has grown along the null vector until rounding hides that there is none.
    """
    isolated = arrived & (wanted <= jnp.sqrt(tolerance))
    stuck = arrived & (wanted > SHRINKS * state.correction)
    claimed = isolated | (stuck & (grown <= GROWN))
    wanted = jnp.where(arrived, wanted, state.correction)
    return state._replace(correction=wanted, isolated=isolated, claimed=claimed, done=isolated | stuck)


def _units(assembled: Assembled, sizes: Sizes) -> Units:
    return natural_units(assembled.blocks, assembled.gradient, sizes.displacements, sizes.controls)


def _solvable(state: _State) -> Array:
    finite = jnp.isfinite(vec.largest(state.factors.steps)) & jnp.isfinite(vec.largest(state.factors.multipliers))
    return finite & (state.shift < LARGEST_SHIFT)


def _held(assembled: Assembled, units: Units) -> Array:
    return jnp.sum(assembled.coordinates * assembled.blocks.gap) / units.cost


def _infeasibility(assembled: Assembled, units: Units) -> Array:
    return jnp.sum(jnp.abs(assembled.blocks.gap) / units.nodes)


def _judge(assembled: Assembled, found: Residuals, state: _State, tolerance: ArrayLike) -> tuple[_State, Array]:
    """Take the assembled trial if it improves, and set the length and the shift of the next step; and whether it does."""
    first, probe = state.trials == 0, (state.trials == 1) & ~state.model.descends
    residual, improves, funnel = found.largest, *_funnelled(assembled, state)
    record = residual <= jnp.maximum(RECORD * state.best, tolerance)
    accepted = jnp.where(probe, residual <= FAST * state.best, improves | record)
    remade = state.fraction == 0  # the same iterate, with matrices of its own
    good = (accepted | remade) & jnp.isfinite(residual) & jnp.isfinite(assembled.cost)
    infeasibility = _infeasibility(assembled, state.units)
    funnel = jnp.where(good & ~improves, jnp.maximum(state.funnel, infeasibility), jnp.where(good, funnel, state.funnel))
    new, old = (state.trial, assembled, found), (state.iterate, state.assembled, state.residuals)
    iterate, kept, reached = jax.tree.map(lambda a, b: jnp.where(good | first, a, b), new, old)

    short = ~good & (state.fraction / 2 < SHORTEST)
    judged = state._replace(
        iterate=iterate,
        assembled=kept,
        residuals=reached,
        funnel=jnp.where(first, jnp.maximum(infeasibility, 1.0), funnel),
        fraction=jnp.where(good | short | probe, 1.0, state.fraction / 2),
        shift=_next_shift(state, good, short),
        best=jnp.where(good, jnp.minimum(state.best, residual), state.best),
        trials=state.trials + 1,
        fast=good & (residual <= FAST * state.best) & ~first,
    )
    return judged, good


def _funnelled(assembled: Assembled, state: _State) -> tuple[Array, Array]:
    """Whether the trial is accepted inside the funnel, and the funnel after it."""
    model, infeasibility = state.model, _infeasibility(assembled, state.units)
    held = model.held + state.fraction * model.turned
    promised = -state.fraction * (model.slope - held)
    cheaper = promised >= SWITCH * model.infeasibility**2
    lagrangian = assembled.cost / state.units.cost + _held(assembled, state.units)
    decreases = lagrangian <= model.cost + held - ARMIJO * promised
    inside = jnp.where(cheaper, decreases & (infeasibility <= state.funnel), infeasibility <= NARROWER * state.funnel)
    return inside & (state.trials > 0), jnp.where(cheaper, state.funnel, (infeasibility + state.funnel) / 2)


def _next_shift(state: _State, good: Array, short: Array) -> Array:
    """Less after a whole step, more after one that was cut to a quarter or less, and where none was short enough."""
    some = jnp.maximum(state.shift, FIRST_SHIFT)
    cut = jnp.where(state.fraction <= 0.25, some * jnp.minimum(0.5 / state.fraction, RAISE), state.shift)
    less = jnp.where(state.shift < SMALLEST_SHIFT, 0.0, state.shift / LOWER)
    taken = jnp.where((state.fraction == 1) | (state.fraction == 0), less, cut)
    return jnp.where(good, taken, jnp.where(short, jnp.maximum(RAISE * state.shift, FIRST_SHIFT), state.shift))


def _scales(system: BlockSystem) -> Array:
    """Typical curvature of each coordinate, the unit of the shift."""
    diagonal = jnp.max(jnp.abs(jnp.diagonal(system.hessian, axis1=1, axis2=2)), axis=0)
    floor = 1e-3 * jnp.max(diagonal)
    return jnp.where(floor > 0, jnp.maximum(diagonal, floor), 1.0)


def _regularised(system: BlockSystem, factors: BlockSolution, shift: Array, keep: Array) -> tuple[Array, BlockSolution, Array]:
    """The step of the block system, with the smallest tried shift of the Hessian that gives it positive curvature.

    If ``keep`` the shift that came is used as it is; and whether the curvature is positive.
    """
    scales = _scales(system)

    def shifted(shift: Array) -> tuple[BlockSolution, Array]:
        hessian = system.hessian + shift * jnp.diag(scales)
        factors = eliminate(system._replace(hessian=hessian))
        curvature = jnp.einsum("ks,kst,kt->", factors.steps, hessian, factors.steps)
        size = jnp.einsum("ks,s,ks->", factors.steps, scales, factors.steps)
        return factors, curvature >= CURVATURE * size

    def body(state: tuple[Array, BlockSolution, Array, Array]) -> tuple[Array, BlockSolution, Array, Array]:
        shift, _, _, tried = state
        shift = jnp.where(tried > 0, jnp.maximum(RAISE * shift, FIRST_SHIFT), shift)
        factors, descends = shifted(shift)
        return shift, factors, descends, tried + 1

    def going(state: tuple[Array, BlockSolution, Array, Array]) -> Array:
        shift, _, descends, tried = state
        return ~(descends | (keep & (tried > 0))) & (shift < LARGEST_SHIFT)

    start = (shift, factors, jnp.array(False), jnp.zeros((), int))
    return jax.lax.while_loop(going, body, start)[:3]


def _promise(assembled: Assembled, units: Units, factors: BlockSolution, descends: Array) -> _Model:
    ahead = jnp.sum(assembled.gradient * (units.unknowns / units.cost) * factors.steps)
    turned = jnp.sum(factors.multipliers * (assembled.blocks.gap / units.nodes))
    values = assembled.cost / units.cost, _infeasibility(assembled, units)
    return _Model(*values, ahead, _held(assembled, units), turned, descends)


def _outcome(state: _State, tolerance: ArrayLike, max_iterations: ArrayLike) -> Result:
    """The result code of a finished iteration."""
    finite = jnp.isfinite(state.residuals.largest) & jnp.isfinite(state.assembled.cost)
    meets = vec.largest(state.assembled.blocks.gap / state.units.nodes) <= tolerance
    wrong = (state.residuals.stationarity <= tolerance) & meets & (state.residuals.gap > tolerance)
    undetermined = (state.residuals.largest <= tolerance) & ~state.claimed
    result = Result.where(state.trials > max_iterations, Result.too_many_iterations, Result.no_improvement)
    result = Result.where((~_solvable(state) & ~meets) | undetermined, Result.singular, result)
    result = Result.where(wrong, Result.wrong_point, result)
    result = Result.where(~finite, Result.not_finite, result)
    return Result.where(state.claimed & finite, Result.successful, result)
