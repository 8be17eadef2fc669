"""Guesses from which Newton's method cannot set out, moved aside.

At rest a system without drift is controllable in no direction but those of its controls: the constraints of the guess
are dependent, and Newton's step has no bound. Near to rest it has one, far beyond anything that the trajectory is like.
Nor is it known which way round ends come together that are opposite to each other. Then the guess is moved by controls
that are random but always the same, and by the states to which they lead to first order.
"""

import numpy as np

from ....manifolds.numerics.tolerances import EPS, HALF
from ..transcription.iterate import Iterate, Slacks
from .arrays import plain
from .batches import merged
from .conditions import Conditions
from .elimination import BlockSystem, eliminate
from .extent import alone
from .kkt_system import Assembled, Step
from .scaling import SHARE, Units

FAR = 30.0  # times its spread: a trajectory is not asked to move by more
MOVED = 0.5  # of its spread: what it is moved aside by
OPPOSITE = 0.05  # the cosine of half the arc between ends: of their motion as much is seen from its middle
UNMET = 1e-3  # of what the linearised constraints ask for: a step that leaves more solves another problem
MET = 1e-8  # of the size of the nodes: of a guess that lacks less, what a step leaves is rounding
REACHED = 0.05  # of its spread: what a step moves by less has hardly moved
ROUNDED = EPS**HALF  # of what a coordinate moves by: what is lacking changes by less where nothing bends
ROUNDS = 4
WAVES = 3  # half periods in the horizon, and less


def is_lost(conditions: Conditions, iterate: Iterate, assembled: Assembled, step: Step) -> np.ndarray:
    """Whether Newton's step leads a member far off, and all that the linearised constraints allow, or leaves what these
    ask for; or ends are opposite.
    """
    lost = _is_far(conditions, assembled, step)
    if lost.any():
        lost &= _is_far(conditions, assembled, conditions.least_step(iterate, assembled))
    lost |= _is_unmet(conditions, iterate, assembled, step)
    asked, gap = (
        np.linalg.norm(found / conditions.measured.nodes[:, None], axis=2) for found in (assembled.asked, assembled.gap)
    )
    wide = gap > SHARE * gap.max(axis=1, keepdims=True)  # others are rounding, and have no direction
    return lost | np.any(wide & (asked < OPPOSITE * gap), axis=1)


