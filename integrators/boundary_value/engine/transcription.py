"""From the iterate of a discrete trajectory to the blocks of its KKT system, point functions evaluated all at once."""

from typing import Any, NamedTuple

import numpy as np

from ....compute.binding.problem_functions import FunctionName
from ..transcription.functions.linked_ends import EndCost as Terminal
from ..transcription.functions.nodes import NodeFunctions
from ..transcription.functions.one_stage import OneStageFunctions
from ..transcription.iterate import Data, Slacks, Unknowns
from .inequalities import Held, raised
from .scaling import Units

COSTS = FunctionName.START_COST, FunctionName.END_COST
QUARTER = np.pi / 2 - 1e-2  # a turn: opposite points still have a direction


def extend(functions: type, own: type) -> None:
    """Give the class of functions what the engine adds to it."""
    for name, value in vars(own).items():
        if name == "__init__" or not name.startswith("__"):
            setattr(functions, name, value)


def _of_core(name: FunctionName) -> Any:
    """The attribute of a function of the core."""
    return property(lambda self: self.functions.get(name))


class Blocks(NamedTuple):
    """The part of the KKT system that belongs to the steps; z unknowns of a step, the n of its centre first."""

    hessian: np.ndarray  # (B, N, z, z)
    left: np.ndarray  # (B, N, n, z): derivative of the beginning of a step in the frame of the node there
    right: np.ndarray  # (B, N, n, z): of its end
    slope: np.ndarray  # (B, N, z): of the Lagrangian
    gradient: np.ndarray  # (B, N, z): of the cost alone
    costs: np.ndarray  # (B, N)
    inner: Any = None  # what was condensed, if anything was
    held: Held | None = None  # the inequalities, if there are any; then the Hessian has their share
    # (B, N, z, 2): the slope with the share of the inequalities, the second times the barrier.
    pushed: np.ndarray | None = None

    @property
    def inequalities(self) -> Held:
        """The inequalities, where there are some."""
        if self.held is None:
            raise RuntimeError("there are no inequalities; assemble an iterate that has slacks")
        return self.held


class Moves(NamedTuple):
    """Steps of the unknowns (B, N, z) and of the nodes' multipliers (B, N + 1, n), and what fraction (B,) of them is
    made."""

    steps: np.ndarray
    multipliers: np.ndarray
    fraction: np.ndarray
    inner: Any = None  # the steps of what was condensed


Paid = tuple[Terminal | None, Terminal | None]  # what the first and the last node cost, if anything


def is_kept(known: tuple[int, Any], count: int) -> bool:
    """Whether what is known is the pass for so many steps, or that there is none, and its tapes are as they are now."""
    return known[0] == count and (known[1] is None or known[1].is_current)


class OneStage(OneStageFunctions):  # pyright: ignore[reportGeneralTypeIssues]
    """The steps of a discretization map: unknowns ``(x, u)``, tangent vector ``h X(x, u)``.

    The inequalities of a step are those at its point, then those at nodes, at its end and at its beginning.
    """

    _trial: tuple[int, Any] | None = None
    _ends, _row, _move = map(_of_core, (FunctionName.ENDS, FunctionName.POINTS, FunctionName.MOVE))

    def trial(self, nodes: "Nodes", count: int) -> Any:
        """The compiled pass of a trial of one trajectory of so many steps, if there is one; the last one is kept."""
        known = self._trial
        if known is None or not is_kept(known, count):
            from .one_stage_trial import OneStageTrial

            known = self._trial = count, OneStageTrial.of(self, nodes, count)
        return known[1]

    def blocks(
        self, unknowns: Unknowns, nodes: np.ndarray, costates: np.ndarray, data: Data, slacks: Slacks | None = None
    ) -> Blocks:
        """The blocks at an iterate with these states and covectors at the nodes, shape (B, N + 1, E)."""
        around = nodes[:, :-1], nodes[:, 1:], costates[:, :-1], costates[:, 1:]
        pull = np.zeros((*data.steps.shape, self.inequalities)) if slacks is None else slacks.multipliers[:, :, 0]
        found = self._row.at(2, unknowns.centres, unknowns.controls[:, :, 0], *around, *_given(data), pull)
        hessian, slope, left, right, gradient, pushes, _, _, cost, limits = found
        blocks = Blocks(hessian, left, right, slope, gradient[:, :, 0], cost[:, :, 0])
        if slacks is None:
            return blocks
        held = Held(limits[:, :, None], pushes[:, :, None], self.weights(data))
        pushed = raised(hessian[:, :, None], slope[:, :, None], held, slacks)
        return blocks._replace(held=held, pushed=pushed[:, :, 0])

    def scaled(self, unknowns: Unknowns, factor: np.ndarray) -> Unknowns:
        """The unknowns with all costates among them times factors: there are none."""
        del factor
        return unknowns

    def at_each(self, moves: Moves, data: Data) -> np.ndarray:
        """The steps of the unknowns of each point, shape (B, N, 1, z)."""
        del data
        return moves.steps[:, :, None]

    def sizes(self, units: Units) -> np.ndarray:
        """Units of the unknowns of each point, shape (B, 1, 1, z)."""
        return units.unknowns[:, None, None]

    def limits(self, blocks: Blocks, steps: np.ndarray) -> np.ndarray:
        """Derivatives of the inequalities in the unknowns of the steps, shape (B, N, c, z)."""
        del steps
        return blocks.inequalities.jacobian[:, :, 0]

    def move(self, unknowns: Unknowns, blocks: Blocks, step: Moves, data: Data) -> Unknowns:
        """The unknowns moved by fractions of steps in their charts."""
        del blocks
        steps, part = step.steps, step.fraction
        some = part[:, None, None] * steps
        x, u = self._move.at(2, unknowns.centres, unknowns.controls[:, :, 0], some, *_given(data))
        return Unknowns(x, u[:, :, None])


