"""What a compiled pass on one trajectory takes and gives: a trial is what ``move``, ``assemble`` and ``appraised``
find, and a pursuit goes on with whole steps from trial to trial as ``next`` does.

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
from .elimination import positive_definite, workspace
from .extent import OF_POINTS, Extent
from .inequalities import KEPT, VALUE, Held, Slacks, Surveyed
from .kkt_system import Assembled, Iterate, Step
from .meeting import FAR
from .residuals import NUMBERS, SHARES, Appraisal
from .scaling import Units
from .transcription import Blocks, Nodes, OneStage, Unknowns

if TYPE_CHECKING:
    from .conditions import Conditions

Shapes = dict[str, tuple[int, ...]]
Place = tuple[np.ndarray, dict[str, np.ndarray]]
TOLD = "negative", "smallest", "bends", "size"  # of an elimination
# What the kernel writes, in the order of ``trial_kernels.OUT``; where there is a dot, with an axis for its one point,
# and where there is a bar, for its one column.
OUT = (
    *("begins", "finishes", "work", "covectors", "frames", "gap", "coordinates", "costates"),
    *("nodes", "gaps", "apart", "largest", "hessian", "left", "right", "slopes", "gradient"),
    *("hessian.", "slopes.", "limits", "pushes", "costs", "cost", *Extent._fields),
    *("along", "entries", "numbers", "surveyed", "s", "nu", "t", "pushed", "sums", "points", "zeros"),
    *("slopes|", "gap|", "steps|", "multipliers|", "finite", "grown", *TOLD, "standing"),
)


class Setting(NamedTuple):
    """What stays the same in the trials of one trajectory."""

    trial: "Trial"
    data: tuple[np.ndarray, np.ndarray]  # lengths of the steps, and parameters
    weights: np.ndarray  # of the inequalities
    ends: tuple[Any, ...]  # what belongs to the nodes, as the kernel takes it
    work: tuple[float, tuple, tuple]  # of the elimination

    @classmethod
    def of(cls, conditions: "Conditions") -> Self | None:
        """Those of one trajectory with the costs of no ends whose functions are tapes."""
        steps, nodes, data = conditions.transcription, conditions.at_nodes, conditions.data
        batch, count = data.steps.shape
        trial = steps.trial(nodes, count) if batch == 1 and not nodes.pays else None
        if trial is None:
            return None
        layout, given = nodes.layout, (conditions.fixed.ravel(), conditions.both_ends)
        ends = *given, layout.columns, conditions.mean_step, FAR, layout.arrays
        own, work = data.steps[0], workspace(count, nodes.dimension, steps.dimension, 1)
        return cls(trial, (np.array(own), np.array(data.parameters[0])), steps.weights(data), ends, work)


class Tried(NamedTuple):
    """The iterate where a step leads, its system, how it is judged, and the survey of its inequalities."""

    iterate: Iterate
    assembled: Assembled
    appraisal: Appraisal
    surveyed: np.ndarray


class Standing(NamedTuple):
    """What stands between the trials of a pursuit, in the order of ``pursuit_kernels``."""

    promised: float = 0.0
    turned: float = 0.0
    missing: float = 0.0
    cost: float = 0.0
    held: float = 0.0
    funnel: float = 0.0
    best: float = 0.0
    first: bool = False  # no trial was judged before
    correction: float = np.inf
    isolated: bool = False


class Pursuit(NamedTuple):
    """How many whole steps were taken; where these end, the step from there, and what then stands; and a trial of that
    step that was not gone on from, if there is one; how the pass ended with it."""

    taken: int
    last: Tried | None  # none where it set out from a known step and took no other
    step: Step | None
    standing: Standing
    ahead: Tried | None
    arrived: bool  # it is the last
    far: bool  # it takes more than a pass


NO_RULES = 0.0, ((0.0,) * 8, (0.0,) * 5), (0.0,) * 4, (0.0,) * 3, (0.0,) * 2, 0.0
NOT_JUDGED = NO_RULES, np.array(Standing(), float), 0, False


@final
class Trial:
    """The pass for one trajectory of so many steps."""

    def __init__(self, programs: list[Placed], shapes: Shapes) -> None:
        from . import pursuit_kernels, trial_kernels

        self._kernels, self._addresses, self._limited = pursuit_kernels, trial_kernels.addresses, shapes["room"][0] > 0
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
        (iterate, assembled, step), place = before, self._place()
        limits = self._limits(place[1], iterate.slacks, step, conditions.barrier, (part, setting.weights))
        given = assembled.coordinates, assembled.frames, step.unknowns, step.multipliers, part
        own = conditions.judging, conditions.measured, conditions.barrier is not None
        _, end = self._run(setting, own, _flat(iterate, given), limits, [place] * 3, NOT_JUDGED)
        return None if end == self._kernels.FAR else _tried(place[1], iterate.slacks, setting.weights)

    def begin(self, setting: Setting, iterate: Iterate) -> tuple[Tried, Place] | None:
        """The iterate with its system, which is not judged yet, and where it is written; None where ends of steps are
        far apart."""
        place, costates = self._place(), np.array(iterate.costates, float, order="C")  # a guess may be read-only
        zero, one = np.zeros((1, 0, 0)), np.ones((1, costates.shape[1], 1))
        given = one, costates[:, :, None], zero, np.zeros(costates.shape[1]), np.zeros(1)
        n, z = place[1]["left"].shape[2:]
        of = Units(np.ones((1, z)), np.ones((1, n)), np.ones(1))
        limits = self._limits(place[1], None, None, None, (given[4], setting.weights))
        _, end = self._run(setting, (of, of, False), _flat(iterate, given), limits, [place] * 3, NOT_JUDGED)
        return None if end == self._kernels.FAR else (_tried(place[1], None, None), place)

    def pursue(
        self,
        setting: Setting,
        conditions: "Conditions",
        before: tuple[Iterate, Assembled, Step | None],
        going: tuple[tuple, Standing, int],
        begun: Place | None = None,
    ) -> Pursuit | None:
        """Iterations with whole steps; None where the first step of a search is not one of these.

        ``going``: rules, what stands, and how many at most; ``begun``: where a system is written that has no step yet.
        """
        (iterate, assembled, step), (rules, standing, most), part = before, going, np.ones(1)
        places = [self._place(), self._place()]
        places.append(places[0] if begun is None else begun)
        moves = (np.zeros(0), np.zeros(0)) if step is None else (step.unknowns, step.multipliers)
        given = assembled.coordinates, assembled.frames, *moves, part
        stands, own = np.array(standing, float), (conditions.judging, conditions.measured, False)
        limits = self._limits(places[0][1], None, None, None, (part, setting.weights))
        now = rules, stands, most, begun is not None
        count, end = self._run(setting, own, _flat(iterate, given), limits, places, now)
        if end == self._kernels.LOST:
            return None
        last, new, kinds = None, step, self._kernels
        if count or begun is not None:
            written = places[(count - 1) % 2 if count else 2][1]
            last, new = _tried(written, None, None), _step(written)
        ahead = _tried(places[count % 2][1], None, None) if end in (kinds.TRIED, kinds.ARRIVED) else None
        return Pursuit(count, last, new, Standing(*stands.tolist()), ahead, end == kinds.ARRIVED, end == kinds.FAR)

    def _place(self) -> Place:
        """Room for what a trial finds, and its arrays."""
        numbers = np.empty(self._structure.itemsize // 8)
        structure = np.ndarray((), self._structure, numbers)
        return numbers, {name: structure[name] for name in self._fields}

    def _run(
        self,
        setting: Setting,
        of: tuple[Units, Units, bool],
        before: tuple[np.ndarray, ...],
        limits: tuple[Any, ...],
        places: list[Place],
        going: tuple[tuple, np.ndarray, int, bool],
    ) -> tuple[int, int]:
        """Run the kernel: how many steps were taken, and how it ends; ``of``: units of success, of steps, and whether
        there is a barrier, with which the curvature of the Hessian has no bound."""
        (judging, measured, limited), tapes = of, (*self._programs, *scratch(((self._memory,),)))
        least, nodes = judging.cost if limited else np.zeros(1), plain(measured.nodes)
        units = plain(judging.nodes), plain(judging.unknowns), least, nodes, measured.cost
        raised = np.zeros(1), np.empty((1, measured.unknowns.shape[1]))
        for array in setting.work[1]:  # others work there too
            array.fill(0.0)
        return self._kernels.pursue(
            self._addresses(self._limited),
            (*tapes, tuple(numbers for numbers, _ in places)),
            before,
            setting.data,
            setting.ends,
            (units, SHARES),
            limits,
            self._places,
            (setting.work, (plain(measured.unknowns), 1 / nodes, plain(measured.cost)), raised),
            *going,
        )

    def _limits(
        self,
        v: dict[str, np.ndarray],
        slacks: Slacks | None,
        step: Step | None,
        barrier: Barrier | None,
        own: tuple[np.ndarray, np.ndarray],
    ) -> tuple[Any, ...]:
        """Slacks and their steps, and what they are judged by, as the kernel takes them; ``own``: the part, weights."""
        part, weights = own
        if slacks is None or barrier is None or step is None or step.turn is None:
            no, zero, flat = self._none
            one = np.ones(1)
            return (no, no, no, no, zero), (no, no, no), (part, one), KEPT, (flat, one, v["room"]), no, VALUE, PRICES
        turn = step.turn
        units = plain(barrier.limits), plain(barrier.rate), v["room"]
        given = tuple(map(plain, slacks)), (turn.slacks, turn.multipliers, turn.excess), (part, plain(turn.dual))
        return (*given, KEPT, units, weights, VALUE, PRICES)


def _flat(iterate: Iterate, given: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """What a trial sets out from, as the kernel takes it; ``given``: coordinates, frames, steps, and the part."""
    coordinates, frames, steps, multipliers, part = given
    unknowns = np.concatenate((iterate.unknowns.centres.ravel(), iterate.unknowns.controls.ravel()))
    return unknowns, coordinates, frames, steps.ravel(), multipliers.ravel(), part


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


def _step(v: dict[str, np.ndarray]) -> Step:
    """The step that the kernel has written."""
    count, (negative, smallest) = v["multipliers"].size, (v["negative"], v["smallest"])
    every = np.ones(1, bool)
    inertia = positive_definite(negative, smallest, count), negative == count
    return Step(v["steps"], v["multipliers"], v["grown"], *inertia, every, share=np.ones(1), followed=np.ones(1))


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
    rows |= {f"{name}.": (*row[:3], 1, *row[3:]) for name, row in rows.items()} | {
        f"{name}|": (*row, 1) for name, row in rows.items()
    }
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
        "steps": (*each, z), "multipliers": (*at, n), "finite": (1, 1), "grown": (1, z),
        "standing": (len(Standing._fields),), **dict.fromkeys(TOLD, (1,)),
        "s": (*each, 1, c), "nu": (*each, 1, c), "t": (*each, 1, c),
        "room": (c,), "sums": (2, z), "along": (1, n), "entries": (1, e), "highest": (1, e), "lowest": (1, e),
        # These come as zeros.
        "points": (1, OF_POINTS, n), "surveyed": (len(Surveyed._fields), 1), "numbers": (NUMBERS, 1),
        "support": (1, n, e), "sizes": (1, n), "missing": (1, n), "lacking": (1, n), "held": (1,),
        "parts": (1, z), "slope": (1, z), "curvature": (1, z),
    }  # fmt: skip
