"""The conditions of a discrete extremal: ends meet, the cost is stationary; in units of the trajectory itself."""

from typing import Any, NamedTuple, final

import numpy as np

from .elimination import BlockSystem, eliminate, is_strict_minimum
from .scaling import SHARE, Units, natural_units, unscaled
from .transcription import Blocks, Data, Moves, Nodes, Terminal

VALUE = 1e-2  # of its value, which is rounded, an entry is measured by where it moves less than that


class Iterate(NamedTuple):
    """Unknowns of the steps, and covectors at the nodes, shape (B, N + 1, E)."""

    unknowns: Any
    costates: np.ndarray


class Assembled(NamedTuple):
    """The KKT system at an iterate, in the units of the problem, and what tells how far the iterate is from satisfying it."""

    blocks: Blocks
    gap: np.ndarray  # what the nodes lack in the frames there, shape (B, N + 1, n)
    frames: np.ndarray  # (B, N + 1, n, E)
    coordinates: np.ndarray  # multipliers in the frames, (B, N + 1, n)
    nodes: np.ndarray  # (B, N + 1, E)
    costates: np.ndarray
    terminal: Terminal
    cost: np.ndarray
    distance: np.ndarray  # largest distance between ends that should meet, entry by entry, shape (B, E)


class Step(NamedTuple):
    """A step of the unknowns and of the multipliers, and what its elimination tells of the system."""

    unknowns: np.ndarray
    multipliers: np.ndarray
    strict: np.ndarray  # positive definite on the null space of the constraints
    finite: np.ndarray