def _given(data: Data) -> tuple[np.ndarray, np.ndarray]:
    return data.steps[:, :, None], data.parameters[:, None]


class Nodes(NodeFunctions):  # pyright: ignore[reportGeneralTypeIssues]
    """What belongs to the nodes: frames, the terminal cost at the last, and the initial cost at the first."""

    _in_frame, _middle = map(_of_core, (FunctionName.FRAMES, FunctionName.MIDDLE))
    _directions = _of_core(FunctionName.CONTROL_FRAMES)

    def paid(self, first: np.ndarray, last: np.ndarray, parameters: np.ndarray) -> Paid:
        """The initial cost at first nodes and the terminal cost at last nodes, shape (B, E), where there are such."""
        costs = (self.functions.get(name) for name in COSTS)
        ends = zip(costs, (first, last), strict=True)
        first_cost, final_cost = (cost and Terminal(*cost.at(1, end, parameters)) for cost, end in ends)
        return first_cost, final_cost

    @property
    def pays(self) -> bool:
        """Whether an end costs something."""
        return any(name in self.functions for name in COSTS)

    def control_sizes(self, controls: np.ndarray) -> np.ndarray:
        """Largest sizes of the controls in their coordinates, shape (B, s m), from flat controls of shape (B, N, s,
        U)."""
        largest = np.max(np.abs(controls), axis=1)
        if self._directions is not None:
            directions = np.max(np.abs(self._directions.at(3, controls)[0]), axis=1)
            largest = np.max(directions * largest[:, :, None], axis=-1, initial=0.0)
        return largest.reshape(len(largest), -1)

    def control_support(self, controls: np.ndarray) -> np.ndarray | None:
        """Largest entries of the frames at the controls, shape (B, m, U), unless their space is flat."""
        if self._directions is None:
            return None
        return np.max(np.abs(self._directions.at(3, controls)[0]), axis=(1, 2))

    def amid(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points amid pairs of points, shape (K, E); arcs over chords, and what these promise over the chords, entry by
        entry.

        Each column of a point is taken to run along a circle: with the half chord s and the sagitta c between its ends,
        tan(angle / 4) = c / s. A tangent vector at the middle moves the chord by the cosine of angle / 2.
        """
        middle, columns = self._middle.of_any(1, first, second)[0], self.layout.in_columns
        found = np.where(np.all(np.isfinite(middle), axis=1, keepdims=True), middle, first)
        sagitta, half = (np.sqrt(a**2 @ columns.T) for a in ((first + second) / 2 - found, (second - first) / 2))
        angle = np.where(half > 0, 2 * np.arctan2(sagitta, np.where(half > 0, half, 1.0)), 0.0)  # of half the arc
        angle = np.minimum(angle, QUARTER)
        arcs = np.where(angle > 0, angle / np.sin(np.where(angle > 0, angle, 1.0)), 1.0)
        return found, arcs @ columns, (arcs * np.cos(angle)) @ columns


extend(OneStageFunctions, OneStage)
extend(NodeFunctions, Nodes)
