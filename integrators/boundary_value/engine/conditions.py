"""The conditions of a discrete extremal: ends meet, the cost is stationary; in units of the trajectory itself."""

from typing import Any, NamedTuple, final

import numpy as np

from . import inequalities as bounds
from .elimination import BlockSystem, eliminate, is_strict_minimum
from .inequalities import Slacks, Turn
from .scaling import SHARE, Units, natural_units, unscaled
from .transcription import Blocks, Data, Moves, Nodes, Terminal

FAR = 1e-2  # times the largest entry of the nodes: ends further apart meet along an arc
VALUE = 1e-2  # of its value, which is rounded, an entry is measured by where it moves less than that


class Iterate(NamedTuple):
    """Unknowns of the steps, and covectors at the nodes, shape (B, N + 1, E)."""

    unknowns: Any
    costates: np.ndarray
    slacks: Slacks | None = None  # of the inequalities, if there are any


class Assembled(NamedTuple):
    """The KKT system at an iterate, in the units of the problem, and what tells how far the iterate is from satisfying it."""

    blocks: Blocks
    gap: np.ndarray  # what the nodes lack in the frames there, shape (B, N + 1, n)
    asked: np.ndarray  # what a step is asked to move by in the coordinates of the frames, which see it foreshortened
    frames: np.ndarray  # (B, N + 1, n, E)
    coordinates: np.ndarray  # multipliers in the frames, (B, N + 1, n)
    nodes: np.ndarray  # (B, N + 1, E)
    costates: np.ndarray
    terminal: Terminal
    cost: np.ndarray
    initial: Terminal | None
    distance: np.ndarray  # largest distance between ends that should meet, entry by entry, shape (B, E)


class Step(NamedTuple):
    """A step of the unknowns and of the multipliers, and what its elimination tells of the system."""

    unknowns: np.ndarray
    multipliers: np.ndarray
    strict: np.ndarray  # positive definite on the null space of the constraints, beyond rounding
    convex: np.ndarray  # the inertia is that of one that is
    finite: np.ndarray
    inner: Any = None  # of what was condensed
    turn: Turn | None = None  # of the slacks

    @property
    def reach(self) -> np.ndarray | float:
        """The share of the step that the inequalities let it go."""
        return 1.0 if self.turn is None else self.turn.reach


class Residuals(NamedTuple):
    """Largest distance between ends that should meet and derivative of the Lagrangian, relative to what they are made of."""

    gap: np.ndarray
    stationarity: np.ndarray
    violation: np.ndarray  # of the inequalities with their slacks and excesses
    excess: np.ndarray  # the largest
    complementarity: np.ndarray  # largest product of slack and multiplier
    centring: np.ndarray  # largest difference of it from the barrier

    @property
    def final(self) -> np.ndarray:
        """The largest residual of the problem itself."""
        worst = np.maximum(self.excess, np.maximum(self.violation, self.complementarity))
        return np.maximum(np.maximum(self.gap, self.stationarity), worst)

    @property
    def largest(self) -> np.ndarray:
        """The largest residual of the problem with its barrier."""
        return np.maximum(np.maximum(self.gap, self.stationarity), np.maximum(self.violation, self.centring))


class Ends(NamedTuple):
    """Flat points at the ends, shape (B, E), and which of their entries and coordinates are prescribed."""

    start: np.ndarray
    end: np.ndarray
    start_entries: np.ndarray
    end_entries: np.ndarray
    start_coordinates: np.ndarray
    end_coordinates: np.ndarray


class _Sizes(NamedTuple):
    """Extent of a trajectory: the spread of its nodes and the sizes of its controls."""

    values: np.ndarray  # largest value of each ambient entry of a node, (B, E)
    spreads: np.ndarray
    support: np.ndarray  # largest entries of the frames at the nodes, (B, n, E)
    controls: np.ndarray  # (B, s m)

    def along(self, entries: np.ndarray) -> np.ndarray:
        """Sizes in the coordinates of the nodes from sizes in the entries."""
        return np.max(self.support * entries[:, None], axis=2, initial=0.0)


