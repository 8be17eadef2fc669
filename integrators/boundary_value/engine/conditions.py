"""The conditions of a discrete extremal: ends meet, the cost is stationary; in units of the trajectory itself."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import joined, taken
from ..transcription.discrete_phase import DiscretePhase
from ..transcription.iterate import Data, Ends, Iterate, Slacks
from .augmented import is_isolated_minimum
from .barrier import DEARER, Barrier
from .batches import merged
from .beginning import forgotten, in_units, started, warmed
from .elimination import BlockSystem, clear_pivot, eliminate, is_strict_minimum
from .extent import extent
from .inequalities import Held, Surveyed, fitted, moved, turned
from .kkt_system import Assembled, Residuals, Step, pay, promised, steps_of_covectors, turned_by
from .meeting import meeting
from .residuals import Appraisal, appraisal
from .scaling import SHARE, Units, typical_curvatures
from .share import followed
from .transcription import Blocks, Moves, Nodes, Paid, extend
from .trial import Setting, Tried

LEAST = 1e6  # the shift with which a step is the least that the constraints ask for


class Conditions(DiscretePhase):  # pyright: ignore[reportGeneralTypeIssues]
    """The conditions of a batch of trajectories.

    ``units``, and the ``barrier`` of the inequalities, if there are any, are those of the iterates that it began with;
    ``wider``: units that steps are measured in since, if any.
    """

    def __init__(
        self,
        transcription: Any,
        nodes: Nodes,
        ends: Ends,
        data: Data,
        units: Units | None = None,
        barrier: Barrier | None = None,
        wider: Units | None = None,
    ) -> None:
        self.transcription, self.at_nodes, self.ends, self.data = transcription, nodes, ends, data  # pyright: ignore
        self.units, self.barrier, self.wider = units, barrier, wider
        self._survey: tuple[Held, Slacks, np.ndarray] | None = None  # the last one, and of what
        self._appraisal: tuple[tuple, Appraisal] | None = None
        # A trial of the whole of a step that is known; None where it takes more than a compiled pass.
        self.ahead: tuple[Step, Tried | None] | None = None

    def of(self, members: np.ndarray) -> "Conditions":
        """The conditions of some members."""
        if len(members) == len(self.data.steps):
            return self
        ends = Ends(self.ends.start[members], self.ends.end[members], *self.ends[2:])
        asked = None if self.data.asked is None else self.data.asked[members]
        data = Data(self.data.steps[members], self.data.parameters[members], asked)
        units, wider = (own and Units(*(leaf[members] for leaf in own)) for own in (self.units, self.wider))
        barrier = None if self.barrier is None else Barrier(*(leaf[members] for leaf in self.barrier))
        return Conditions(self.transcription, self.at_nodes, ends, data, units, barrier, wider)

    def adopt(self, parts: Sequence["Conditions"], order: np.ndarray | slice) -> None:
        """Take the units of parts whose members are all of these, in this order."""

        def every(own: list[Any]) -> Any:
            return taken(joined(own), order)

        self.units, self.barrier = every([own.units for own in parts]), every([own.barrier for own in parts])
        wider = any(own.wider is not None for own in parts)
        self.wider = every([own.measured for own in parts]) if wider else None

    @property
    def judging(self) -> Units:
        """The units that tell whether the conditions are met, once they are measured: not wider ones, by which what
        solves nothing may lack next to nothing."""
        if self.units is None:
            raise RuntimeError("the conditions have no units yet; call begin with a guess")
        return self.units

    @property
    def measured(self) -> Units:
        """The units of steps, the wider ones if there are any."""
        return self.judging if self.wider is None else self.wider

    def paid(self, nodes: np.ndarray) -> Paid:
        """The costs of the first and of the last node."""
        return self.at_nodes.paid(nodes[:, 0], nodes[:, -1], self.data.parameters)

    def assemble(self, iterate: Iterate, paid: Paid | None = None) -> Assembled:
        """The KKT system at an iterate; ``paid``: what the first and the last node cost, if not the costs of the
        problem."""
        begins, finishes = self.transcription.ends(iterate.unknowns, self.data)
        met = meeting(begins, finishes, self.both_ends, self.at_nodes)
        paid = self.paid(met.nodes) if paid is None else paid
        covectors = turned_by(iterate.costates, paid, 1)
        frames, gap, coordinates, costates = self.at_nodes.in_frames(met.nodes, self.fixed, met.gaps, covectors)
        asked = gap if met.asked is None else self.fixed * np.einsum("bkne,bke->bkn", frames, met.asked)
        costates = turned_by(costates, paid, -1)
        blocks = self.blocks(iterate, met.nodes, costates, paid)
        cost = sum((end.value for end in paid if end is not None), blocks.costs.sum(axis=1))
        ends = paid, met.largest, extent(met.nodes, frames, coordinates, gap, blocks)
        return Assembled(blocks, gap, asked, frames, coordinates, met.nodes, costates, cost, *ends)

    def blocks(self, iterate: Iterate, nodes: np.ndarray, costates: np.ndarray, paid: Paid) -> Blocks:
        """The blocks of the steps, with the costs of the first node and of the last."""
        blocks = self.transcription.blocks(iterate.unknowns, nodes, costates, self.data, iterate.slacks)
        pay(blocks, -1, paid[1], blocks.right[:, -1])
        pay(blocks, 0, paid[0], blocks.left[:, 0])
        return blocks

    def move(self, iterate: Iterate, assembled: Assembled, step: Step, fraction: np.ndarray) -> Iterate:
        """The iterate moved by fractions of the share of the steps that the inequalities let it go."""
        part = fraction * step.reach
        multipliers = steps_of_covectors(assembled, step)
        moves = Moves(step.unknowns, multipliers, part, step.inner)
        unknowns = self.transcription.move(iterate.unknowns, assembled.blocks, moves, self.data)
        covectors = assembled.coordinates + part[:, None, None] * multipliers
        costates = (covectors[:, :, None] @ assembled.frames)[:, :, 0]
        costates = turned_by(costates, assembled.paid, -1)
        slacks = iterate.slacks
        if slacks is not None and step.turn is not None:
            slacks = moved(slacks, step.turn, fraction)
        return Iterate(unknowns, costates, slacks)

    def tried(
        self, iterate: Iterate, assembled: Assembled, step: Step, fraction: np.ndarray
    ) -> tuple[Iterate, Assembled]:
        """The iterate moved by fractions of the steps, as by ``move``, and its system."""
        before, setting, found = (iterate, assembled, step), self.setting, None
        if self.ahead is not None and self.ahead[0] is step and fraction == 1:
            found = self.ahead[1]
        elif setting is not None:
            found = setting.trial(setting, self, before, fraction * step.reach)
        if found is None:
            moved = self.move(*before, fraction)
            return moved, self.assemble(moved)
        self.knows(found)
        return found.iterate, found.assembled

    def knows(self, tried: Tried) -> Appraisal:
        """The appraisal of a trial, which is known, as the survey of its inequalities is."""
        if tried.iterate.slacks is not None:
            self._survey = tried.assembled.blocks.inequalities, tried.iterate.slacks, tried.surveyed
        self._appraisal = self._key(tried.iterate, tried.assembled), tried.appraisal
        return tried.appraisal

    @cached_property
    def setting(self) -> Setting | None:
        """What the compiled pass of a trial takes, if there is one."""
        return Setting.of(self)

    def begin(self, guess: Iterate, firm: float = 1.0) -> tuple[Iterate, Assembled]:
        """The first iterate with its system; takes the units from it; ``firm``: see ``Barrier``.

        Multipliers of inequalities that do not fit tell nothing, nor do the costates that came with them.
        """
        first, assembled = in_units(self, guess)
        if first.slacks is None:
            return first, assembled
        iterate, fits = warmed(self, guess, started(self, first, assembled, firm), [assembled])
        if not fits.all():
            return self.begin(merged(fits, guess, forgotten(self, guess)), firm)
        return iterate, self.assemble(iterate)

    def appraised(self, iterate: Iterate, assembled: Assembled) -> Appraisal:
        """How far iterates are from satisfying the conditions, and what they are compared by; asked for several times
        in turn."""
        key = self._key(iterate, assembled)
        if self._appraisal is None or any(a is not b for a, b in zip(self._appraisal[0], key, strict=True)):
            limits = None
            if self.barrier is not None and iterate.slacks is not None:
                limits = self._survey_of(iterate, assembled), iterate.slacks.barrier, self.barrier.rate
            units = self.judging, self.measured
            self._appraisal = key, appraisal(assembled, units, self.mean_step, limits)
        return self._appraisal[1]

    def _key(self, iterate: Iterate, assembled: Assembled) -> tuple[Any, ...]:
        """What an appraisal depends on."""
        return assembled, iterate.slacks, self.units, self.wider, self.barrier

    def residuals(self, iterate: Iterate, assembled: Assembled) -> Residuals:
        """How far iterates are from satisfying the conditions."""
        return self.appraised(iterate, assembled).residuals

    def lowered(
        self, iterate: Iterate, assembled: Assembled, residuals: Residuals, tolerance: float
    ) -> tuple[Iterate, np.ndarray, np.ndarray]:
        """The iterate with a lower barrier where its problem is solved; where that is; and where excesses are too
        cheap.

        There the cost counts less instead: all multipliers grow with the price, and the system is to be assembled anew.
        """
        dear = self.dear(iterate, assembled)
        iterate, changed, cheap = self.less(iterate, assembled, residuals, tolerance, dear)
        return (self.dearer(iterate, cheap) if np.any(cheap) else iterate), changed, cheap

    def dear(self, iterate: Iterate, assembled: Assembled) -> np.ndarray:
        """What all multipliers have grown by with the price of excesses, shape (B,)."""
        if self.barrier is None or iterate.slacks is None:
            return np.ones(len(self.data.steps))
        return self.barrier.dear(self._surveyed(iterate, assembled))

    def less(
        self, iterate: Iterate, assembled: Assembled, residuals: Residuals, tolerance: float, dear: np.ndarray
    ) -> tuple[Iterate, np.ndarray, np.ndarray]:
        """The same before the cost counts less."""
        if self.barrier is None or iterate.slacks is None:
            none = np.zeros(len(residuals.gap), bool)
            return iterate, none, none
        found = self._surveyed(iterate, assembled)
        slacks, cheap = self.barrier.lowered(found, iterate.slacks, residuals.steady, tolerance, dear)
        return iterate._replace(slacks=slacks), slacks.barrier != iterate.slacks.barrier, cheap

    def dearer(self, iterate: Iterate, cheap: np.ndarray) -> Iterate:
        """The iterate with all multipliers as where the cost counts less, in some members."""
        factor = np.where(cheap, DEARER, 1.0)
        unknowns = self.transcription.scaled(iterate.unknowns, factor)
        slacks = None if iterate.slacks is None else iterate.slacks.scaled(factor)
        return Iterate(unknowns, factor[:, None, None] * iterate.costates, slacks)

    def softened(self, iterate: Iterate, assembled: Assembled, where: np.ndarray) -> Iterate:
        """The iterate with all inequalities elastic in some members."""
        if self.barrier is None or iterate.slacks is None:
            return iterate
        return iterate._replace(slacks=self.barrier.softened(assembled.blocks.inequalities, iterate.slacks, where))

    def met(self, iterate: Iterate, assembled: Assembled) -> Iterate:
        """The iterate with slacks that meet the inequalities where these hold; itself if they do."""
        slacks = iterate.slacks and fitted(assembled.blocks.inequalities, iterate.slacks)
        return iterate if slacks is iterate.slacks else iterate._replace(slacks=slacks)

    def is_infeasible(
        self, iterate: Iterate, assembled: Assembled, residuals: Residuals, tolerance: float
    ) -> np.ndarray:
        """Whether inequalities contradict each other, or the ends: where what they lack is least and is not zero."""
        if self.barrier is None or iterate.slacks is None:
            return np.zeros(len(residuals.gap), bool)
        found = self._surveyed(iterate, assembled)
        return self.barrier.is_infeasible(found, iterate.slacks, residuals.steady, tolerance)

    def _surveyed(self, iterate: Iterate, assembled: Assembled) -> Surveyed:
        """The survey of the inequalities of an iterate."""
        return Surveyed(*self._survey_of(iterate, assembled))

    def _survey_of(self, iterate: Iterate, assembled: Assembled) -> np.ndarray:
        """The rows of the survey; it is asked for several times in turn."""
        if self.barrier is None or iterate.slacks is None:
            raise RuntimeError("there are no inequalities to survey; assemble an iterate that has slacks")
        held, slacks = assembled.blocks.inequalities, iterate.slacks
        if self._survey is None or self._survey[0] is not held or self._survey[1] is not slacks:
            self._survey = held, slacks, self.barrier.surveyed(held, slacks)
        return self._survey[2]

    def barriers(self, iterate: Iterate) -> np.ndarray:
        """The barriers relative to the unit of the cost rate, zero without inequalities."""
        if self.barrier is None or iterate.slacks is None:
            return np.zeros(len(self.data.steps))
        return iterate.slacks.barrier / self.barrier.rate

    def is_isolated_minimum(self, iterate: Iterate, assembled: Assembled) -> np.ndarray:
        """Whether the Hessian of the Lagrangian is positive definite on the null space of the constraints, beyond
        rounding."""
        return is_isolated_minimum(self, iterate, assembled)

    def is_hard(self, iterate: Iterate, assembled: Assembled) -> np.ndarray:
        """Whether a member has inequalities that are not elastic and can be."""
        if self.barrier is None or iterate.slacks is None:
            return np.zeros(len(assembled.gap), bool)
        return self.barrier.is_hard(assembled.blocks.inequalities, iterate.slacks)

    def is_met(self, iterate: Iterate, assembled: Assembled, tolerance: float) -> np.ndarray:
        """Whether nothing is lacking at a node in any coordinate, by what gaps are measured by, and at a point no more
        than the root of the tolerance, in units of success, shape (B,)."""
        found = self.appraised(iterate, assembled)
        lacking = np.all(assembled.extent.lacking <= tolerance * found.along, axis=1)
        # The points of a step may lack what its nodes do not: from there Newton's method moves.
        return lacking & (found.unmet <= np.sqrt(tolerance))

    def shortfall(self, iterate: Iterate, assembled: Assembled) -> np.ndarray:
        """The most that a node or a point lacks in a coordinate, in its unit, shape (B,)."""
        return self.appraised(iterate, assembled).shortfall

    def merit(self, iterate: Iterate, assembled: Assembled) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The sum of what all nodes, points and inequalities lack; the cost with its barrier, and the multipliers on
        what is lacking, in the unit of the cost."""
        found = self.appraised(iterate, assembled)
        return found.infeasibility, found.cost, found.held

    def promise(self, iterate: Iterate, assembled: Assembled, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the cost and of the multipliers on what is lacking, to first order, by all that the step may
        go."""
        ahead, turned = promised(assembled, step)
        if step.turn is not None and iterate.slacks is not None:
            ahead += step.turn.ahead
            dual = step.turn.dual * step.turn.lacking
            return step.reach * ahead / self.measured.cost, (step.reach * turned + dual) / self.measured.cost
        return step.reach * ahead / self.measured.cost, step.reach * turned / self.measured.cost

    def eliminate(
        self, iterate: Iterate, assembled: Assembled, shift: np.ndarray
    ) -> tuple[Step, np.ndarray, np.ndarray]:
        """Newton's steps with a shift of the Hessians, relative to them; and their curvatures and sizes."""
        free = assembled.blocks.held is None  # with a barrier the curvature has no bound
        scales = typical_curvatures(assembled.extent.curvature, self.measured) if free else None
        found = eliminate(self.system(iterate, assembled), self.measured, shift, scales)
        both, count = (found.steps[..., 0], found.multipliers[..., 0], found.largest), found.multipliers[0].size
        convex = found.negative == count
        if free:  # an inertia that is hidden by rounding does not speak against it
            convex |= found.smallest <= clear_pivot(count)
        step = Step(*both, is_strict_minimum(found, count), convex, found.finite[:, 0])
        return self.completed(iterate, assembled, step), found.curvature, found.size

    def least_step(self, iterate: Iterate, assembled: Assembled) -> Step:
        """The least steps that the linearised constraints ask for, whatever these cost."""
        return self.eliminate(iterate, assembled, np.full(len(assembled.gap), LEAST))[0]

    def completed(self, iterate: Iterate, assembled: Assembled, step: Step) -> Step:
        """The step with what it is of what was condensed, and of the slacks; and how much of it may be made."""
        blocks, steps, covectors = assembled.blocks, step.unknowns, steps_of_covectors(assembled, step)
        if blocks.inner is not None or blocks.held is not None:
            moves = Moves(steps, covectors, np.ones(len(steps)))
            if blocks.inner is not None:
                moves = moves._replace(inner=self.transcription.whole(blocks, moves, self.data, iterate.slacks))
            turn = None
            if iterate.slacks is not None:
                turn = turned(blocks.inequalities, iterate.slacks, self.transcription.at_each(moves, self.data))
            step = step._replace(inner=moves.inner, turn=turn)
        share = followed(self.transcription, self.at_nodes, self.data, iterate, assembled, step, covectors)
        return step.within(share)

    def length(self, step: Step) -> np.ndarray:
        """The largest entry of a step in its unit, shape (B,)."""
        return (step.largest / self.measured.unknowns).max(axis=1)

    def wanted(self, iterate: Iterate, assembled: Assembled, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """The steps that the linearised conditions still ask for; and how far the trajectories go, in the units that
        success is judged in.

        The first is ``K^-1`` times the residual, rounding included: the error that remains, relative to the trajectory.
        Where K is singular to rounding, it is as large as that.
        """
        extent, controls, units = assembled.extent, self.control_sizes(iterate), self.judging.unknowns
        # Of a constant, a share of its value: where extremals merge it has to be known better than they are apart.
        values = np.where(extent.moves, 1.0, SHARE) * extent.values
        own = np.concatenate([extent.along(extent.spreads + values), controls], axis=1)
        largest = step.largest / np.maximum(own, SHARE * units)
        spread = np.concatenate([extent.along(extent.spreads), controls], axis=1)
        return largest.max(axis=1), (spread / units).max(axis=1)

    @cached_property
    def both_ends(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The ends as the kernels take them."""
        ends = self.ends
        start, end = (np.array(points, order="C") for points in ends[:2])  # members of one for all lie in another order
        return start, end, np.array(ends.start_entries), np.array(ends.end_entries)

    def system(self, iterate: Iterate, assembled: Assembled) -> BlockSystem:
        """The equations of Newton's step."""
        blocks, fixed = assembled.blocks, self.fixed_ends
        gap, slope = assembled.asked, blocks.slope
        if blocks.pushed is not None and iterate.slacks is not None:
            slope = blocks.pushed[..., 0] + iterate.slacks.barrier[:, None, None] * blocks.pushed[..., 1]
        if blocks.inner is not None:
            gap = np.array(gap)
            gap[:, :-1] += blocks.inner.before
            gap[:, 1:] -= blocks.inner.after
        return BlockSystem(blocks.hessian, blocks.left, blocks.right, slope[..., None], gap[..., None], *fixed)

    @cached_property
    def mean_step(self) -> np.ndarray:
        """The mean step of each member."""
        return self.data.steps.sum(axis=1) / self.data.steps.shape[1]

    def control_sizes(self, iterate: Iterate) -> np.ndarray:
        """Sizes of the controls, shape (B, s m)."""
        return self.at_nodes.control_sizes(iterate.unknowns.controls)


extend(DiscretePhase, Conditions)