class Residuals(NamedTuple):
    """Largest distance between ends that should meet and derivative of the Lagrangian, relative to what they are made of."""

    gap: np.ndarray
    stationarity: np.ndarray

    @property
    def largest(self) -> np.ndarray:
        """The larger of both."""
        return np.maximum(self.gap, self.stationarity)


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
    """The conditions of a batch of trajectories; ``units`` are those of the first iterates that are measured."""

    def __init__(self, transcription: Any, nodes: Nodes, ends: Ends, data: Data, units: Units | None = None) -> None:
        self.transcription, self.at_nodes, self.ends, self.data, self.units = transcription, nodes, ends, data, units

    def of(self, members: np.ndarray) -> "Conditions":
        """The conditions of some members."""
        if len(members) == len(self.data.steps):
            return self
        ends = Ends(self.ends.start[members], self.ends.end[members], *self.ends[2:])
        data = Data(*(leaf[members] for leaf in self.data))
        units = None if self.units is None else Units(*(leaf[members] for leaf in self.units))
        return Conditions(self.transcription, self.at_nodes, ends, data, units)

    @property
    def measured(self) -> Units:
        """The units, once they are measured."""
        if self.units is None:
            raise RuntimeError("the conditions have no units yet; call measure with the first iterates")
        return self.units

    def assemble(self, iterate: Iterate) -> Assembled:
        """The KKT system at an iterate."""
        begins, finishes = self.transcription.ends(iterate.unknowns, self.data)
        nodes, gaps = self._nodes(begins, finishes)
        frames = self.at_nodes.frames(nodes)
        gap = np.einsum("bkne,bke->bkn", frames, gaps)
        terminal = self.at_nodes.terminal(nodes[:, -1], self.data.parameters)
        coordinates = np.einsum("bkne,bke->bkn", frames, iterate.costates)
        coordinates[:, -1] += terminal.slope
        for values in (gap, coordinates):
            values[:, 0] *= self.ends.start_coordinates
            values[:, -1] *= self.ends.end_coordinates
        costates = np.einsum("bkne,bkn->bke", frames, coordinates)
        costates[:, -1] -= terminal.derivative
        blocks = self.transcription.blocks(iterate.unknowns, nodes, costates, self.data)
        last = blocks.right[:, -1]
        blocks.hessian[:, -1] += last.mT @ terminal.curvature @ last
        blocks.gradient[:, -1] += np.einsum("bn,bnz->bz", terminal.slope, last)
        if blocks.inner is not None:  # what the condensed velocities move the end by, the terminal cost's slope is moved with
            blocks.slope[:, -1] += np.einsum("bnz,bnj,bj->bz", last, terminal.curvature, blocks.inner.after[:, -1])
        cost = np.sum(blocks.costs, axis=1) + terminal.value
        distance = np.max(np.abs(gaps), axis=1)
        return Assembled(blocks, gap, frames, coordinates, nodes, costates, terminal, cost, distance)

    def move(self, iterate: Iterate, assembled: Assembled, step: Step, fraction: np.ndarray) -> Iterate:
        """The iterate moved by fractions of steps."""
        part = fraction[:, None, None]
        multipliers = self._of_nodes(assembled, step)
        moves = Moves(step.unknowns, multipliers, fraction)
        unknowns = self.transcription.move(iterate.unknowns, assembled.blocks, moves, self.data)
        costates = np.einsum("bkne,bkn->bke", assembled.frames, assembled.coordinates + part * multipliers)
        costates[:, -1] -= assembled.terminal.derivative
        return Iterate(unknowns, costates)

    def measure(self, iterate: Iterate, assembled: Assembled) -> None:
        """Take the units from these iterates."""
        sizes = self._sizes(iterate, assembled)
        self.units = natural_units(self._system(assembled), assembled.blocks.gradient, sizes.along(sizes.spreads), sizes.controls)

    def residuals(self, iterate: Iterate, assembled: Assembled) -> Residuals:
        """How far iterates are from satisfying the conditions."""
        return Residuals(self._gap(assembled, self._sizes(iterate, assembled)), self._stationarity(assembled))

    def infeasibility(self, assembled: Assembled) -> np.ndarray:
        """Sum of what all nodes lack."""
        inner, missing = assembled.blocks.inner, np.sum(np.abs(assembled.gap) / self.measured.nodes[:, None], axis=(1, 2))
        if inner is None:
            return missing
        return missing + np.sum(np.abs(inner.defect) / self.measured.nodes[:, None, None], axis=(1, 2, 3))

    def held(self, assembled: Assembled) -> np.ndarray:
        """The multipliers on the gap."""
        inner, held = assembled.blocks.inner, np.sum(assembled.coordinates * assembled.gap, axis=(1, 2))
        if inner is not None:
            held += np.sum(inner.multipliers * inner.defect, axis=(1, 2, 3))
        return held / self.measured.cost

    def relative_cost(self, assembled: Assembled) -> np.ndarray:
        """The cost in its unit."""
        return assembled.cost / self.measured.cost

    def promise(self, assembled: Assembled, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the cost and of the multipliers on the gap, to first order, by whole steps."""
        ahead = np.sum(assembled.blocks.gradient * step.unknowns, axis=(1, 2))
        turned = np.sum(step.multipliers * assembled.gap, axis=(1, 2))
        inner = assembled.blocks.inner
        if inner is not None:
            ahead += np.sum(assembled.terminal.slope * inner.after[:, -1], axis=1)
            moved = step.unknowns, self._of_nodes(assembled, step)
            velocities, multipliers = self.transcription.whole(assembled.blocks, *moved, self.data)
            direct = inner.kept[2][..., : step.unknowns.shape[2]]
            within = np.einsum("bkiz,bkz->bki", direct, step.unknowns).reshape(velocities.shape)
            ahead += np.sum(inner.gradient * (velocities - within), axis=(1, 2, 3))
            turned += np.sum(multipliers * inner.defect, axis=(1, 2, 3))
        return ahead / self.measured.cost, turned / self.measured.cost

    def eliminate(self, assembled: Assembled, shift: np.ndarray) -> tuple[Step, np.ndarray, np.ndarray]:
        """Newton's steps with a shift of the Hessians, relative to them; and their curvatures and sizes."""
        d = self.measured.unknowns
        diagonal = np.max(np.abs(np.diagonal(assembled.blocks.hessian, axis1=2, axis2=3)), axis=1)
        diagonal = diagonal * d * d / self.measured.cost[:, None]  # typical curvature of each coordinate, the unit of the shift
        floor = 1e-3 * np.max(diagonal, axis=1, keepdims=True)
        scales = np.where(floor > 0, np.maximum(diagonal, floor), 1.0)
        found = eliminate(self._system(assembled), self.measured, shift, scales)
        steps, multipliers = (columns[..., 0] for columns in unscaled(found, self.measured))
        finite = np.all(np.isfinite(steps), axis=(1, 2)) & np.all(np.isfinite(multipliers), axis=(1, 2))
        strict = is_strict_minimum(found, multipliers[0].size)
        return Step(steps, multipliers, strict, finite), found.curvature, found.size

    def _of_nodes(self, assembled: Assembled, step: Step) -> np.ndarray:
        """Steps of the covectors at the nodes: of the multipliers, and at the last of the terminal cost's slope, which moves."""
        moved = np.einsum("bnz,bz->bn", assembled.blocks.right[:, -1], step.unknowns[:, -1])
        if assembled.blocks.inner is not None:
            moved += assembled.blocks.inner.after[:, -1]
        turned = np.array(step.multipliers)
        turned[:, -1] -= np.einsum("bnj,bj->bn", assembled.terminal.curvature, moved)
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

    def _nodes(self, begins: np.ndarray, finishes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes ``q_0 ... q_N`` and, at each, the beginning of the step after it minus the end of the one before."""
        first = np.where(self.ends.start_entries, self.ends.start, begins[:, 0])[:, None]
        last = np.where(self.ends.end_entries, self.ends.end, finishes[:, -1])[:, None]
        before = np.concatenate([first, finishes], axis=1)
        nodes = np.concatenate([first, finishes[:, :-1], last], axis=1)
        return nodes, np.concatenate([begins, last], axis=1) - before

    def _system(self, assembled: Assembled) -> BlockSystem:
        blocks, count = assembled.blocks, len(assembled.gap)
        fixed = (np.broadcast_to(m, (count, m.size)) for m in (self.ends.start_coordinates, self.ends.end_coordinates))
        gap = assembled.gap
        if blocks.inner is not None:
            gap = np.array(gap)
            gap[:, :-1] += blocks.inner.before
            gap[:, 1:] -= blocks.inner.after
        rows = blocks.slope[..., None], gap[..., None]
        return BlockSystem(blocks.hessian, blocks.left, blocks.right, *rows, *fixed)

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
        curvature = d * d * np.max(np.abs(np.diagonal(blocks.hessian, axis1=2, axis2=3)), axis=1)
        largest = np.maximum(np.max(parts, axis=1), np.max(curvature, axis=1))
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