@final
class Conditions:
    """The conditions of a batch of trajectories.

    ``units``, and ``limits``, the units of inequalities, shape (B, c), are those of the iterates that it began with.
    """

    def __init__(
        self,
        transcription: Any,
        nodes: Nodes,
        ends: Ends,
        data: Data,
        units: Units | None = None,
        limits: np.ndarray | None = None,
    ) -> None:
        self.transcription, self.at_nodes, self.ends, self.data = transcription, nodes, ends, data
        self.units, self.limits = units, limits

    def of(self, members: np.ndarray) -> "Conditions":
        """The conditions of some members."""
        if len(members) == len(self.data.steps):
            return self
        ends = Ends(self.ends.start[members], self.ends.end[members], *self.ends[2:])
        data, units = Data(*_some(self.data, members)), self.units and Units(*_some(self.units, members))
        return Conditions(self.transcription, self.at_nodes, ends, data, units, *_some([self.limits], members))

    @property
    def measured(self) -> Units:
        """The units, once they are measured."""
        if self.units is None:
            raise RuntimeError("the conditions have no units yet; call begin with a guess")
        return self.units

    def assemble(self, iterate: Iterate) -> Assembled:
        """The KKT system at an iterate."""
        begins, finishes = self.transcription.ends(iterate.unknowns, self.data)
        nodes, gaps, arcs, shares = self._nodes(begins, finishes)
        frames = self.at_nodes.frames(nodes)
        gap, asked = (np.einsum("bkne,bke->bkn", frames, gaps * factor) for factor in (arcs, shares))
        terminal = self.at_nodes.terminal(nodes[:, -1], self.data.parameters)
        coordinates = np.einsum("bkne,bke->bkn", frames, iterate.costates)
        coordinates[:, -1] += terminal.slope
        initial = self.at_nodes.initial(nodes[:, 0], self.data.parameters)
        if initial is not None:
            coordinates[:, 0] -= initial.slope
        for values in (gap, asked, coordinates):
            values[:, 0] *= self.ends.start_coordinates
            values[:, -1] *= self.ends.end_coordinates
        costates = np.einsum("bkne,bkn->bke", frames, coordinates)
        costates[:, -1] -= terminal.derivative
        if initial is not None:
            costates[:, 0] += initial.derivative
        blocks = self.transcription.blocks(iterate.unknowns, nodes, costates, self.data, iterate.slacks)
        for place, paid, end in ((-1, terminal, blocks.right[:, -1]), (0, initial, blocks.left[:, 0])):
            if paid is not None:
                _pay(blocks, place, paid, end)
        cost = np.sum(blocks.costs, axis=1) + terminal.value + (0.0 if initial is None else initial.value)
        distance = np.max(np.abs(gaps), axis=1)
        return Assembled(blocks, gap, asked, frames, coordinates, nodes, costates, terminal, cost, initial, distance)

    def move(self, iterate: Iterate, assembled: Assembled, step: Step, fraction: np.ndarray) -> Iterate:
        """The iterate moved by fractions of the share of the steps that the inequalities let it go."""
        part = fraction * step.reach
        multipliers = self._of_nodes(assembled, step)
        moves = Moves(step.unknowns, multipliers, part, step.inner)
        unknowns = self.transcription.move(iterate.unknowns, assembled.blocks, moves, self.data)
        covectors = assembled.coordinates + part[:, None, None] * multipliers
        costates = np.einsum("bkne,bkn->bke", assembled.frames, covectors)
        costates[:, -1] -= assembled.terminal.derivative
        if assembled.initial is not None:
            costates[:, 0] += assembled.initial.derivative
        slacks = iterate.slacks
        if slacks is not None and step.turn is not None:
            slacks = bounds.moved(slacks, step.turn, fraction)
        return Iterate(unknowns, costates, slacks)

    def begin(self, guess: Iterate) -> tuple[Iterate, Assembled]:
        """The first iterate with its system; takes the units from it."""
        if not self.transcription.inequalities:
            assembled = self.assemble(guess)
            self.units = self._natural(guess, assembled)
            return guess, assembled
        shape = *self.data.steps.shape, self.transcription.stages, self.transcription.inequalities
        none = Slacks(np.ones(shape), np.zeros(shape), np.zeros(shape), np.full(shape, np.inf), np.zeros(shape[0]))
        first = guess._replace(slacks=none)
        assembled = self.assemble(first)
        self.units = self._natural(first, assembled)
        self.limits, held = self._limits(assembled), assembled.blocks.held
        inside = held.values < -bounds.INSIDE * self._units_of_limits
        price = np.where(inside, np.inf, bounds.PRICE * self._rate[:, None, None, None] / self._units_of_limits)
        elastic = np.any((held.weights > 0) & ~inside, axis=(1, 2, 3))
        barrier = np.where(elastic, np.maximum(bounds.FIRST, bounds.SHARE * bounds.PRICE), bounds.FIRST) * self._rate
        begun = guess._replace(slacks=bounds.central(held, barrier, price))
        return begun, self.assemble(begun)

    def _natural(self, iterate: Iterate, assembled: Assembled) -> Units:
        """Units from an iterate."""
        sizes, blocks = self._sizes(iterate, assembled), assembled.blocks
        controls = sizes.controls
        if blocks.held is not None:
            # Where the cost is not curved in the controls, the distances to their bounds measure them.
            n = assembled.gap.shape[2]
            curved = np.all(np.sum(np.abs(np.diagonal(blocks.hessian, axis1=2, axis2=3)), axis=1)[:, n:] > 0, axis=1)
            controls = np.where(curved[:, None], controls, np.maximum(controls, self._room(assembled)))
        fallback = np.concatenate([sizes.along(sizes.values), controls], axis=1)
        spreads = sizes.along(sizes.spreads)
        return natural_units(self._system(iterate, assembled), blocks.gradient, spreads, controls, fallback)

    def _room(self, assembled: Assembled) -> np.ndarray:
        """How far the controls can go before an inequality holds them, shape (B, s m)."""
        held, m = assembled.blocks.held, self.transcription.controls.dimension
        slopes = np.abs(held.jacobian[..., -m:]) * (held.weights > 0)[..., None] if m else np.zeros((*held.values.shape, 0))
        with np.errstate(all="ignore"):
            way = np.where(slopes > 0, np.abs(held.values)[..., None] / slopes, 0.0)
        way = np.max(way, axis=1)
        room = np.min(np.where(way > 0, way, np.inf), axis=2, initial=np.inf)
        return np.where(np.isfinite(room), room, 0.0).reshape(len(room), -1)

    def _limits(self, assembled: Assembled) -> np.ndarray:
        """Units of the inequalities: what the unknowns change them by, shape (B, c)."""
        slopes = np.abs(assembled.blocks.held.jacobian) * self.transcription.sizes(self.measured)[:, :, :, None]
        size = np.max(np.sum(slopes, axis=4), axis=(1, 2))
        return np.where((size > 0) & np.isfinite(size), size, 1.0)

    @property
    def _rate(self) -> np.ndarray:
        """The unit of the cost per unit of time."""
        return self.measured.cost / np.mean(self.data.steps, axis=1)

    def residuals(self, iterate: Iterate, assembled: Assembled) -> Residuals:
        """How far iterates are from satisfying the conditions."""
        gap, stationarity = self._gap(assembled, self._sizes(iterate, assembled)), self._stationarity(assembled)
        held, slacks = assembled.blocks.held, iterate.slacks
        if held is None or slacks is None:
            return Residuals(gap, stationarity, *np.zeros((4, len(gap))))
        asked = held.weights > 0
        values = np.max(np.where(asked, np.abs(held.values), 0.0), axis=(1, 2), keepdims=True)
        unit = np.maximum(self._units_of_limits, VALUE * values)
        parts = np.abs(held.missing(slacks)), slacks.excess
        missed = (np.max(np.where(asked, a / unit, 0.0), axis=(1, 2, 3), initial=0.0) for a in parts)
        largest, off = bounds.products(slacks, asked)
        return Residuals(gap, stationarity, *missed, largest / self._rate, off / self._rate)

    @property
    def _units_of_limits(self) -> np.ndarray:
        return np.ones(1) if self.limits is None else self.limits[:, None, None]

    def lowered(
        self, iterate: Iterate, assembled: Assembled, residuals: Residuals, tolerance: float
    ) -> tuple[Iterate, np.ndarray, np.ndarray]:
        """The iterate with a lower barrier where its problem is solved; where that is; and where excesses are too cheap.

        There the cost counts less instead: all multipliers grow with the price, and the system is to be assembled anew.
        """
        slacks, rate, held = iterate.slacks, self._rate, assembled.blocks.held
        none = np.zeros(len(rate), bool)
        if slacks is None or held is None:
            return iterate, none, none
        last, asked, begun, off = bounds.LAST * tolerance, held.weights > 0, slacks.barrier, residuals.centring
        cheap = bounds.is_cheap(slacks, rate[:, None, None, None] / self._units_of_limits)
        cheap &= self._is_solved(residuals, off, slacks.barrier / rate)
        while True:
            barrier = slacks.barrier / rate
            solved = self._is_solved(residuals, off, barrier) & (barrier > last) & ~cheap
            if not np.any(solved):
                break
            less = np.maximum(last, np.minimum(bounds.LESS * barrier, barrier**bounds.FASTER))
            slacks = slacks._replace(barrier=np.where(solved, less, barrier) * rate)
            off = bounds.products(slacks, asked)[1] / rate
        changed = slacks.barrier != begun
        iterate = iterate._replace(slacks=slacks)
        return (self._scaled(iterate, np.where(cheap, bounds.DEARER, 1.0)) if np.any(cheap) else iterate), changed, cheap

    def _is_solved(self, residuals: Residuals, off: np.ndarray, barrier: np.ndarray) -> np.ndarray:
        """Whether the problem with a barrier is solved to a few times that."""
        error = np.maximum(np.maximum(residuals.gap, residuals.stationarity), np.maximum(residuals.violation, off))
        return error <= bounds.SOLVED * barrier

    def _scaled(self, iterate: Iterate, factor: np.ndarray) -> Iterate:
        """The iterate of a problem whose cost counts less: all multipliers, prices and barriers times factors."""
        slacks, times = iterate.slacks, factor[:, None, None, None]
        scaled = times * slacks.multipliers, slacks.excess, times * slacks.price, factor * slacks.barrier
        slacks = Slacks(slacks.slacks, *scaled)
        unknowns = iterate.unknowns
        if hasattr(unknowns, "costates"):
            unknowns = unknowns._replace(costates=times * unknowns.costates)
        return Iterate(unknowns, factor[:, None, None] * iterate.costates, slacks)

    def softened(self, iterate: Iterate, assembled: Assembled, where: np.ndarray) -> Iterate:
        """The iterate with all inequalities elastic in some members."""
        slacks, held = iterate.slacks, assembled.blocks.held
        if slacks is None or held is None:
            return iterate
        price = bounds.PRICE * self._rate[:, None, None, None] / self._units_of_limits
        price = np.where(where[:, None, None, None], np.minimum(slacks.price, price), slacks.price)
        barrier = np.where(where, np.maximum(slacks.barrier, bounds.SHARE * bounds.PRICE * self._rate), slacks.barrier)
        fresh = bounds.central(held, barrier, price)
        kept = [np.where(where.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in zip(fresh, slacks, strict=True)]
        return iterate._replace(slacks=Slacks(*kept))

    def barrier(self, iterate: Iterate) -> np.ndarray:
        """The barrier relative to the unit of the cost rate, zero without inequalities."""
        return np.zeros(len(self.data.steps)) if iterate.slacks is None else iterate.slacks.barrier / self._rate

    def is_hard(self, iterate: Iterate, assembled: Assembled) -> np.ndarray:
        """Whether a member has inequalities that are not elastic."""
        held = assembled.blocks.held
        if held is None or iterate.slacks is None:
            return np.zeros(len(assembled.gap), bool)
        return np.any((held.weights > 0) & ~iterate.slacks.elastic, axis=(1, 2, 3))

    def infeasibility(self, iterate: Iterate, assembled: Assembled) -> np.ndarray:
        """Sum of what all nodes, points and inequalities lack."""
        blocks, missing = assembled.blocks, np.sum(np.abs(assembled.gap) / self.measured.nodes[:, None], axis=(1, 2))
        if blocks.inner is not None:
            missing = missing + np.sum(np.abs(blocks.inner.defect) / self.measured.nodes[:, None, None], axis=(1, 2, 3))
        if blocks.held is not None and iterate.slacks is not None:
            share = blocks.held.weights / np.mean(self.data.steps, axis=1)[:, None, None, None]
            off = share * np.abs(blocks.held.missing(iterate.slacks)) / self._units_of_limits
            missing = missing + np.sum(off, axis=(1, 2, 3))
        return missing

    def merit(self, iterate: Iterate, assembled: Assembled) -> tuple[np.ndarray, np.ndarray]:
        """The cost with its barrier, and the multipliers on what is lacking, in the unit of the cost."""
        blocks, held = assembled.blocks, np.sum(assembled.coordinates * assembled.gap, axis=(1, 2))
        cost = np.array(assembled.cost)
        if blocks.inner is not None:
            held += np.sum(blocks.inner.multipliers * blocks.inner.defect, axis=(1, 2, 3))
        if blocks.held is not None and iterate.slacks is not None:
            slacks, weights = iterate.slacks, blocks.held.weights
            cost += bounds.potential(slacks, weights, self._units_of_limits)
            held += np.sum(weights * slacks.multipliers * blocks.held.missing(slacks), axis=(1, 2, 3))
        return cost / self.measured.cost, held / self.measured.cost

    def promise(self, iterate: Iterate, assembled: Assembled, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the cost and of the multipliers on what is lacking, to first order, by all that the step may go."""
        blocks = assembled.blocks
        ahead = np.sum(blocks.gradient * step.unknowns, axis=(1, 2))
        turned = np.sum(step.multipliers * assembled.gap, axis=(1, 2))
        inner = blocks.inner
        if inner is not None:
            ahead += np.sum(assembled.terminal.slope * inner.after[:, -1], axis=1)
            if assembled.initial is not None:
                ahead += np.sum(assembled.initial.slope * inner.before[:, 0], axis=1)
            velocities, multipliers = step.inner
            direct = inner.kept[2][..., : step.unknowns.shape[2]]
            within = np.einsum("bkiz,bkz->bki", direct, step.unknowns).reshape(velocities.shape)
            ahead += np.sum(inner.gradient * (velocities - within), axis=(1, 2, 3))
            turned += np.sum(multipliers * inner.defect, axis=(1, 2, 3))
        if blocks.held is not None and step.turn is not None and iterate.slacks is not None:
            slacks, weights = iterate.slacks, blocks.held.weights
            ahead += bounds.potential_slope(slacks, step.turn, weights)
            dual = step.turn.dual * np.sum(weights * step.turn.multipliers * blocks.held.missing(slacks), axis=(1, 2, 3))
            return step.reach * ahead / self.measured.cost, (step.reach * turned + dual) / self.measured.cost
        return ahead / self.measured.cost, turned / self.measured.cost

    def eliminate(self, iterate: Iterate, assembled: Assembled, shift: np.ndarray) -> tuple[Step, np.ndarray, np.ndarray]:
        """Newton's steps with a shift of the Hessians, relative to them; and their curvatures and sizes."""
        found = eliminate(self._system(iterate, assembled), self.measured, shift, self._scales(assembled))
        steps, multipliers = (columns[..., 0] for columns in unscaled(found, self.measured))
        finite = np.all(np.isfinite(steps), axis=(1, 2)) & np.all(np.isfinite(multipliers), axis=(1, 2))
        count = multipliers[0].size
        step = Step(steps, multipliers, is_strict_minimum(found, count), found.negative == count, finite)
        blocks = assembled.blocks
        if blocks.inner is not None or blocks.held is not None:
            moves = Moves(steps, self._of_nodes(assembled, step), np.ones(len(steps)))
            if blocks.inner is not None:
                moves = moves._replace(inner=self.transcription.whole(blocks, moves, self.data, iterate.slacks))
            turn = None
            if blocks.held is not None and iterate.slacks is not None:
                turn = bounds.turned(blocks.held, iterate.slacks, self.transcription.at_each(moves, self.data))
            step = step._replace(inner=moves.inner, turn=turn)
        return step, found.curvature, found.size

    def _scales(self, assembled: Assembled) -> np.ndarray:
        """Typical curvature of each coordinate in its unit, the unit of the shift; with a barrier that of all coordinates."""
        d = self.measured.unknowns
        if assembled.blocks.held is not None:
            return np.ones(d.shape)
        diagonal = np.max(np.abs(np.diagonal(assembled.blocks.hessian, axis1=2, axis2=3)), axis=1)
        diagonal = diagonal * d * d / self.measured.cost[:, None]
        floor = 1e-3 * np.max(diagonal, axis=1, keepdims=True)
        return np.where(floor > 0, np.maximum(diagonal, floor), 1.0)

    def _of_nodes(self, assembled: Assembled, step: Step) -> np.ndarray:
        """Steps of the covectors at the nodes: of the multipliers, and at the ends of the slopes of their costs, which move."""
        moved = np.einsum("bnz,bz->bn", assembled.blocks.right[:, -1], step.unknowns[:, -1])
        if assembled.blocks.inner is not None:
            moved += assembled.blocks.inner.after[:, -1]
        turned = np.array(step.multipliers)
        turned[:, -1] -= np.einsum("bnj,bj->bn", assembled.terminal.curvature, moved)
        if assembled.initial is not None:
            begun = np.einsum("bnz,bz->bn", assembled.blocks.left[:, 0], step.unknowns[:, 0])
            begun += 0.0 if assembled.blocks.inner is None else assembled.blocks.inner.before[:, 0]
            turned[:, 0] += np.einsum("bnj,bj->bn", assembled.initial.curvature, begun)
        return turned

    def wanted(self, iterate: Iterate, assembled: Assembled, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """The steps that the linearised conditions still ask for; and how far the trajectories go, in their units.

        The first is ``K^-1`` times the residual, rounding included: the error that remains, relative to the trajectory. Where K
        is singular to rounding, it is as large as that.
        """
        sizes, units = self._sizes(iterate, assembled), self.measured.unknowns
        own = np.concatenate([sizes.along(sizes.spreads + sizes.values), sizes.controls], axis=1)
        largest = np.max(np.abs(step.unknowns), axis=1) / np.maximum(own, SHARE * units)
        extent = np.concatenate([sizes.along(sizes.spreads), sizes.controls], axis=1)
        return np.max(largest, axis=1), np.max(extent / units, axis=1)

    def _nodes(self, begins: np.ndarray, finishes: np.ndarray) -> tuple[np.ndarray, ...]:
        """Nodes ``q_0 ... q_N`` and, at each, the beginning of the step after it minus the end of the one before.

        Between ends that are far apart the node is amid them: seen from one of them, an end beyond a quarter turn comes nearer
        by turning away. Then the gap along the arc is that along the chord times the third array, and moves it by the fourth.
        """
        first = np.where(self.ends.start_entries, self.ends.start, begins[:, 0])[:, None]
        last = np.where(self.ends.end_entries, self.ends.end, finishes[:, -1])[:, None]
        before, after = np.concatenate([first, finishes], axis=1), np.concatenate([begins, last], axis=1)
        nodes, gaps = np.concatenate([first, finishes[:, :-1], last], axis=1), after - before
        arcs, shares = np.ones_like(gaps), np.ones_like(gaps)
        far = np.max(np.abs(gaps), axis=2) > FAR * np.max(np.abs(nodes), axis=(1, 2), initial=0.0)[:, None]
        if np.any(far):
            nodes[far], arcs[far], shares[far] = self.at_nodes.amid(before[far], after[far])
        return nodes, gaps, arcs, shares

    def _system(self, iterate: Iterate, assembled: Assembled) -> BlockSystem:
        blocks, count = assembled.blocks, len(assembled.gap)
        fixed = (np.broadcast_to(m, (count, m.size)) for m in (self.ends.start_coordinates, self.ends.end_coordinates))
        gap, slope = assembled.asked, blocks.slope
        if blocks.pushed is not None and iterate.slacks is not None:
            slope = blocks.pushed[..., 0] + iterate.slacks.barrier[:, None, None] * blocks.pushed[..., 1]
        if blocks.inner is not None:
            gap = np.array(gap)
            gap[:, :-1] += blocks.inner.before
            gap[:, 1:] -= blocks.inner.after
        return BlockSystem(blocks.hessian, blocks.left, blocks.right, slope[..., None], gap[..., None], *fixed)

    def _sizes(self, iterate: Iterate, assembled: Assembled) -> _Sizes:
        nodes = assembled.nodes
        highest, lowest = np.max(nodes, axis=1), np.min(nodes, axis=1)
        support = np.max(np.abs(assembled.frames), axis=1)
        controls = self.at_nodes.control_sizes(iterate.unknowns.controls)
        return _Sizes(np.maximum(highest, -lowest), highest - lowest, support, controls)

    def _gap(self, assembled: Assembled, sizes: _Sizes) -> np.ndarray:
        """Largest distance between ends that should meet, entry by entry of the ambient space.

        An entry is measured by the spread of the trajectory in it, by a share of its value, or, where it rests, of its unit.
        """
        own = np.maximum(sizes.spreads, VALUE * sizes.values)
        along = np.maximum(sizes.along(own), SHARE * self.measured.nodes)
        entries = np.maximum(own, np.max(sizes.support * along[:, :, None], axis=1, initial=0.0))
        gap = np.max(assembled.distance / np.where(entries > 0, entries, 1.0), axis=1)
        inner = assembled.blocks.inner
        if inner is None:
            return gap
        missed = np.max(np.sum(np.abs(inner.defect), axis=2), axis=1) / np.where(along > 0, along, 1.0)
        return np.maximum(gap, np.max(missed, axis=1))

    def _stationarity(self, assembled: Assembled) -> np.ndarray:
        """Largest entry of the Lagrangian's derivative relative to the parts that cancel in it, coordinate by coordinate.

        Where all parts vanish, as the costates do at an optimum of the cost itself, its curvature in any coordinate sets the
        scale.
        """
        blocks, d = assembled.blocks, self.measured.unknowns
        starts = np.einsum("bknz,bkn->bkz", blocks.left, assembled.coordinates[:, :-1])
        ends = np.einsum("bknz,bkn->bkz", blocks.right, assembled.coordinates[:, 1:])
        parts = d * np.max(np.abs(blocks.gradient) + np.abs(starts) + np.abs(ends), axis=1)
        if blocks.held is None:
            curvature = np.max(d * d * np.max(np.abs(np.diagonal(blocks.hessian, axis1=2, axis2=3)), axis=1), axis=1)
        else:  # that of the barrier has no bound
            curvature = self.measured.cost
        largest = np.maximum(np.max(parts, axis=1), curvature)
        scale = np.maximum(parts, SHARE * largest[:, None])
        found = np.max(np.max(np.abs(blocks.slope), axis=1) * d / np.where(scale > 0, scale, 1.0), axis=1)
        inner = blocks.inner
        if inner is None:
            return found
        weights = self.data.steps[:, :, None, None] * self.transcription.tableau.weights[:, None]
        d = self.measured.nodes
        scale = np.maximum(d * np.max(np.abs(inner.multipliers), axis=(1, 2)), SHARE * largest[:, None])
        slopes = d * np.max(np.abs(inner.slope) / weights, axis=(1, 2))
        return np.maximum(found, np.max(slopes / np.where(scale > 0, scale, 1.0), axis=1))


def _pay(blocks: Blocks, place: int, paid: Terminal, end: np.ndarray) -> None:
    """Add the cost of an end to the blocks of the step there; ``end``: the derivative of that, shape (B, n, z)."""
    blocks.hessian[:, place] += end.mT @ paid.curvature @ end
    blocks.gradient[:, place] += np.einsum("bn,bnz->bz", paid.slope, end)
    if blocks.inner is not None:  # what the condensed velocities move the end by, the slope of its cost is moved with
        pushed = blocks.slope if blocks.pushed is None else blocks.pushed[..., 0]
        moved = blocks.inner.after[:, -1] if place else blocks.inner.before[:, 0]
        pushed[:, place] += np.einsum("bnz,bnj,bj->bz", end, paid.curvature, moved)


def _some(leaves: Any, members: np.ndarray) -> list[np.ndarray | None]:
    """Some members of arrays, where there are any."""
    return [None if leaf is None else leaf[members] for leaf in leaves]