def aside(
    conditions: Conditions, iterate: Iterate, assembled: Assembled, rounds: int = ROUNDS
) -> tuple[Iterate, np.ndarray]:
    """The iterates moved aside, each until half of what the controls move has moved by half its spread; and whether
    they hardly move something that is spread, shape (B,).

    Where that is so, as in Heisenberg's group on the way to a point above the start, until what is lacking has changed
    by as much. Where nothing that is spread moves or bends, as of a car at rest beside the place to park, the controls
    move by half their size and the iterates are moved aside from there.
    """
    step, finite = _at_random(conditions, assembled)
    far, spread = _moves(conditions, assembled, step)
    # In the middle of all: next to nothing moves what controls do not reach, and the spread of what rests is rounding.
    moved = np.where((far > 0) & (spread > 0), far / np.where(spread > 0, spread, 1.0), np.inf)
    shares = np.sort(moved, axis=0)
    middle = shares[np.maximum(np.isfinite(shares).sum(axis=0) - 1, 0) // 2, range(shares.shape[1])]
    size, bent = np.where(np.isfinite(middle), MOVED / middle, 0.0), _bent(conditions, iterate, assembled, step)
    held = finite & (bent > 0) & np.any((spread > 0) & (np.minimum(size, bent) * far <= REACHED * spread), axis=0)
    size = np.where(held, bent, np.where(finite, size, 0.0))
    still = finite & (size == 0) & (rounds > 0)
    moved = _moved(conditions, iterate, assembled, step, np.where(still, MOVED, size))
    if not still.any():
        return moved, held
    again, _ = aside(conditions, moved, conditions.assemble(moved), rounds - 1)
    return merged(still, again, moved), held | still


def violates(slacks: Slacks | None, held: np.ndarray) -> np.ndarray:
    """Which guesses violate inequalities, by their first slacks, shape (B,)."""
    return np.zeros(len(held), bool) if slacks is None else np.any(slacks.elastic, axis=(1, 2, 3))


def _at_random(conditions: Conditions, assembled: Assembled) -> tuple[Step, np.ndarray]:
    """The step of the linearised conditions by random controls of a cost of one or so; and where it is finite."""
    blocks = assembled.blocks
    n, (batch, count, z) = assembled.gap.shape[2], blocks.slope.shape
    times, draw = (np.arange(count) + 0.5) / count, np.random.default_rng(0)
    waves = np.cos(np.pi * times[:, None] * np.arange(WAVES)) @ draw.standard_normal((WAVES, z - n))
    curved = assembled.extent.curvature[:, n:]
    sizes = 1 / np.sqrt(np.where(curved > 0, curved, 1.0))
    hessian, slope = np.zeros_like(blocks.hessian), np.zeros((batch, count, z, 1))
    hessian[:, :, range(n, z), range(n, z)] = (1 / sizes**2)[:, None]
    slope[:, :, n:, 0] = -waves / sizes[:, None]
    one, gaps = np.ones((batch, n)), np.zeros((batch, count + 1, n, 1))
    system = BlockSystem(hessian, blocks.left, blocks.right, slope, gaps, one, np.zeros((batch, n)))
    found = eliminate(system, Units(np.concatenate([one, sizes], axis=1), one, np.ones(batch)))
    every = np.ones(batch, bool)
    step = Step(found.steps[..., 0], np.zeros(found.multipliers.shape[:3]), found.largest, every, every, every)
    return step, found.finite[:, 0]


def _bent(conditions: Conditions, iterate: Iterate, assembled: Assembled, step: Step) -> np.ndarray:
    """How many times a step changes what is lacking by half a spread, which the linearised conditions do not see, shape
    (B,); zero where it changes nothing."""
    size, seen = np.ones(len(assembled.gap)), np.zeros(len(assembled.gap), bool)
    pieces, extent = _pieces(conditions, assembled), assembled.extent
    each = (pieces[:, None] * extent.spreads).max(axis=2)  # of the piece that an entry belongs to
    spread = extent.along(each.T @ pieces)
    for _ in range(ROUNDS):  # a square at the second, unless the first is too small for more than rounding
        moved = conditions.assemble(_moved(conditions, iterate, assembled, step, size))
        bent = _changed(assembled, moved, spread, size[:, None] * step.largest[:, : spread.shape[1]])
        seen = (bent > 0) & np.isfinite(bent)
        size = size * np.sqrt(MOVED / np.where(seen, bent, MOVED))
    return np.where(seen, size, 0.0)


def _changed(before: Assembled, after: Assembled, spread: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """How what the nodes before the end and the points lack has changed, in spreads of the coordinates, shape (B,).

    ``moves``: of the coordinates, shape (B, n), beside which less of it is rounding.
    """
    lacking = np.abs(after.gap - before.gap)[:, :-1].sum(axis=1)
    if before.blocks.inner is not None:
        lacking += np.abs(after.blocks.inner.defect - before.blocks.inner.defect).sum(axis=(1, 2))
    told = (spread > 0) & (lacking > ROUNDED * moves)
    return np.where(told, lacking / np.where(spread > 0, spread, 1.0), 0.0).max(axis=1, initial=0.0)


def _moved(conditions: Conditions, iterate: Iterate, assembled: Assembled, step: Step, size: np.ndarray) -> Iterate:
    """The iterates moved by so many times a step, not at all where that is none."""
    steps, largest = (
        np.where((size > 0).reshape(-1, *ones), a, 0.0) * size.reshape(-1, *ones)
        for a, ones in ((step.unknowns, (1, 1)), (step.largest, (1,)))
    )
    completed = conditions.completed(iterate.bare, assembled, step._replace(unknowns=steps, largest=largest))
    return conditions.move(iterate.bare, assembled, completed, np.ones(len(size)))


def _is_unmet(conditions: Conditions, iterate: Iterate, assembled: Assembled, step: Step) -> np.ndarray:
    """Whether a step leaves much of what the linearised constraints ask for, as where these are dependent, shape
    (B,)."""
    from . import extent_kernels

    system, out = conditions.system(iterate, assembled), np.empty((2, len(step.unknowns)))
    given = system.gap[..., 0], system.left, system.right, step.unknowns[..., None], conditions.fixed
    extent_kernels.leave(*map(plain, (*given, conditions.measured.nodes)), out)
    left, asked = out
    return (asked > MET) & ~(left <= UNMET * asked)


def _is_far(conditions: Conditions, assembled: Assembled, step: Step) -> np.ndarray:
    """Whether all of the states that is spread along the trajectory is moved by many times that, shape (B,)."""
    far, spread = _moves(conditions, assembled, step)
    return ~step.finite | np.any(spread > 0, axis=0) & np.all((far > FAR * spread) | (spread == 0), axis=0)


def _moves(conditions: Conditions, assembled: Assembled, step: Step) -> tuple[np.ndarray, np.ndarray]:
    """How far the states are moved, and their spreads, piece by piece: (pieces, B)."""
    extent, pieces = assembled.extent, _pieces(conditions, assembled)[:, None]
    moved = (step.largest[:, : extent.support.shape[1], None] * extent.support).max(axis=1)
    return (pieces * moved).max(axis=2), (pieces * extent.spreads).max(axis=2)


def _pieces(conditions: Conditions, assembled: Assembled) -> np.ndarray:
    """The entries of each array, but for those that a coordinate of their own moves, which may have other units and are
    pieces by themselves: (pieces, E)."""
    single = alone(assembled.extent.support.max(axis=0))
    pieces = np.concatenate([conditions.at_nodes.layout.in_arrays * ~single, np.eye(single.size)[single]])
    return pieces[pieces.any(axis=1)]
