"""The results of the engine as discrete extremals."""

from typing import Any

import numpy as np

from ....compute.binding.transcription import Scale
from ..transcription.core_search import flat_limits, put, transcription_of
from ..transcription.discrete_extremals import AtStages, DiscreteExtremals, Inequalities, Residuals
from ..transcription.iterate import Iterate
from ..transcription.kkt_system import KKTSystem
from .conditions import Conditions
from .found import Found
from .kkt_system import Assembled
from .transcription import Blocks


def adapted(conditions: Conditions, found: Found) -> DiscreteExtremals:
    """The discrete extremals that a search of the engine found under these conditions."""
    iterate, assembled, own = found.iterate, found.assembled, found.residuals
    steps, data = conditions.transcription, conditions.data

    def at_stages(costates: np.ndarray) -> AtStages:
        return steps.at_stages(iterate.unknowns, costates, data, iterate.slacks)

    def system(k: int) -> KKTSystem:
        transcription, units, slacks = transcription_of(conditions), conditions.measured, iterate.slacks
        at = transcription.trajectory()
        put(at, conditions, iterate, k)
        if slacks is not None:
            for name, array in zip(("SLACKS", "LIMIT_MULTIPLIERS", "EXCESSES", "PENALTIES"), slacks, strict=False):
                at[name] = flat_limits(steps, array[k])
        return KKTSystem(transcription, at.iterate, Scale(units.unknowns[k], units.nodes[k], float(units.cost[k])))

    return DiscreteExtremals(
        assembled.nodes,
        assembled.costates,
        assembled.cost,
        Residuals(*own[:5], own.largest),
        found.missing,
        _inequalities(conditions, iterate, assembled),
        found.strict_minimum,
        _convex(_own_blocks(assembled.blocks, steps.controls.dimension)),
        found.iterations,
        found.limited,
        found.claimed,
        found.solvable,
        found.contradictory,
        found.falling,
        at_stages,
        system,
        found.stopped,
        found.boundary,
        found.notes,
    )


def _inequalities(conditions: Conditions, iterate: Iterate, assembled: Assembled) -> Inequalities | None:
    """The inequalities along trajectories, if there are any."""
    slacks, barrier = iterate.slacks, conditions.barrier
    if slacks is None or barrier is None:
        return None
    held = assembled.blocks.inequalities
    return Inequalities(held.values, held.weights, slacks.slacks, slacks.multipliers, barrier.unit, barrier.rate)


def _own_blocks(blocks: Blocks, m: int) -> np.ndarray:
    """The Hessians by the controls of each point with the share of the inequalities, shape (B, N, s, m, m)."""
    whole: Any = blocks.hessian[:, :, None] if blocks.inner is None else blocks.inner.points.hessian
    first = whole.shape[-1] - m
    return whole[..., first:, first:]


def _convex(own: np.ndarray) -> np.ndarray:
    """Whether each member has positive definite Hessians at all its points, shape (B,)."""
    try:
        np.linalg.cholesky(own)
    except np.linalg.LinAlgError:
        return np.zeros(1, bool) if len(own) == 1 else np.concatenate([_convex(part[None]) for part in own])
    return np.ones(len(own), bool)
