"""The conditions of trajectories whose ends are coupled: phases that follow one another, ends on a set, periodic
ends."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import joined, taken
from ....manifolds.numerics.tolerances import EPS, REGULAR
from ..transcription.discrete_phase import LinkedPhases
from ..transcription.iterate import Iterate
from .barrier import DEARER
from .batches import merged
from .beginning import forgotten, in_units, started, warmed
from .border import Response, Solved, responses, solve_border
from .conditions import LEAST, Conditions
from .coupling import Coupled, Coupling
from .elimination import MANY
from .first_units import first_units, reached
from .inequalities import VALUE
from .joint_system import JointAssembled, JointIterate, JointStep, JointUnits
from .kkt_system import Assembled, Residuals, Step
from .transcription import extend

FARTHEST = 1e60  # times as far as a trajectory of size one: of more squares overflow, and a derivative is next to zero


class JointConditions(LinkedPhases):  # pyright: ignore[reportGeneralTypeIssues]
    """The conditions of a batch of trajectories in phases, of which each has its own conditions."""

    def __init__(self, phases: tuple[Conditions, ...], coupling: Coupling, units: JointUnits | None = None) -> None:
        self.phases, self.coupling, self.units = phases, coupling, units

    def of(self, members: np.ndarray) -> "JointConditions":
        """The conditions of some members."""
        if self.units is not None and len(members) == len(self.units.cost):
            return self
        units = None if self.units is None else JointUnits(*(leaf[members] for leaf in self.units))
        return JointConditions(tuple(phase.of(members) for phase in self.phases), self.coupling, units)

    def adopt(self, parts: Sequence["JointConditions"], order: np.ndarray | slice) -> None:
        """Take the units of parts whose members are all of these, in this order."""
        for phase, *own in zip(self.phases, *(part.phases for part in parts), strict=True):
            phase.adopt(own, order)
        self.units = taken(joined([part.units for part in parts]), order)

    @property
    def measured(self) -> JointUnits:
        """The units, once they are measured."""
        if self.units is None:
            raise RuntimeError("the conditions have no units yet; call begin with a guess")
        return self.units

    @property
    def judging(self) -> JointUnits:
        """The units that tell whether the conditions are met: those of phases are not widened."""
        return self.measured

    def begin(self, guess: JointIterate, firm: float = 1.0) -> tuple[JointIterate, JointAssembled]:
        """The first iterate with its system; takes the units from it; ``firm``: see ``Barrier``."""
        first = self.in_units(guess)
        parts = tuple(started(phase, *own, firm) for phase, own in zip(self.phases, first, strict=True))
        iterate, fits = warmed(self, guess, JointIterate(parts, guess.multipliers), [own[1] for own in first])
        if not fits.all():
            bare = tuple(forgotten(phase, part) for phase, part in zip(self.phases, guess.parts, strict=True))
            return self.begin(merged(fits, guess, JointIterate(bare, np.zeros_like(guess.multipliers))), firm)
        return iterate, self.assemble(iterate)

    def in_units(self, guess: JointIterate) -> list[tuple[Iterate, Assembled]]:
        """The phases of the guess, with inequalities that do not pull yet, and their systems, from which the units are
        taken, those of the cost from all phases together."""
        coupled, paid = self._coupled(guess)
        first = [in_units(phase, part, pay) for phase, part, pay in zip(self.phases, guess.parts, paid, strict=True)]
        self._measure(coupled, first)
        counts = [phase.data.steps.shape[1] for phase in self.phases]
        cost = np.max([self._cost(phase, own[1]) for phase, own in zip(self.phases, first, strict=True)], axis=0) / sum(
            counts
        )
        for phase in self.phases:
            phase.units = phase.measured._replace(cost=np.where(cost > 0, cost, 1.0))
        nodes = np.concatenate([phase.measured.nodes for phase in self.phases], axis=1)
        ends = np.concatenate([phase.measured.nodes for phase in self.phases for _ in range(2)], axis=1)
        rows = np.sum(np.abs(coupled.jacobian) * ends[:, None], axis=2)
        units = np.concatenate([nodes, np.where((rows > 0) & np.isfinite(rows), rows, 1.0)], axis=1)
        self.units = JointUnits(units, self.phases[0].measured.cost)
        return first

    def _measure(self, coupled: Coupled, first: list[tuple[Iterate, Assembled]]) -> None:
        """Units of the phases in which the equations between the ends ask for no more than a trajectory of size one."""
        found = [reached(phase, *own) for phase, own in zip(self.phases, first, strict=True)]
        ways = np.concatenate([np.where(way > 0, way, size) for way, size in found for _ in range(2)], axis=1)
        rows = np.sum(np.abs(coupled.jacobian) * (ways * self.free)[:, None], axis=2)
        values = np.abs(coupled.values)
        known = (rows > 0) & np.isfinite(rows) & (values < FARTHEST * rows)
        asked = np.where(known, values / np.where(known, rows, 1.0), 0.0).max(axis=1, initial=0.0)
        for phase, own, (way, _) in zip(self.phases, first, found, strict=True):
            phase.units = first_units(phase, *own, asked[:, None] * way)

    def _each(self, iterate: JointIterate, assembled: JointAssembled) -> list[tuple[Conditions, Iterate, Assembled]]:
        """The conditions, iterates and systems of all phases."""
        return list(zip(self.phases, iterate.parts, assembled.parts, strict=True))

    @staticmethod
    def _cost(phase: Conditions, assembled: Assembled) -> np.ndarray:
        """The unit of the cost of a whole phase; zero where it costs nothing."""
        # At rest a square has neither a value nor a slope: its curvature is what there is.
        blocks = assembled.blocks
        pays = np.any(blocks.gradient, axis=(1, 2)) | np.any(blocks.costs, axis=1)
        pays |= np.any(blocks.hessian, axis=(1, 2, 3))
        return np.where(pays, phase.measured.cost * phase.data.steps.shape[1], 0.0)

    def _coupled(self, iterate: JointIterate) -> tuple[Coupled, list[tuple[Any, Any]]]:
        """The equations at an iterate, and what the ends of each phase cost with them."""
        ends = [end for phase, part in zip(self.phases, iterate.parts, strict=True) for end in phase.reached(part)]
        coupled, paid = self.coupling(ends, [phase.data.parameters for phase in self.phases], iterate.multipliers)
        return coupled, list(zip(paid[::2], paid[1::2], strict=True))

    def assemble(self, iterate: JointIterate) -> JointAssembled:
        """The KKT system at an iterate."""
        coupled, paid = self._coupled(iterate)
        parts = (phase.assemble(part, pay) for phase, part, pay in zip(self.phases, iterate.parts, paid, strict=True))
        return JointAssembled(self._in_scale(tuple(parts), coupled), coupled)

    def _in_scale(self, systems: tuple[Assembled, ...], coupled: Coupled) -> tuple[Assembled, ...]:
        """The systems of the phases with what the cost of all curves by, those of their ends among them.

        Where it is least by itself, as where all measured points are met, costates vanish, also in phases without one.
        """
        sizes = [
            own * np.maximum(own, VALUE * system.extent.sizes)
            for own, system in zip((phase.judging.nodes for phase in self.phases), systems, strict=True)
        ]
        ends = np.concatenate([size for size in sizes for _ in range(2)], axis=1)
        found = [np.abs(np.diagonal(coupled.curvature, axis1=1, axis2=2)) * ends]
        for phase, system in zip(self.phases, systems, strict=True):
            if system.blocks.held is None:  # with a barrier it has no bound
                found.append(system.extent.curvature * phase.judging.unknowns**2)
        scale = np.concatenate(found, axis=1).max(axis=1, initial=0.0)
        return tuple(system._replace(curved=scale) for system in systems)

    def move(
        self, iterate: JointIterate, assembled: JointAssembled, step: JointStep, fraction: np.ndarray
    ) -> JointIterate:
        """The iterate moved by fractions of the share of the steps that the inequalities let it go."""
        parts = []
        for (phase, part, system), turn in zip(self._each(iterate, assembled), step.parts, strict=True):
            parts.append(phase.move(part, system, turn, fraction))
        frames = [frame for part in assembled.parts for frame in (part.frames[:, 0], part.frames[:, -1])]
        coordinates = assembled.coupled.multipliers + (fraction * step.reach)[:, None] * step.multipliers
        return JointIterate(tuple(parts), self.coupling.lifted(coordinates, frames))

    def tried(
        self, iterate: JointIterate, assembled: JointAssembled, step: JointStep, fraction: np.ndarray
    ) -> tuple[JointIterate, JointAssembled]:
        """The iterate moved by fractions of the steps, and its system."""
        moved = self.move(iterate, assembled, step, fraction)
        return moved, self.assemble(moved)

    def residuals(self, iterate: JointIterate, assembled: JointAssembled) -> Residuals:
        """How far iterates are from satisfying the conditions."""
        each = [phase.residuals(part, system) for phase, part, system in self._each(iterate, assembled)]
        largest = Residuals(*(np.max(values, axis=0) for values in zip(*each, strict=True)))
        own = largest.violation, largest.excess, largest.complementarity, largest.centring
        return Residuals.of(np.maximum(self._gap(iterate, assembled), largest.gap), largest.stationarity, *own)

    def _gap(self, iterate: JointIterate, assembled: JointAssembled) -> np.ndarray:
        """By how much the equations between the ends are missed, relative to what the trajectories change them by."""
        coupled, count, begin = assembled.coupled, self.coupling.count, 0
        sizes = [phase.appraised(part, system) for phase, part, system in self._each(iterate, assembled)]
        along = np.concatenate([size.along for size in sizes for _ in range(2)], axis=1)
        unit = np.sum(np.abs(coupled.jacobian[:, :count]) * along[:, None], axis=2)
        missed = [np.abs(coupled.values[:, :count]) / np.where(unit > 0, unit, 1.0)]
        for link, size in zip(self.coupling.links, self.coupling.sizes[1:], strict=True):
            entries = sizes[link.target // 2].entries[:, :size]
            missed.append(np.abs(coupled.apart[:, begin : begin + size]) / np.where(entries > 0, entries, 1.0))
            begin += size
        return np.max(np.concatenate(missed, axis=1), axis=1, initial=0.0)

    def lowered(
        self, iterate: JointIterate, assembled: JointAssembled, residuals: Residuals, tolerance: float
    ) -> tuple[JointIterate, np.ndarray, np.ndarray]:
        """The iterate with lower barriers where their problem is solved; where that is; and where excesses are too
        cheap."""
        # The price of one phase has raised the multipliers of all.
        dear = np.max([phase.dear(part, system) for phase, part, system in self._each(iterate, assembled)], axis=0)
        each = [
            phase.less(part, system, residuals, tolerance, dear)
            for phase, part, system in self._each(iterate, assembled)
        ]
        changed, cheap = np.any([own[1] for own in each], axis=0), np.any([own[2] for own in each], axis=0)
        parts, multipliers = [own[0] for own in each], iterate.multipliers
        if np.any(cheap):
            dearer = [phase.dearer(part, cheap) for phase, part in zip(self.phases, parts, strict=True)]
            parts, multipliers = dearer, multipliers * np.where(cheap, DEARER, 1.0)[:, None]
        return JointIterate(tuple(parts), multipliers), changed, cheap

    def softened(self, iterate: JointIterate, assembled: JointAssembled, where: np.ndarray) -> JointIterate:
        """The iterate with all inequalities elastic in some members."""
        return iterate._replace(
            parts=tuple(phase.softened(part, system, where) for phase, part, system in self._each(iterate, assembled))
        )

    def met(self, iterate: JointIterate, assembled: JointAssembled) -> JointIterate:
        """The iterate with slacks that meet the inequalities where these hold; itself if they do."""
        parts = tuple(phase.met(part, of) for phase, part, of in self._each(iterate, assembled))
        changed = any(a is not b for a, b in zip(parts, iterate.parts, strict=True))
        return iterate._replace(parts=parts) if changed else iterate

    def is_infeasible(
        self, iterate: JointIterate, assembled: JointAssembled, residuals: Residuals, tolerance: float
    ) -> np.ndarray:
        """Whether inequalities contradict each other, or the ends."""
        each = self._each(iterate, assembled)
        return np.any([phase.is_infeasible(part, of, residuals, tolerance) for phase, part, of in each], axis=0)

    def barriers(self, iterate: JointIterate) -> np.ndarray:
        """The largest barriers relative to the units of the cost rates."""
        return np.max([phase.barriers(part) for phase, part in zip(self.phases, iterate.parts, strict=True)], axis=0)

    def is_hard(self, iterate: JointIterate, assembled: JointAssembled) -> np.ndarray:
        """Whether a member has inequalities that are not elastic."""
        return np.any([phase.is_hard(part, system) for phase, part, system in self._each(iterate, assembled)], axis=0)

    def is_met(self, iterate: JointIterate, assembled: JointAssembled, tolerance: float) -> np.ndarray:
        """Whether nothing is lacking at a node or between the ends, and at a point no more than the root of the
        tolerance."""
        each = [phase.is_met(part, system, tolerance) for phase, part, system in self._each(iterate, assembled)]
        return np.all(each, axis=0) & (self._apart(assembled) <= tolerance)

    def shortfall(self, iterate: JointIterate, assembled: JointAssembled) -> np.ndarray:
        """The most that a node, a point or an equation between the ends lacks, in its unit, shape (B,)."""
        each = [phase.shortfall(part, system) for phase, part, system in self._each(iterate, assembled)]
        return np.max([*each, self._apart(assembled)], axis=0)

    def _apart(self, assembled: JointAssembled) -> np.ndarray:
        """The most that an equation between the ends lacks, in its unit, shape (B,)."""
        return np.max(np.abs(assembled.coupled.values) / self._rows, axis=1, initial=0.0)

    @property
    def _rows(self) -> np.ndarray:
        """The units of the equations."""
        return self.measured.nodes[:, -self.coupling.rows :] if self.coupling.rows else np.ones((1, 0))

    def merit(self, iterate: JointIterate, assembled: JointAssembled) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The sum of what all nodes, points, inequalities and equations between the ends lack; the cost with its
        barriers, and the multipliers on what is lacking, in the unit of the cost."""
        each = [phase.merit(part, system) for phase, part, system in self._each(iterate, assembled)]
        (missing, cost, held), coupled = np.sum(each, axis=0), assembled.coupled
        missing = missing + np.sum(np.abs(coupled.values) / self._rows, axis=1)
        return missing, cost, held + np.sum(coupled.multipliers * coupled.values, axis=1) / self.measured.cost

    def promise(
        self, iterate: JointIterate, assembled: JointAssembled, step: JointStep
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the cost and of the multipliers on what is lacking, to first order, by all that the step may
        go."""
        coupled, ahead, turned = assembled.coupled, np.zeros(len(step.reach)), np.zeros(len(step.reach))
        for (phase, part, system), turn in zip(self._each(iterate, assembled), step.parts, strict=True):
            one, other = phase.promise(part, system, turn)
            ahead, turned = ahead + one, turned + other
        # What the ends cost in a phase has the multipliers times the equations in it.
        pulled = np.einsum("br,brz,bz->b", coupled.multipliers, coupled.jacobian, step.moves)
        changed = np.sum(step.multipliers * coupled.values, axis=1)
        unit = step.reach / self.measured.cost
        return ahead - unit * pulled, turned + unit * changed

    def eliminate(
        self, iterate: JointIterate, assembled: JointAssembled, shift: np.ndarray
    ) -> tuple[JointStep, np.ndarray, np.ndarray]:
        """Newton's steps with a shift of the Hessians, relative to them; and their curvatures and sizes."""
        parts = [responses(*own, shift) for own in self._each(iterate, assembled)]
        coupled, places = assembled.coupled, self._places(parts)
        solved = solve_border(parts, places, coupled, self._sizes(places))
        p, counts = len(places[0]), [phase.measured.nodes.shape[1] for phase in self.phases]
        moves = np.zeros((len(shift), coupled.jacobian.shape[2]))
        moves[:, np.concatenate(places)] = solved.moves
        starts = np.split(solved.moves[:, :p], np.cumsum([len(part.free[0]) for part in parts])[:-1], 1)
        ends = np.split(solved.moves[:, p:], np.cumsum([len(part.free[1]) for part in parts])[:-1], 1)
        forces = np.split(solved.forces, np.cumsum(counts)[:-1], 1)
        steps, curved, sizes = [], np.einsum("bz,bzy,by->b", moves, coupled.curvature, moves), np.zeros(len(shift))
        for k, (phase, part) in enumerate(zip(self.phases, parts, strict=True)):
            step = self._step(part, starts[k], forces[k], ends[k])
            curvature, size = self._curved(phase, assembled.parts[k], step, shift)
            curved, sizes = curved + curvature, sizes + size
            steps.append(phase.completed(iterate.parts[k], assembled.parts[k], step))
        step = self._joined(steps, moves, solved, parts, sum(counts) + coupled.values.shape[1])
        return step, curved / self.measured.cost, sizes

    def least_step(self, iterate: JointIterate, assembled: JointAssembled) -> JointStep:
        """The least steps that the linearised constraints ask for, whatever these cost."""
        return self.eliminate(iterate, assembled, np.full(len(assembled.coupled.values), LEAST))[0]

    def _places(self, parts: list[Response]) -> tuple[np.ndarray, np.ndarray]:
        """Places of the free coordinates of all starts, and of all ends, among the coordinates of all of them."""
        begins = np.cumsum([0, *self.coupling.dimensions])
        both = ([begins[2 * k + side] + part.free[side] for k, part in enumerate(parts)] for side in (0, 1))
        starts, ends = (np.concatenate(own) for own in both)
        return starts, ends

    def _sizes(self, places: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Sizes of the unknowns of the border."""
        nodes = np.concatenate([phase.measured.nodes for phase in self.phases for _ in range(2)], axis=1)
        cost, forces = (
            self.measured.cost[:, None],
            np.concatenate([phase.measured.nodes for phase in self.phases], axis=1),
        )
        return np.concatenate([nodes[:, np.concatenate(places)], cost / forces, cost / self._rows], axis=1)

    @staticmethod
    def _step(part: Response, start: np.ndarray, force: np.ndarray, end: np.ndarray) -> Step:
        """The step of a phase whose ends move so."""
        columns = np.concatenate([np.ones((len(start), 1)), start, force], axis=1)
        steps = np.einsum("bkzj,bj->bkz", part.steps, columns)
        multipliers = np.einsum("bknj,bj->bkn", part.multipliers, columns)
        moved = np.array(part.wanted)
        moved[:, part.free[1]] = end
        multipliers[:, -1] = -(force + part.weight * moved)
        finite = np.all(np.isfinite(steps), axis=(1, 2)) & np.all(np.isfinite(multipliers), axis=(1, 2))
        return Step(steps, multipliers, np.abs(steps).max(axis=1), finite, finite, finite)

    @staticmethod
    def _curved(
        phase: Conditions, assembled: Assembled, step: Step, shift: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The curvature along the step of a phase, with the shift, and its size."""
        d, units = step.unknowns, phase.measured
        size = np.sum((d / units.unknowns[:, None]) ** 2, axis=(1, 2))
        upper = np.triu(assembled.blocks.hessian)
        whole = upper + np.triu(assembled.blocks.hessian, 1).mT
        return np.einsum("bkz,bkzy,bky->b", d, whole, d) + shift * size * units.cost, size

    def _joined(
        self, steps: list[Step], moves: np.ndarray, solved: Solved, parts: list[Response], equations: int
    ) -> JointStep:
        """The steps of all phases, with one share that all may go; ``equations`` of the border."""
        reach, followed = (
            np.min([np.broadcast_to(own, len(moves)) for own in each], axis=0)
            for each in ([step.reach for step in steps], [step.followed for step in steps])
        )
        same = (step.within(reach) for step in steps)
        counts = [step.multipliers[0].size for step in steps]
        convex, clear = _convex(solved, parts, sum(counts), equations)
        finite = np.all([step.finite for step in steps], axis=0) & np.all(np.isfinite(solved.multipliers), axis=1)
        return JointStep(tuple(same), moves, solved.multipliers, convex & clear, convex, finite, reach, followed)

    def length(self, step: JointStep) -> np.ndarray:
        """The largest entry of a step in its unit, shape (B,)."""
        return np.max([phase.length(own) for phase, own in zip(self.phases, step.parts, strict=True)], axis=0)

    def wanted(
        self, iterate: JointIterate, assembled: JointAssembled, step: JointStep
    ) -> tuple[np.ndarray, np.ndarray]:
        """The steps that the linearised conditions still ask for; and how far the trajectories go, in their units."""
        both = zip(self._each(iterate, assembled), step.parts, strict=True)
        wanted, grown = np.max([phase.wanted(part, system, turn) for (phase, part, system), turn in both], axis=0)
        return wanted, grown

    def is_isolated_minimum(self, iterate: JointIterate, assembled: JointAssembled) -> np.ndarray:
        """Whether the Hessian of the Lagrangian is positive definite on the null space of all constraints, beyond
        rounding."""
        parts = [responses(*own, None) for own in self._each(iterate, assembled)]
        places = self._places(parts)
        solved = solve_border(parts, places, assembled.coupled, self._sizes(places))
        counts = [part.multipliers[0, :, :, 0].size for part in parts]
        equations = sum(part.end.shape[1] for part in parts) + assembled.coupled.values.shape[1]
        convex, clear = _convex(solved, parts, sum(counts), equations)
        return convex & clear


extend(LinkedPhases, JointConditions)


def _convex(solved: Solved, parts: list[Response], count: int, equations: int) -> tuple[np.ndarray, np.ndarray]:
    """Whether the inertia is that of a minimum, by constraints so many in the phases and in the border; whether it is
    clear."""
    negative = solved.negative + np.sum([part.negative for part in parts], axis=0)
    smallest = np.min([solved.smallest, *(part.smallest for part in parts)], axis=0)
    return negative == count + equations, smallest > EPS**REGULAR * max(1.0, count / MANY)
