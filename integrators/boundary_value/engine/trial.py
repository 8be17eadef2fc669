"""A trial of Newton's method on one trajectory in one compiled pass: what ``move``, ``assemble`` and ``appraised``
find.

Each of these is a few kernels and many small operations of NumPy, which for one trajectory of some hundred steps take
longer than the kernels. In batches they take next to nothing of each.
"""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Self, final

import numpy as np

from ....aligned import LINE, scratch
from ...evaluator import Evaluated, Placed
from .arrays import plain
from .barrier import PRICES, Barrier
from .extent import OF_POINTS, Extent
from .inequalities import KEPT, VALUE, Held, Slacks, Surveyed
from .kkt_system import Assembled, Iterate, Step
from .meeting import FAR
from .residuals import NUMBERS, SHARES, Appraisal
from .transcription import Blocks, Nodes, OneStage, Unknowns

if TYPE_CHECKING:
    from .conditions import Conditions

Shapes = dict[str, tuple[int, ...]]
# What the kernel writes, in the order of ``trial_kernels.OUT``; where there is a dot, with an axis for its one point.
OUT = (
    *("begins", "finishes", "work", "covectors", "frames", "gap", "coordinates", "costates"),
    *("nodes", "gaps", "apart", "largest", "hessian", "left", "right", "slopes", "gradient"),
    *("hessian.", "slopes.", "limits", "pushes", "costs", "cost", *Extent._fields),
    *("along", "entries", "numbers", "surveyed", "s", "nu", "t", "pushed", "sums", "points", "zeros"),
)


class Setting(NamedTuple):
    """What stays the same in the trials of one trajectory."""

    trial: "Trial"
    data: tuple[np.ndarray, np.ndarray]  # lengths of the steps, and parameters
    weights: np.ndarray  # of the inequalities
    ends: tuple[Any, ...]  # what belongs to the nodes, as the kernel takes it

    @classmethod
    def of(cls, conditions: "Conditions") -> Self | None:
        """Those of one trajectory with the costs of no ends whose functions are tapes."""
        steps, nodes, data = conditions.transcription, conditions.at_nodes, conditions.data
        batch, count = data.steps.shape
        trial = steps.trial(nodes, count) if batch == 1 and not nodes.pays else None
        if trial is None:
            return None
        ends = conditions.fixed.ravel(), conditions.both_ends, nodes.layout.columns, conditions.mean_step, FAR
        return cls(trial, (np.array(data.steps[0]), np.array(data.parameters[0])), steps.weights(data), ends)


class Tried(NamedTuple):
    """The iterate where a step leads, its system, how it is judged, and the survey of its inequalities."""

    iterate: Iterate
    assembled: Assembled
    appraisal: Appraisal
    surveyed: np.ndarray


