"""What a compiled pass on one trajectory takes and gives: a trial is what ``move``, ``assemble`` and ``appraised``
find, and a pursuit goes on with whole steps from trial to trial as ``next`` does.

Each of these is a few kernels and many small operations of NumPy, which for one trajectory of some hundred steps take
longer than the kernels. In batches they take next to nothing of each. What a trial is made of depends on the
transcription: ``one_stage_trial``, ``collocation_trial``.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, Self

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
from .transcription import Blocks, Nodes

if TYPE_CHECKING:
    from .conditions import Conditions

Shapes = dict[str, tuple[int, ...]]
Called = tuple[Evaluated, int, list[tuple[int, ...]]]  # leading axes, and shapes of what it is evaluated for
Place = tuple[np.ndarray, dict[str, np.ndarray]]
TOLD = "negative", "smallest", "bends", "size"  # of an elimination
# What all passes write, in the order of ``trial_kernels.OUT``; where there is a dot, with an axis for its one point,
# where there is a bar, for its one column, and where there is a stroke, without axes.
OUT = (
    *("begins", "finishes", "work", "covectors", "frames", "gap", "coordinates", "costates"),
    *("nodes", "gaps", "apart", "largest", "hessian", "left", "right", "slopes", "gradient"),
    *("hessian.", "slopes.", "limits", "pushes", "costs", "cost", *Extent._fields),
    *("along", "entries", "numbers", "surveyed", "points", "s", "nu", "t", "pushed", "sums", "zeros"),
    *("slopes|", "lacks|", "steps|", "multipliers|", "finite", "grown", *TOLD, "change", "standing"),
    *("x/", "u/", "velocities/", "steps/", "multipliers/", "known/", "inner/"),
)


class Setting(NamedTuple):
    """What stays the same in the trials of one trajectory."""

    trial: "Trial"
    data: tuple[np.ndarray, ...]  # lengths of the steps, parameters, a tableau
    weights: np.ndarray | None  # of the inequalities, if there are any
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
        layout, points = nodes.layout, (conditions.fixed.ravel(), conditions.both_ends)
        ends = *points, layout.columns, conditions.mean_step, FAR, layout.arrays
        own, work = data.steps[0], workspace(count, nodes.dimension, steps.dimension, 1)
        given = np.array(own), np.array(data.parameters[0]), *trial.tableau
        return cls(trial, given, steps.weights(data) if steps.inequalities else None, ends, work)


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


class Trial(ABC):
    """The pass for one trajectory of so many steps."""

    tableau: tuple[np.ndarray, np.ndarray] = np.zeros((0, 0)), np.zeros(0)

    def __init__(self, programs: list[Placed], steps: Any, count: int) -> None:
        from . import pursuit_kernels, trial_kernels

        self._kernels, self._addresses, self.limited = pursuit_kernels, trial_kernels.addresses, steps.inequalities > 0
        arrays = zip(*((*own.code, own.sources, own.targets) for own in programs), strict=True)
        table, self._memory = _table(programs)
        self._programs = *map(np.concatenate, arrays), table
        shapes = self.shapes(steps, count) | _shapes(steps, count)
        self._fields = list(shapes)
        self._structure = np.dtype([(name, float, shape) for name, shape in shapes.items()])
        self._places = self.places(shapes)
        self._none = np.zeros((1, 0, 1, 0)), np.zeros(1), np.zeros((1, 0))

    @classmethod
    def of(cls, steps: Any, nodes: Nodes, count: int) -> Self | None:
        """That of a transcription; None where its functions do not run as tapes, or threads share them."""
        found = [function.placed(axes, given) for function, axes, given in cls.functions(steps, nodes, count)]
        programs = [program for program in found if program is not None]
        return cls(programs, steps, count) if len(programs) == len(found) else None

    @staticmethod
    @abstractmethod
    def functions(steps: Any, nodes: Nodes, count: int) -> Iterable[Called]:
        """The functions of a trial."""

    @staticmethod
    @abstractmethod
    def shapes(steps: Any, count: int) -> Shapes:
        """The shapes of what is its own: what its tapes write, in their order, and then what its kernels do."""

    @abstractmethod
    def places(self, shapes: Shapes) -> tuple[np.ndarray, np.ndarray]:
        """Where the arrays lie of all passes, and its own."""

    @abstractmethod
    def addresses(self) -> tuple[int, ...]:
        """Those of its kernels."""

    @abstractmethod
    def flat(self, iterate: Iterate, assembled: Assembled | None, step: Step | None) -> tuple[np.ndarray, ...]:
        """Vectors that it sets out from: of unknowns beside states and controls, of what is known of what was
        condensed, and of its steps."""

    @abstractmethod
    def found(self, v: dict[str, np.ndarray], held: Held | None) -> tuple[Any, Blocks]:
        """The unknowns and the blocks that are written."""

    @abstractmethod
    def inner(self, v: dict[str, np.ndarray]) -> Any:
        """The steps of what was condensed that are written."""

    def __call__(
        self, setting: Setting, conditions: "Conditions", before: tuple[Iterate, Assembled, Step], part: np.ndarray
    ) -> Tried | None:
        """The trial of a part of a step; None where ends of steps are far apart, which takes more than this."""
        (iterate, _, step), place = before, self._place()
        limits = self._limits(place[1], iterate.slacks, step, conditions.barrier, (part, setting.weights))
        own = conditions.judging, conditions.measured, conditions.barrier is not None
        _, end = self._run(setting, own, self._before(*before, part), limits, [place] * 3, NOT_JUDGED)
        return None if end == self._kernels.FAR else self._tried(place[1], iterate.slacks, setting.weights)

    def begin(self, setting: Setting, iterate: Iterate) -> tuple[Tried, Place] | None:
        """The iterate with its system, which is not judged yet, and where it is written; None where ends of steps are
        far apart."""
        place, part = self._place(), np.zeros(1)
        n, z = place[1]["left"].shape[2:]
        of = Units(np.ones((1, z)), np.ones((1, n)), np.ones(1))
        limits = self._limits(place[1], None, None, None, (part, None))
        _, end = self._run(
            setting, (of, of, False), self._before(iterate, None, None, part), limits, [place] * 3, NOT_JUDGED
        )
        return None if end == self._kernels.FAR else (self._tried(place[1], None, None), place)

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
        (_, _, step), (rules, standing, most), part = before, going, np.ones(1)
        places = [self._place(), self._place()]
        places.append(places[0] if begun is None else begun)
        stands, own = np.array(standing, float), (conditions.judging, conditions.measured, False)
        limits = self._limits(places[0][1], None, None, None, (part, None))
        now = rules, stands, most, begun is not None
        count, end = self._run(setting, own, self._before(*before, part), limits, places, now)
        if end == self._kernels.LOST:
            return None
        last, new, kinds = None, step, self._kernels
        if count or begun is not None:
            written = places[(count - 1) % 2 if count else 2][1]
            last, new = self._tried(written, None, None), self._step(written)
        ahead = self._tried(places[count % 2][1], None, None) if end in (kinds.TRIED, kinds.ARRIVED) else None
        return Pursuit(count, last, new, Standing(*stands.tolist()), ahead, end == kinds.ARRIVED, end == kinds.FAR)

    def _place(self) -> Place:
        """Room for what a trial finds, and its arrays."""
        numbers = np.empty(self._structure.itemsize // 8)
        structure = np.ndarray((), self._structure, numbers)
        return numbers, {name: structure[name] for name in self._fields}

    def _before(
        self, iterate: Iterate, assembled: Assembled | None, step: Step | None, part: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """What a trial sets out from, as the kernel takes it, in arrays of its own: a guess may be read-only."""
        unknowns, vectors = iterate.unknowns, self.flat(iterate, assembled, step)
        points = copied(unknowns.centres).ravel(), copied(unknowns.controls).ravel()
        if assembled is None or step is None:  # each covector is the only vector of a frame
            costates, (others, known, inner) = copied(iterate.costates)[:, :, None], vectors
            ones = np.ones(costates.shape[:3])
            return *points, others, np.zeros(0), np.zeros(ones.size), known, inner, ones, costates, part
        others, known, inner = vectors
        moves = step.unknowns.ravel(), step.multipliers.ravel()
        return *points, others, *moves, known, inner, assembled.coordinates, assembled.frames, part

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
            (*self._addresses(self.limited), *self.addresses()),
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
        own: tuple[np.ndarray, np.ndarray | None],
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

    def _tried(self, v: dict[str, np.ndarray], slacks: Slacks | None, weights: np.ndarray | None) -> Tried:
        """What the kernel has written."""
        held = None
        if slacks is not None and weights is not None:
            held = Held(v["limits"], v["pushes"], weights)
            slacks = Slacks(v["s"], v["nu"], v["t"], slacks.price, slacks.barrier)
        (unknowns, blocks), extent = self.found(v, held), Extent(*(v[name] for name in Extent._fields))
        at = v["gap"], v["gap"], v["frames"], v["coordinates"], v["nodes"], v["costates"], v["cost"]
        assembled = Assembled(blocks, *at, (None, None), v["largest"], extent)
        iterate = Iterate(unknowns, v["covectors"].reshape(v["nodes"].shape), slacks)
        return Tried(iterate, assembled, Appraisal.of(v["along"], v["entries"], v["numbers"]), v["surveyed"])

    def _step(self, v: dict[str, np.ndarray]) -> Step:
        """The step that the kernel has written."""
        count, (negative, smallest) = v["multipliers"].size, (v["negative"], v["smallest"])
        every, inner = np.ones(1, bool), self.inner(v)
        inertia = positive_definite(negative, smallest, count), negative == count
        whole = v["steps"], v["multipliers"], v["grown"]
        return Step(*whole, *inertia, every, inner, share=np.ones(1), followed=np.ones(1))


def copied(array: np.ndarray) -> np.ndarray:
    """A copy as the kernels take it."""
    return np.array(array, float, order="C")


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


def rows(shapes: Shapes, arrays: Iterable[tuple[str, tuple[int, ...]]]) -> np.ndarray:
    """Where arrays begin in what is written, and their lengths, one row each."""
    from ....linked import LONGEST

    sizes = [math.prod(shape) for shape in shapes.values()]
    begins = dict(zip(shapes, np.cumsum([0, *sizes]).tolist(), strict=False))
    found = [(begins[name], *shape) for name, shape in arrays]
    return np.array([row + (0,) * (LONGEST - len(row)) for row in found])


def common(shapes: Shapes, others: dict[str, tuple[str, tuple[int, ...]]]) -> np.ndarray:
    """The rows of ``OUT``; ``others``: what lies in the place of something else."""
    known = {name: (name, shape) for name, shape in shapes.items()} | others
    for name, (first, shape) in tuple(known.items()):
        known |= {
            f"{name}.": (first, (*shape[:2], 1, *shape[2:])),
            f"{name}|": (first, (*shape, 1)),
            f"{name}/": (first, (math.prod(shape),)),
        }
    fields = list(shapes)
    after = fields[fields.index("surveyed") :]
    known["zeros"] = "surveyed", (sum(math.prod(shapes[name]) for name in after),)
    return rows(shapes, (known[name] for name in OUT))


def _shapes(steps: Any, count: int) -> Shapes:
    """The shapes of what all passes write."""
    e, n, z, c = steps.state.size, steps.manifold.dimension, steps.dimension, steps.inequalities
    each, at = (1, count), (1, count + 1)
    return {
        "nodes": (*at, e), "gaps": (*at, e), "apart": at, "largest": (1, e), "work": (2, e),
        "covectors": ((count + 1) * e,), "cost": (1,), "pushed": (*each, 1, z, 2),
        "steps": (*each, z), "multipliers": (*at, n), "finite": (1, 1), "grown": (1, z),
        "change": (2,), "standing": (len(Standing._fields),), **dict.fromkeys(TOLD, (1,)),
        "s": (*each, 1, c), "nu": (*each, 1, c), "t": (*each, 1, c),
        "room": (c,), "sums": (2, z), "along": (1, n), "entries": (1, e), "highest": (1, e), "lowest": (1, e),
        "points": (1, OF_POINTS, n),
        # These come as zeros.
        "surveyed": (len(Surveyed._fields), 1), "numbers": (NUMBERS, 1),
        "support": (1, n, e), "sizes": (1, n), "missing": (1, n), "lacking": (1, n), "held": (1,),
        "parts": (1, z), "slope": (1, z), "curvature": (1, z),
    }  # fmt: skip
