"""The KKT system of a batch of trajectories at an iterate, and a step of Newton's method on it."""

from typing import Any, NamedTuple, Self

import numpy as np

from .extent import Extent
from .inequalities import Turn
from .transcription import Blocks, Paid, Terminal


class Assembled(NamedTuple):
    """The KKT system at an iterate, in the units of the problem, and what tells how far the iterate is from satisfying
    it."""

    blocks: Blocks
    gap: np.ndarray  # what the nodes lack in the frames there, shape (B, N + 1, n)
    asked: np.ndarray  # what a step is asked to move by in the coordinates of the frames, which see it foreshortened
    frames: np.ndarray  # (B, N + 1, n, E)
    coordinates: np.ndarray  # multipliers in the frames, (B, N + 1, n)
    nodes: np.ndarray  # (B, N + 1, E)
    costates: np.ndarray
    cost: np.ndarray
    paid: Paid
    distance: np.ndarray  # largest distance between ends that should meet, entry by entry, shape (B, E)
    extent: Extent
    curved: np.ndarray | None = None  # what the cost of all phases curves by in their units, shape (B,); None: alone


class Step(NamedTuple):
    """A step of the unknowns and of the multipliers, and what its elimination tells of the system."""

    unknowns: np.ndarray
    multipliers: np.ndarray
    largest: np.ndarray  # of each unknown, shape (B, z)
    strict: np.ndarray  # positive definite on the null space of the constraints, beyond rounding
    convex: np.ndarray  # the inertia is that of one that is, or without inequalities is hidden by rounding
    finite: np.ndarray
    inner: Any = None  # of what was condensed
    turn: Turn | None = None  # of the slacks
    share: np.ndarray | float = 1.0  # of the step that may be made
    followed: np.ndarray | float = 1.0  # of the step that points of constant size follow

    @property
    def reach(self) -> np.ndarray | float:
        """The share of the step that may be made, and that the inequalities let it go."""
        return self.share if self.turn is None else self.turn.reach

    @property
    def of_multipliers(self) -> "Step":
        """The whole step of the multipliers on what is lacking, and none of anything else."""
        inner = None if self.inner is None else (np.zeros_like(self.inner[0]), self.inner[1])
        none = np.zeros_like(self.unknowns), np.zeros_like(self.largest)
        return self._replace(unknowns=none[0], largest=none[1], inner=inner, turn=None, share=1.0)

    def within(self, share: np.ndarray) -> "Step":
        """The step of which at most this share is made."""
        if self.turn is None:
            return self._replace(share=share, followed=share)
        return self._replace(
            share=share, followed=share, turn=self.turn._replace(reach=np.minimum(share, self.turn.reach))
        )


class Residuals(NamedTuple):
    """How far an iterate is from what is asked of it, relative to what that is made of, shape (B,).

    Largest distance between ends that should meet; largest derivative of the Lagrangian; of the inequalities largest
    residuals of ``g + s = t``, of ``t = 0``, of ``nu s = 0``, and of ``nu s = mu``; and the largest of some of these.
    """

    gap: np.ndarray
    stationarity: np.ndarray
    violation: np.ndarray
    excess: np.ndarray
    complementarity: np.ndarray
    centring: np.ndarray
    steady: np.ndarray  # but for those that the barrier moves
    final: np.ndarray  # of the problem itself
    largest: np.ndarray  # of the problem with its barrier

    @classmethod
    def of(cls, gap: np.ndarray, stationarity: np.ndarray, *limits: np.ndarray) -> Self:
        """With the largest of them; ``limits``: those of the inequalities."""
        violation, excess, complementarity, centring = limits
        steady = np.maximum(np.maximum(gap, stationarity), violation)
        final = np.maximum(steady, np.maximum(excess, complementarity))
        own = gap, stationarity, violation, excess, complementarity, centring
        return cls(*own, steady, final, np.maximum(steady, centring))


def turned_by(costates: np.ndarray, paid: Paid, sign: int) -> np.ndarray:
    """Covectors at the nodes with the derivatives of the costs of the ends added to them, or taken from them."""
    if paid == (None, None):
        return costates
    turned, (initial, terminal) = np.array(costates), paid
    if terminal is not None:
        turned[:, -1] += sign * terminal.derivative
    if initial is not None:
        turned[:, 0] -= sign * initial.derivative
    return turned


def pay(blocks: Blocks, place: int, paid: Terminal | None, end: np.ndarray) -> None:
    """Add the cost of an end to the blocks of the step there; ``end``: the derivative of that, shape (B, n, z)."""
    if paid is None:
        return
    blocks.hessian[:, place] += end.mT @ paid.curvature @ end
    blocks.gradient[:, place] += np.einsum("bn,bnz->bz", paid.slope, end)
    if blocks.inner is not None:  # what the condensed velocities move the end by, the slope of its cost is moved with
        pushed = blocks.slope if blocks.pushed is None else blocks.pushed[..., 0]
        moved = blocks.inner.after[:, -1] if place else blocks.inner.before[:, 0]
        pushed[:, place] += np.einsum("bnz,bnj,bj->bz", end, paid.curvature, moved)


def steps_of_covectors(assembled: Assembled, step: Step) -> np.ndarray:
    """Steps of the covectors at the nodes: of the multipliers, and at the ends of the slopes of their costs, which
    move."""
    if assembled.paid == (None, None):
        return step.multipliers
    turned, (initial, terminal), blocks = np.array(step.multipliers), assembled.paid, assembled.blocks
    if terminal is not None:
        moved = np.einsum("bnz,bz->bn", blocks.right[:, -1], step.unknowns[:, -1])
        moved += 0.0 if blocks.inner is None else blocks.inner.after[:, -1]
        turned[:, -1] -= np.einsum("bnj,bj->bn", terminal.curvature, moved)
    if initial is not None:
        begun = np.einsum("bnz,bz->bn", blocks.left[:, 0], step.unknowns[:, 0])
        begun += 0.0 if blocks.inner is None else blocks.inner.before[:, 0]
        turned[:, 0] += np.einsum("bnj,bj->bn", initial.curvature, begun)
    return turned


def promised(assembled: Assembled, step: Step) -> tuple[np.ndarray, np.ndarray]:
    """Changes of the cost and of the multipliers on what is lacking, to first order, by the whole step."""
    blocks = assembled.blocks
    ahead = np.einsum("bkz,bkz->b", blocks.gradient, step.unknowns)
    turned = np.einsum("bkn,bkn->b", step.multipliers, assembled.gap)
    inner = blocks.inner
    if inner is None:
        return ahead, turned
    for end, moved in zip(assembled.paid, (inner.before[:, 0], inner.after[:, -1]), strict=True):
        ahead += 0.0 if end is None else (end.slope * moved).sum(axis=1)
    velocities, multipliers = step.inner
    direct = inner.kept[2][..., : step.unknowns.shape[2]]
    within = np.einsum("bkiz,bkz->bki", direct, step.unknowns).reshape(velocities.shape)
    ahead += (inner.gradient * (velocities - within)).sum(axis=(1, 2, 3))
    return ahead, turned + (multipliers * inner.defect).sum(axis=(1, 2, 3))