@final
class Trial:
    """The pass for one trajectory of so many steps."""

    def __init__(self, programs: list[Placed], shapes: Shapes) -> None:
        from . import trial_kernels

        self._run, self._addresses, self._limited = trial_kernels.trial, trial_kernels.addresses, shapes["room"][0] > 0
        arrays = zip(*((*own.code, own.sources, own.targets) for own in programs), strict=True)
        table, self._memory = _table(programs)
        self._programs = *map(np.concatenate, arrays), table
        self._fields = list(shapes)
        self._structure = np.dtype([(name, float, shape) for name, shape in shapes.items()])
        self._places = _places(shapes)
        self._none = np.zeros((1, 0, 1, 0)), np.zeros(1), np.zeros((1, 0))

    @classmethod
    def of(cls, steps: OneStage, nodes: Nodes, count: int) -> Self | None:
        """That of a discretization map; None where its functions do not run as tapes, or threads share them."""
        found = [function.placed(2, given) for function, given in _functions(steps, nodes, count)]
        programs = [program for program in found if program is not None]
        return cls(programs, _shapes(steps, count)) if len(programs) == len(found) else None

    def __call__(
        self, setting: Setting, conditions: "Conditions", before: tuple[Iterate, Assembled, Step], part: np.ndarray
    ) -> Tried | None:
        """The trial of a part of a step; None where ends of steps are far apart, which takes more than this."""
        (iterate, assembled, step), x = before, before[0].unknowns
        numbers = np.empty(self._structure.itemsize // 8)
        structure = np.ndarray((), self._structure, numbers)
        v = {name: structure[name] for name in self._fields}
        unknowns = np.concatenate((x.centres.ravel(), x.controls.ravel()))
        own = unknowns, assembled.coordinates, assembled.frames, step.unknowns, step.multipliers, part
        limits = self._limits(v, iterate.slacks, step, conditions.barrier, (part, setting.weights))
        tapes = *self._programs, *scratch(((self._memory,),)), numbers
        given = own, setting.data, setting.ends, (_units(conditions), SHARES), limits
        if not self._run(self._addresses(self._limited), tapes, *given, self._places):
            return None
        return _tried(v, iterate.slacks, setting.weights)

    def _limits(
        self,
        v: dict[str, np.ndarray],
        slacks: Slacks | None,
        step: Step,
        barrier: Barrier | None,
        own: tuple[np.ndarray, np.ndarray],
    ) -> tuple[Any, ...]:
        """Slacks and their steps, and what they are judged by, as the kernel takes them; ``own``: the part, weights."""
        part, weights = own
        if slacks is None or barrier is None or step.turn is None:
            no, zero, flat = self._none
            one = np.ones(1)
            return (no, no, no, no, zero), (no, no, no), (part, one), KEPT, (flat, one, v["room"]), no, VALUE, PRICES
        turn = step.turn
        units = plain(barrier.limits), plain(barrier.rate), v["room"]
        given = tuple(map(plain, slacks)), (turn.slacks, turn.multipliers, turn.excess), (part, plain(turn.dual))
        return (*given, KEPT, units, weights, VALUE, PRICES)


def _units(conditions: "Conditions") -> tuple[np.ndarray, ...]:
    """Units of success and of steps, as the kernel takes them."""
    judging, measured = conditions.judging, conditions.measured
    # With a barrier the curvature of the Hessian has no bound.
    least = np.zeros(1) if conditions.barrier is None else judging.cost
    return plain(judging.nodes), plain(judging.unknowns), least, plain(measured.nodes), measured.cost


def _tried(v: dict[str, np.ndarray], slacks: Slacks | None, weights: np.ndarray | None) -> Tried:
    """What the kernel has written."""
    held, pushed = None, None
    if slacks is not None and weights is not None:
        held, pushed = Held(v["limits"], v["pushes"], weights), v["pushed"][:, :, 0]
        slacks = Slacks(v["s"], v["nu"], v["t"], slacks.price, slacks.barrier)
    own = v["hessian"], v["left"], v["right"], v["slopes"], v["gradient"], v["costs"]
    blocks = Blocks(*own, None, held, pushed)
    extent = Extent(*(v[name] for name in Extent._fields))
    at = v["gap"], v["gap"], v["frames"], v["coordinates"], v["nodes"], v["costates"], v["cost"]
    assembled = Assembled(blocks, *at, (None, None), v["largest"], extent)
    covectors = v["covectors"].reshape(v["nodes"].shape)
    iterate = Iterate(Unknowns(v["x"], v["u"]), covectors, slacks)
    return Tried(iterate, assembled, Appraisal.of(v["along"], v["entries"], v["numbers"]), v["surveyed"])


def _table(programs: list[Placed]) -> tuple[np.ndarray, int]:
    """For each program the begin and the end of its instructions, of its sources, and of its targets; the begin and the
    size of what it reads, and of what it writes; the begin and the shape of its registers; and the size of memory."""
    ends, rows, memory, written = np.zeros(3, int), [], 0, 0
    for own in programs:
        after = ends + np.array([len(own.code[0]), len(own.sources), len(own.targets)])
        read, memory = memory, memory + -(-own.numbers[0] // LINE) * LINE
        (reads, writes), registers = own.numbers, own.registers
        rows.append([*np.ravel((ends, after), "F"), read, reads, written, writes, memory, *registers])
        memory, written, ends = memory + registers[0] * registers[1], written + writes, after
    return np.array(rows), memory


def _places(shapes: Shapes) -> np.ndarray:
    """Where each of ``OUT`` begins in what is written, and its lengths."""
    from ....linked import LONGEST

    sizes = [math.prod(shape) for shape in shapes.values()]
    begins = dict(zip(shapes, np.cumsum([0, *sizes]).tolist(), strict=False))
    rows = {name: (begins[name], *shape) for name, shape in shapes.items()}
    rows |= {f"{name}.": (*row[:3], 1, *row[3:]) for name, row in rows.items()}
    rows["zeros"] = begins["points"], sum(sizes) - begins["points"]
    return np.array([rows[name] + (0,) * (LONGEST - len(rows[name])) for name in OUT])


def _functions(steps: OneStage, nodes: Nodes, count: int) -> Iterator[tuple[Evaluated, list[tuple[int, ...]]]]:
    """The functions of a trial, with the shapes of what they are evaluated for."""
    e, u, k = steps.state.size, steps.control.size, steps.parameter.size
    n, z, c = steps.manifold.dimension, steps.dimension, steps.inequalities
    given, ends = [(1, count, 1), (1, 1, k)], [(1, count, e)] * 4
    yield steps._move, [(1, count, e), (1, count, u), (1, count, z), *given]
    yield steps._ends, [(1, count, e), (1, count, u), *given]
    yield nodes._in_frame, [(1, count + 1, size) for size in (e, n, e, e)]
    yield steps._row, [(1, count, e), (1, count, u), *ends, *given, (1, count, c)]


def _shapes(steps: OneStage, count: int) -> Shapes:
    """The shapes of what a trial finds: what the tapes write, in their order, and then what kernels do."""
    e, u, n, z = steps.state.size, steps.control.size, steps.manifold.dimension, steps.dimension
    c, each, at = steps.inequalities, (1, count), (1, count + 1)
    return {
        "x": (*each, e), "u": (*each, 1, u),
        "begins": (*each, e), "finishes": (*each, e),
        "frames": (*at, n, e), "gap": (*at, n), "coordinates": (*at, n), "costates": (*at, e),
        "hessian": (*each, z, z), "slopes": (*each, z), "left": (*each, n, z), "right": (*each, n, z),
        "gradient": (*each, z), "pushes": (*each, 1, c, z), "starts": (*each, n), "arrives": (*each, n),
        "costs": each, "limits": (*each, 1, c),
        "nodes": (*at, e), "gaps": (*at, e), "apart": at, "largest": (1, e), "work": (2, e),
        "covectors": ((count + 1) * e,), "cost": (1,), "pushed": (*each, 1, z, 2),
        "s": (*each, 1, c), "nu": (*each, 1, c), "t": (*each, 1, c),
        "room": (c,), "sums": (2, z), "along": (1, n), "entries": (1, e), "highest": (1, e), "lowest": (1, e),
        # These come as zeros.
        "points": (1, OF_POINTS, n), "surveyed": (len(Surveyed._fields), 1), "numbers": (NUMBERS, 1),
        "support": (1, n, e), "sizes": (1, n), "missing": (1, n), "lacking": (1, n), "held": (1,),
        "parts": (1, z), "slope": (1, z), "curvature": (1, z),
    }  # fmt: skip
