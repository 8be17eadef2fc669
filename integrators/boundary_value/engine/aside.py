"""Guesses from which Newton's method cannot set out, moved aside.

At rest a system without drift is controllable in no direction but those of its controls: the constraints of the guess
are dependent, and Newton's step has no bound. Near to rest it has one, far beyond anything that the trajectory is like.
Nor is it known which way round ends come together that are opposite to each other. Then the guess is moved by controls
that are random but always the same, and by the states to which they lead to first order.
"""

import numpy as np

from .conditions import Conditions
from .elimination import BlockSystem, eliminate
from .extent import alone
from .kkt_system import Assembled, Iterate, Step
from .scaling import SHARE, Units

FAR = 30.0  # times its spread: a trajectory is not asked to move by more
MOVED = 0.5  # of its spread: what it is moved aside by
OPPOSITE = 0.05  # the cosine of half the arc between ends: of their motion as much is seen from its middle
UNMET = 1e-3  # of what the linearised constraints ask for: a step that leaves more solves another problem
MET = 1e-8  # of the size of the nodes: of a guess that lacks less, what a step leaves is rounding
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


def aside(conditions: Conditions, iterate: Iterate, assembled: Assembled) -> Iterate:
    """The iterates moved aside, each until half of what the controls move has moved by half its spread."""
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
    far = _moves(conditions, assembled, step)
    # In the middle of all: next to nothing moves what controls do not reach, and the spread of what rests is rounding.
    far = np.sort(np.where(far > 0, far, np.inf), axis=0)
    middle = far[np.maximum(np.isfinite(far).sum(axis=0) - 1, 0) // 2, range(batch)]
    size = np.where(np.isfinite(middle), MOVED / middle, 0.0)
    steps, largest = (
        np.where(found.finite, size[:, None] * a, 0.0) for a in (step.unknowns.reshape(batch, -1), step.largest)
    )
    step = step._replace(unknowns=steps.reshape(step.unknowns.shape), largest=largest)
    completed = conditions.completed(iterate._replace(slacks=None), assembled, step)
    return conditions.move(iterate._replace(slacks=None), assembled, completed, np.ones(batch))


def _is_unmet(conditions: Conditions, iterate: Iterate, assembled: Assembled, step: Step) -> np.ndarray:
    """Whether a step leaves much of what the linearised constraints ask for, as where these are dependent, shape
    (B,)."""
    system, d = conditions.system(iterate, assembled), step.unknowns
    left = np.array(system.gap[..., 0])
    left[:, :-1] += np.einsum("bknz,bkz->bkn", system.left, d)
    left[:, 1:] -= np.einsum("bknz,bkz->bkn", system.right, d)
    left[:, 0] *= system.fixed_start
    left[:, -1] *= system.fixed_end
    left, asked = (
        np.abs(found / conditions.measured.nodes[:, None]).max(axis=(1, 2)) for found in (left, system.gap[..., 0])
    )
    return (asked > MET) & ~(left <= UNMET * asked)


def _is_far(conditions: Conditions, assembled: Assembled, step: Step) -> np.ndarray:
    """Whether all of the states that is spread along the trajectory is moved by many times that, shape (B,)."""
    least = np.min(_moves(conditions, assembled, step), axis=0, initial=np.inf)
    return ~step.finite | (np.isfinite(least) & (least > FAR))


def _moves(conditions: Conditions, assembled: Assembled, step: Step) -> np.ndarray:
    """How far the states are moved, in their spreads, infinite where these are zero: (pieces, B).

    Pieces are the arrays, but for the entries that a coordinate of their own moves: they may have other units.
    """
    extent, n = assembled.extent, assembled.gap.shape[2]
    moved = (step.largest[:, :n, None] * extent.support).max(axis=1)
    single = alone(extent.support.max(axis=0))
    pieces = np.concatenate([conditions.at_nodes.layout.in_arrays * ~single, np.eye(single.size)[single]])
    pieces = pieces[pieces.any(axis=1)][:, None]
    spread, far = (pieces * extent.spreads).max(axis=2), (pieces * moved).max(axis=2)
    return np.where(spread > 0, far / np.where(spread > 0, spread, 1.0), np.inf)
