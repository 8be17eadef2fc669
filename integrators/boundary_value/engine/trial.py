"""What a compiled pass on one trajectory takes and gives: a trial is what ``move``, ``assemble`` and ``appraised``
find, and a pursuit goes on with whole steps from trial to trial as ``next`` does.

Each of these is a few kernels and many small operations of NumPy, which for one trajectory of some hundred steps take
longer than the kernels. In batches they take next to nothing of each. What a trial is made of depends on the
transcription: ``one_stage_trial``, ``collocation_trial``.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from ....aligned import scratch
from ....compute.base import PointwiseFunction
from ..transcription.iterate import Iterate, Slacks
from .barrier import LAST, LOWERING, PRICES
from .elimination import WEIGHT, clear_pivot, positive_definite
from .extent import Extent
from .fields import Fields, OfEach, Place, Shapes
from .inequalities import BOUNDARY, KEPT, VALUE, Held, Turn
from .kkt_system import Assembled, Step
from .meeting import FAR
from .programs import joined
from .residuals import SHARES, Appraisal
from .scaling import Units
from .standing import STANDING, Standing, standing_with_costs
from .transcription import Blocks, Nodes
from .trial_shapes import given_shapes, room_shapes, setting_shapes, written_shapes

if TYPE_CHECKING:
    from .conditions import Conditions

Share = Callable[[Callable[[range], Iterator[None]], int], None]
Called = tuple[PointwiseFunction, int, list[tuple[int, ...]]]  # leading axes, and shapes of what it is evaluated for


class Setting(NamedTuple):
    """What stays the same in the trials of one trajectory."""

    trial: "Trial"
    numbers: np.ndarray
    weights: np.ndarray | None  # of the inequalities, if there are any

    @classmethod
    def of(cls, conditions: "Conditions") -> Self | None:
        """Those of one trajectory with the costs of no ends whose functions are tapes."""
        steps, nodes, data = conditions.transcription, conditions.at_nodes, conditions.data
        batch, count = data.steps.shape
        trial = steps.trial(nodes, count) if batch == 1 and not nodes.pays else None
        if trial is None:
            return None
        numbers, v = trial.setting.place()
        put_setting(v, conditions, trial.tableau)
        return cls(trial, numbers, steps.weights(data) if steps.inequalities else None)


def put_setting(v: Any, conditions: "Conditions", tableau: tuple[np.ndarray, np.ndarray]) -> None:
    """Write what stays the same of one trajectory, or of each of a batch in rows."""
    data, ends, layout = conditions.data, conditions.ends, conditions.at_nodes.layout
    v["matrix"][...], v["weights"][...] = tableau
    v["columns"][...], v["arrays"][...] = layout.columns, layout.arrays
    v["start_entries"][...], v["end_entries"][...] = ends.start_entries, ends.end_entries
    v["h"][...], v["parameters"][...] = data.steps, data.parameters
    v["start"][..., 0, :], v["end"][..., 0, :] = ends.start, ends.end
    v["fixed"][...] = conditions.fixed.reshape(len(data.steps), -1)
    v["mean"][..., 0] = conditions.mean_step


class Tried(NamedTuple):
    """The iterate where a step leads, its system, how it is judged, and the survey of its inequalities."""

    iterate: Iterate
    assembled: Assembled
    appraisal: Appraisal
    surveyed: np.ndarray


class SetOut(NamedTuple):
    """The guess with its system when it is asked for, the units from there, and the pursuit, if its first step is a
    whole one."""

    first: Callable[[], Tried]
    units: Units
    pursuit: "Pursuit | None"


class Arrivals(NamedTuple):
    """The members of a batch that a pass each has led to a solution: their places, the iterates with their systems, the
    units from their guesses, whether the systems are those of strict minima, and how many trials that took."""

    members: np.ndarray
    tried: Tried
    units: Units
    strict: np.ndarray
    trials: np.ndarray


class Pursuit(NamedTuple):
    """How many whole steps were taken; where these end, the step from there, and what then stands; and a trial of that
    step that was not gone on from, if there is one; how the pass ended with it."""

    taken: int
    last: Tried | None  # none where it took no step, and where it has arrived
    step: Step
    standing: Standing
    ahead: Tried | None
    arrived: bool  # it is the last
    exact: bool  # what it has led to is
    far: bool  # it takes more than a pass
    costs: list[float]  # of the guess, if it set out from one, and after each step


NOT_JUDGED = 0.0, ((0.0,) * 9, (0.0,) * 5), (0.0,) * 4, (0.0,) * 3, (0.0,) * 2, 0.0, (0.0,) * 2
SIZES = (FAR, KEPT), (VALUE, PRICES), SHARES
SETTING_KINDS = {"start_entries": bool, "end_entries": bool, "columns": int, "arrays": int}
ROOM_KINDS = {"pivots": int, "order": int, "swaps": int, "curved": bool}


class Trial(ABC):
    """The pass for one trajectory of so many steps."""

    tableau: tuple[np.ndarray, np.ndarray] = np.zeros((0, 0)), np.zeros(0)

    def __init__(self, programs: list[Any], steps: Any, count: int) -> None:
        from . import pursuit_kernels

        self._kernels, self.limited = pursuit_kernels, steps.inequalities > 0
        self._tapes, self._count = programs, count
        self._weight, (self._programs, of_programs, self._memory) = WEIGHT * count, joined(programs)
        self._clear = clear_pivot((count + 1) * steps.manifold.dimension)
        self.written = Fields(self.shapes(steps, count) | written_shapes(steps, count))
        self.setting = Fields(setting_shapes(steps, count, self.tableau), SETTING_KINDS)
        self._given = Fields(given_shapes(steps, count))
        self._room = Fields(room_shapes(steps, count), ROOM_KINDS, lined=True)
        common, own = self.rows(self.written)
        rows = common, of_programs, self.setting.all_rows, self._given.all_rows, self._room.all_rows, own
        self._rows = np.concatenate(rows)

    @classmethod
    def of(cls, steps: Any, nodes: Nodes, count: int) -> Self | None:
        """None: there are no compiled passes."""
        del steps, nodes, count
        return None

    @property
    def is_current(self) -> bool:
        """Whether none of its tapes has become machine code since."""
        return all(own.code is own.tape.code for own in self._tapes)

    @staticmethod
    @abstractmethod
    def functions(steps: Any, nodes: Nodes, count: int) -> Iterable[Called]:
        """The functions of a trial."""

    @staticmethod
    @abstractmethod
    def shapes(steps: Any, count: int) -> Shapes:
        """The shapes of what is its own: what its tapes write, in their order, and then what its kernels do."""

    @abstractmethod
    def rows(self, fields: Fields) -> tuple[np.ndarray, np.ndarray]:
        """Where the arrays stand of all passes, and its own."""

    @abstractmethod
    def addresses(self) -> tuple[int, ...]:
        """Those of its kernels."""

    @cached_property
    def _calls(self) -> tuple[int, ...]:
        """The addresses of all kernels that a pass calls."""
        own = self.addresses()  # before the common ones, of which another process may compile the last
        return *self._kernels.addresses(self.limited), *own

    @abstractmethod
    def put(self, v: Any, iterate: Iterate, assembled: Assembled | None, step: Step | None) -> None:
        """Write what a trial sets out from beside what all do: unknowns, and what was condensed, with its steps."""

    @abstractmethod
    def found(self, v: Any, held: Held | None) -> tuple[Any, Blocks]:
        """The unknowns and the blocks that are written."""

    @abstractmethod
    def inner(self, v: Any) -> Any:
        """The steps of what was condensed that are written."""

    def __call__(
        self, setting: Setting, conditions: "Conditions", before: tuple[Iterate, Assembled, Step], part: np.ndarray
    ) -> Tried | None:
        """The trial of a part of a step; None where it takes more than this, as where ends of steps are far apart."""
        iterate, _, step = before
        if self.limited and (iterate.slacks is None or step.turn is None):
            return None
        to, known = self.written.place(), self._known(*before, self.written.place())
        known.v["part"][...] = part
        numbers, _ = self._given_for(conditions, iterate.slacks, setting.weights)
        standing = standing_with_costs(Standing(), 0)
        _, end = self._run(setting.numbers, numbers, [to, to, known], NOT_JUDGED, (standing, 0, False))
        return None if end == self._kernels.FAR else self._tried(to.v, iterate.slacks, setting.weights)

    def set_out(self, setting: Setting, guess: Iterate, going: tuple[tuple, int]) -> SetOut | None:
        """The guess with its system, units from there, and iterations with whole steps; None where ends of steps are
        far apart; ``going``: rules, and how many iterations at most."""
        places = [self.written.place() for _ in range(3)]
        self._known(guess, None, None, places[1])
        (numbers, v), stands, (rules, most) = self._given_for(None), standing_with_costs(Standing(), going[1]), going
        count, end = self._run(setting.numbers, numbers, places, rules, (stands, most, True))
        if end == self._kernels.APART:
            return None
        units, first = Units(v["unknowns"], v["nodes"], v["unit"]), partial(self._tried, places[2].v)
        if end == self._kernels.LOST:
            return SetOut(first, units, None)
        last = None if count else (None, self._step(places[2].v))
        return SetOut(first, units, self._pursuit(places, (count, end, stands), last))

    def set_out_each(
        self, conditions: "Conditions", guess: Iterate, going: tuple[tuple, int], share: Share
    ) -> Arrivals:
        """The same for each trajectory of a batch, of which those are taken that arrive in one pass.

        ``share(run, count)`` runs the passes of ranges of the batch, in threads or not, until it is to stop.
        """
        count, (rules, most), kinds = len(guess.costates), going, self._kernels
        settings, given, kept = (fields.in_rows(count) for fields in (self.setting, self._given, self.written))
        put_setting(settings.v, conditions, self.tableau)
        _unmeasured(given.v)
        trials, told, fresh = np.zeros(count, int), np.zeros((2, count)), standing_with_costs(Standing(), most)

        def run(part: range) -> Iterator[None]:
            places, stands = [self.written.place() for _ in range(3)], fresh.copy()
            for k in part:
                unknowns = type(guess.unknowns)(*[rows[k] for rows in guess.unknowns])
                self._known(Iterate(unknowns, guess.costates[k]), None, None, places[1])
                stands[...] = fresh
                taken, end = self._run(settings.numbers[k], given.numbers[k], places, rules, (stands, most, True))
                if end in (kinds.ARRIVED, kinds.EXACT):
                    trials[k], v = taken + (end == kinds.ARRIVED), places[(taken - 1) % 2].v
                    kept.numbers[k] = places[(trials[k] - 1) % 2].numbers
                    told[:, k] = v["negative"][0], v["smallest"][0]
                yield

        share(run, count)
        members = np.flatnonzero(trials)
        tried, units = self._tried(OfEach(kept.v, members)), OfEach(given.v, members)
        negative, smallest = told[:, members]
        strict = positive_definite(negative, smallest, settings.v["fixed"].shape[1])
        own = Units(units["unknowns"], units["nodes"], units["unit"])
        return Arrivals(members, tried, own, strict, trials[members])

    def pursue(
        self,
        setting: Setting,
        conditions: "Conditions",
        before: tuple[Iterate, Assembled, Step],
        going: tuple[tuple, Standing, int],
    ) -> Pursuit:
        """Iterations with whole steps; ``going``: rules, what stands, and how many at most."""
        (rules, standing, most), places = going, [self.written.place() for _ in range(3)]
        self._known(*before, places[2])
        slacks, stands = before[0].slacks, standing_with_costs(standing, most)
        numbers, _ = self._given_for(conditions, slacks, setting.weights)
        count, end = self._run(setting.numbers, numbers, places, rules, (stands, most, False))
        last = None if count else (None, before[2])
        return self._pursuit(places, (count, end, stands), last, slacks, setting.weights)

    def _pursuit(
        self,
        places: list[Place],
        ended: tuple[int, int, np.ndarray],
        last: tuple[Tried | None, Step] | None,
        slacks: Slacks | None = None,
        weights: np.ndarray | None = None,
    ) -> Pursuit:
        """What was found; ``ended``: after how many steps and how, and what stands then; ``last``: where it set out
        from, if it has led nowhere else."""
        (count, end, standing), kinds = ended, self._kernels
        arrived = end == kinds.ARRIVED
        if last is None:
            written = places[(count - 1) % 2].v
            last = None if arrived else self._tried(written, slacks, weights), self._step(written)
        is_tried = arrived or end == kinds.TRIED
        ahead = self._tried(places[count % 2].v, slacks, weights) if is_tried else None
        numbers = standing.tolist()
        stands, costs = Standing(*numbers[:STANDING]), numbers[STANDING : STANDING + count + 1]
        return Pursuit(count, *last, stands, ahead, arrived, end == kinds.EXACT, end == kinds.FAR, costs)

    def _known(self, iterate: Iterate, assembled: Assembled | None, step: Step | None, place: Place) -> Place:
        """The place with what a trial sets out from; without a step, the iterate where it stays."""
        v, unknowns = place.v, iterate.unknowns
        v["x"][...], v["u"][...], v["barrier"][...] = unknowns.centres, unknowns.controls, 0.0
        if assembled is None or step is None:
            v["covectors"][...], v["part"][...] = iterate.costates.ravel(), 0.0
        else:
            v["coordinates"][...], v["frames"][...] = assembled.coordinates, assembled.frames
            v["steps"][...], v["multipliers"][...], v["part"][...] = step.unknowns, step.multipliers, step.reach
        if iterate.slacks is not None and step is not None and step.turn is not None:
            v["s"][...], v["nu"][...], v["t"][...], _, v["barrier"][...] = iterate.slacks
            v["turn_s"][...], v["turn_nu"][...], v["turn_t"][...], _, v["dual"][...], *_ = step.turn
        self.put(v, iterate, assembled, step)
        return place

    def _given_for(
        self, conditions: "Conditions | None", slacks: Slacks | None = None, weights: np.ndarray | None = None
    ) -> Place:
        """What is given to a pass, of which the units are known if there are conditions."""
        given = self._given.place()
        v = given.v
        _unmeasured(v)
        if conditions is not None:
            judging, measured = conditions.judging, conditions.measured
            v["nodes"][...], v["unknowns"][...] = judging.nodes, judging.unknowns
            v["wide_nodes"][...], v["wide"][...] = measured.nodes, measured.unknowns
            v["inverse"][...], v["unit"][...], v["cost"][...] = 1 / measured.nodes, measured.cost, measured.cost
            if slacks is not None and conditions.barrier is not None:
                v["least"][...] = judging.cost  # with a barrier the curvature of the Hessian has no bound
                v["price"][...], v["weighed"][...] = slacks.price, weights
                v["rate"][...], v["bounds"][...] = conditions.barrier[:2]
        return given

    def _run(
        self,
        setting: np.ndarray,
        given: np.ndarray,
        places: list[Place],
        rules: tuple,
        going: tuple[np.ndarray, int, bool],
    ) -> tuple[int, int]:
        """Run the kernel: how many steps were taken, and how it ends; ``places``: two in which trials are written, and
        what the pass sets out from, or its guess in the second one, and the system there."""
        memory, room = scratch(((self._memory,), (self._room.size,)))
        room[: self._room.begins["kept"]] = 0.0  # others work there too
        judge, steps, *others = rules[1:]
        steps = *steps, self._weight, BOUNDARY, self._clear
        taken, end = self._kernels.pursue(
            self._calls,
            self._programs,
            memory,
            tuple([place.numbers for place in places]),
            (setting, given, room),
            self._rows,
            (rules[0], judge, steps, *others[:-1], *SIZES, (LAST, LOWERING, *others[-1])),
            *going,
        )
        for own in self._tapes:
            own.tape.ran(self._count * (taken + 1))
        return taken, end

    def _tried(self, v: Any, slacks: Slacks | None = None, weights: np.ndarray | None = None) -> Tried:
        """What the kernel has written."""
        held = None
        if slacks is not None and weights is not None:
            held = Held(v["limits"], v["pushes"], weights)
            slacks = Slacks(v["s"], v["nu"], v["t"], slacks.price, v["barrier"])
        (unknowns, blocks), extent = self.found(v, held), Extent(*[v[name] for name in Extent._fields])
        at = v["gap"], v["gap"], v["frames"], v["coordinates"], v["nodes"], v["costates"], v["cost"]
        assembled = Assembled(blocks, *at, (None, None), v["largest"], extent)
        iterate = Iterate(unknowns, v["covectors"].reshape(v["nodes"].shape), slacks)
        return Tried(iterate, assembled, Appraisal.of(v["along"], v["entries"], v["numbers"]), v["surveyed"])

    def _step(self, v: Any) -> Step:
        """The step that the kernel has written."""
        count, (negative, smallest) = v["multipliers"].size, (v["negative"], v["smallest"])
        every, inner, turn = np.array([True]), self.inner(v), None
        inertia = positive_definite(negative, smallest, count), negative == count
        whole = v["steps"], v["multipliers"], v["grown"]
        if self.limited:
            turn = Turn(v["turn_s"], v["turn_nu"], v["turn_t"], *v["turned"].T)
        return Step(*whole, *inertia, every, inner, turn, share=np.array([1.0]), followed=np.array([1.0]))


def _unmeasured(v: Any) -> None:
    """Write what is given to passes that take their own units."""
    v["least"][...], v["raised"][...], v["rate"][...] = 0.0, 0.0, 1.0
