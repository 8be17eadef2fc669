"""Trajectories of a transcribed problem: their arrays, their linear systems, and steps from one to the next."""

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from ctypes import byref
from enum import IntEnum
from functools import partial
from threading import current_thread, main_thread
from typing import Any, NamedTuple, final
from weakref import ref

import numpy as np

from ..aligned import aligned
from ..errors import InvalidInputError
from .core import (
    ARRAYS,
    BYTES,
    FLOAT,
    PLACE,
    REPORT,
    IterationStruct,
    LayoutStruct,
    LimitScaleStruct,
    OptionsStruct,
    ProblemStruct,
    ResidualScaleStruct,
    ScaleDataStruct,
    ScaleStruct,
    address_of,
    best_instruction_set,
    library,
)
from .problem_functions import CallbackFunction, Failure, FunctionName
from .tape_machine import MachineProgram

Function = MachineProgram | CallbackFunction  # of a problem
MOST_ITERATIONS = 1 << 20  # as in search.c


_OPTIONAL = FunctionName.START_COST, FunctionName.END_COST


@final
class Sizes(NamedTuple):
    """The sizes of a problem. A discretization map has one point in each step."""

    steps: int
    points: int
    state_size: int  # dimension of the manifold
    state_numbers: int  # of a point of it
    control_size: int
    control_numbers: int
    parameters: int
    inequalities: int  # at each point; of a discretization map also those at its nodes
    node_inequalities: int  # at the ends of a collocation step, else 0

    @property
    def limits(self) -> int:
        """Number of inequalities of a step of one point."""
        return self.inequalities + self.node_inequalities


@final
class Scale(NamedTuple):
    """Natural sizes: of the unknowns of a step, shape ``(z,)``, of the nodes, ``(n,)``, and of the cost of a step."""

    unknowns: np.ndarray
    nodes: np.ndarray
    cost: float


@final
class LimitScale(NamedTuple):
    """Natural sizes of the inequalities; ``retrax_core.h`` explains them."""

    rate: float
    limits: np.ndarray  # (c,)
    first_penalty: float
    near: float
    last_penalty: float


@final
class Transcription:
    """A transcribed problem as the core has it, for one thread: its functions share registers.

    ``matrix``, ``weights``: the tableau about the middle of a step, shapes ``(s, s)`` and ``(s,)``; ``groups``: the
    column of a matrix, and the array, that each entry of a state belongs to, shape ``(E,)``; ``control_groups``: the
    same of the controls, shape ``(U,)``, where these lie on a manifold that is not flat, else None; ``kept``: 1 for the
    bounds that no iterate leaves, else 0, shape ``(c,)``; ``bounds``: how many inequalities, the first ones, are
    straight in the controls.
    """

    def __init__(
        self,
        sizes: Sizes,
        tableau: tuple[np.ndarray, np.ndarray],
        groups: tuple[np.ndarray, np.ndarray],
        control_groups: tuple[np.ndarray, np.ndarray] | None,
        kept: np.ndarray,
        bounds: int,
        functions: Mapping[FunctionName, Function],
        instruction_set: int | None = None,
    ) -> None:
        self.sizes, self.programs, self._library = sizes, dict(functions), library()
        self.failure = Failure()
        self._set = best_instruction_set() if instruction_set is None else instruction_set
        (matrix, weights), s = tableau, sizes.points
        addresses = (
            address_of(matrix, FLOAT, (s, s), "matrix of a tableau"),
            address_of(weights, FLOAT, (s,), "weights of a tableau"),
            *(address_of(own, PLACE, (sizes.state_numbers,), "columns of the entries of a state") for own in groups),
            control_groups is not None,
            *(address_of(own, PLACE, (sizes.control_numbers,), "columns of controls") for own in control_groups or ()),
            *(() if control_groups else (None, None)),
            address_of(kept, FLOAT, (sizes.limits,), "bounds that no iterate leaves"),
        )
        for own in (*groups, *(control_groups or ())):
            if own.size and not (own.min() >= 0 and own.max() < own.size):
                raise InvalidInputError(f"columns of entries lie in 0 to {own.size - 1}, got {own}")
        self._problem = ProblemStruct(*sizes, *addresses, bounds)
        self._kept: list[object] = [matrix, weights, groups, control_groups, kept]
        size = self._library.retrax_layout_memory(byref(self._problem))
        room = self._library.retrax_workspace(byref(self._problem))
        if not size or not room:
            raise InvalidInputError(f"a problem of these sizes does not fit, or is larger than the core takes: {sizes}")
        points = (sizes.steps + 1) * s
        tapes = [own for own in functions.values() if isinstance(own, MachineProgram)]
        most = max((own.sizes[2] * own.lanes(points) for own in tapes), default=0)
        self._registers = aligned(max(most, 1))
        for name in FunctionName:
            if name is not FunctionName.CONTROL_FRAMES or control_groups is not None:
                self._set_function(name, functions.get(name), points)
        self._workspace = aligned(-(-room // BYTES))
        self._memory, self._layout = aligned(-(-size // BYTES)), LayoutStruct()
        place = address_of(self._memory, FLOAT, self._memory.shape, "memory of a layout")
        self._library.retrax_layout_make(byref(self._problem), place, byref(self._layout))

    @property
    def workspace(self) -> int:
        """The address of the workspace; one thread uses it at a time."""
        return address_of(self._workspace, FLOAT, self._workspace.shape, "workspace")

    def trajectory(self) -> "Trajectory":
        """Return a trajectory, all of whose numbers are zero."""
        return Trajectory(self)

    def _set_function(
        self, name: FunctionName, function: MachineProgram | CallbackFunction | None, points: int
    ) -> None:
        problem, own = byref(self._problem), self._library
        sizes = own.retrax_function_inputs(problem, name), own.retrax_function_outputs(problem, name)
        if function is None:
            if any(sizes) and name not in _OPTIONAL:
                raise InvalidInputError(f"a problem with {self.sizes} needs the function {name.name}")
            return
        if function.sizes[:2] != sizes:
            raise InvalidInputError(
                f"function {name.name}: got {function.sizes[0]} inputs and {function.sizes[1]} outputs, expected "
                f"{sizes[0]} and {sizes[1]} for {self.sizes}"
            )
        if isinstance(function, CallbackFunction):
            self._problem.functions[name] = function.as_function(self.failure)
            return
        self._problem.functions[name], context = function.as_function(self._registers, points, self._set)
        self._kept.append(context)


@final
class Trajectory:
    """The arrays of a trajectory; ``retrax_core.h`` names them."""

    def __init__(self, transcription: Transcription, numbers: np.ndarray | None = None) -> None:
        self._of, self._layout = transcription, transcription._layout
        if numbers is None:
            numbers = aligned(self._layout.numbers)
            numbers[...] = 0.0
        self._numbers = numbers

    def __getitem__(self, name: str) -> np.ndarray:
        """The entries of an array, a view of shape ``(count,)``."""
        place = _PLACES[name]
        first = self._layout.first[place]
        return self._numbers[first : first + self._layout.count[place]]

    def evaluate(self) -> None:
        """Evaluate the functions of the problem at the unknowns, and assemble the linear system."""
        own, here = self._of._library, (byref(self._layout), self._address)
        own.retrax_evaluate_trajectory(*here)
        if self._of.sizes.limits:
            own.retrax_add_inequalities(*here)
        own.retrax_assemble_system(*here, self._of.workspace, self._of._set)
        own.retrax_write_right_sides(*here)
        own.retrax_survey_trajectory(*here)
        self._of.failure.check()

    def measure(self, judging: Scale, steps: Scale, limits: LimitScale | None, least_part: float) -> None:
        """Measure how far the trajectory is from its conditions, and survey its inequalities.

        ``judging``, ``steps``: natural sizes that success is judged by, and those of steps; ``least_part``: the cost
        that sets the scale of slopes where their parts vanish, 0 where their curvature does.
        """
        own, here, of_limits = self._of._library, (byref(self._layout), self._address), None
        n, z = self._of.sizes.state_size, len(self["PARTS"])
        scale = ResidualScaleStruct(
            address_of(judging.nodes, FLOAT, (n,), "natural sizes of nodes"),
            address_of(judging.unknowns, FLOAT, (z,), "natural sizes of unknowns"),
            least_part,
            address_of(steps.nodes, FLOAT, (n,), "natural sizes of nodes"),
            steps.cost,
        )
        if limits is not None:
            c = self._of.sizes.limits
            place = address_of(limits.limits, FLOAT, (c,), "natural sizes of inequalities")
            of_limits = byref(LimitScaleStruct(limits.rate, place, *limits[2:]))
            own.retrax_survey_inequalities(*here, of_limits)
        own.retrax_measure_residuals(*here, byref(scale), of_limits)

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return what each coordinate of the nodes moves by, zero where that is rounding, and its size."""
        n, size = self._of.sizes.state_size, self._of.sizes.state_numbers
        work, moved, sizes = np.empty(2 * size), np.empty(n), np.empty(n)
        places = (address_of(a, FLOAT, a.shape, "sizes") for a in (work, moved, sizes))
        self._of._library.retrax_measure_motion(byref(self._layout), self._address, *places)
        return moved, sizes

    def scale(self, sizes: np.ndarray, values: np.ndarray, room: np.ndarray, curved: bool) -> Scale:
        """Return the natural sizes; ``retrax_core.h`` explains the arguments, of shapes ``(z,)``, ``(z,)`` and ``(s
        m,)``."""
        n, z = self._of.sizes.state_size, len(self["PARTS"])
        names = ("sizes of unknowns", (z,)), ("values of unknowns", (z,)), ("room of controls", (z - n,))
        data = ScaleDataStruct(
            *(address_of(a, FLOAT, s, name) for a, (name, s) in zip((sizes, values, room), names, strict=True)), curved
        )
        unknowns, nodes = np.empty(z), np.empty(n)
        found = ScaleStruct(*(address_of(a, FLOAT, a.shape, "natural sizes") for a in (unknowns, nodes)), 0.0)
        own = self._of._library
        own.retrax_measure_scale(byref(self._layout), self._address, byref(data), self._of.workspace, byref(found))
        return Scale(unknowns, nodes, found.cost)

    def step_inequalities(self, share: float) -> None:
        """Compute the steps of slacks, excesses and multipliers; a share of the way to the boundary may be made."""
        self._of._library.retrax_step_inequalities(byref(self._layout), self._address, share)

    def move_inequalities(self, before: "Trajectory", primal: float, dual: float) -> None:
        """Move slacks, excesses and multipliers from another trajectory by parts of their steps."""
        own = self._of._library
        own.retrax_move_inequalities(byref(self._layout), before._address, primal, dual, self._address)

    def expand(self) -> None:
        """Expand the step of the linear system to steps of the velocities and multipliers of points."""
        self._of._library.retrax_expand_step(byref(self._layout), self._address, self._of.workspace)

    def move(self, before: "Trajectory", part: float) -> None:
        """Move the unknowns from another trajectory by a part of the step from there."""
        self._of._library.retrax_move_trajectory(byref(self._layout), before._address, part, self._address)
        self._of.failure.check()

    @property
    def _address(self) -> int:
        return address_of(self._numbers, FLOAT, self._numbers.shape, "numbers of a trajectory")


class SearchStatus(IntEnum):
    """How a search has ended; ``retrax_core.h`` explains these."""

    GOING_ON = 0
    CONVERGED = 1
    SINGULAR = 2
    INFEASIBLE = 3
    ELSEWHERE = 4
    DEGENERATE = 5
    ITERATION_LIMIT = 6
    STOPPED = 7


@final
class SearchResult(NamedTuple):
    """The result of a search; ``retrax_core.h`` explains the fields."""

    trajectory: "Trajectory"
    first: "Trajectory"
    judging: Scale
    steps: Scale
    limits: np.ndarray
    rate: float
    iterations: int
    claimed: bool
    isolated: bool
    strict: bool
    solvable: bool
    infeasible: bool
    falls: bool
    stopped: bool


@final
class Search:
    """Newton's method on the conditions of one trajectory.

    ``width``: the infeasibility that the funnel lets pass first; ``firm``: times the usual first penalty of excesses;
    ``looks``: whether a guess may be called degenerate; ``report``: called after each evaluation, asks to stop by True.
    """

    def __init__(
        self,
        transcription: Transcription,
        tolerance: float,
        max_iterations: int,
        width: float = 1.0,
        firm: float = 1.0,
        looks: bool = True,
        report: Callable[[IterationStruct], bool] | None = None,
    ) -> None:
        own = self._library = library()
        self._of, self._layout = transcription, byref(transcription._layout)
        size = own.retrax_search_memory(self._layout, max_iterations)
        if not size:
            raise InvalidInputError(f"a search has 1 to {MOST_ITERATIONS} iterations, got {max_iterations}")
        self._memory = aligned(-(-size // BYTES))
        self._memory[...] = 0.0
        place = address_of(self._memory, FLOAT, self._memory.shape, "memory of a search")
        self._report, self._interrupted = report, False
        self._callback = REPORT(partial(_told, ref(self)))  # C calls it
        options = OptionsStruct(tolerance, max_iterations, width, firm, looks, self._callback, None)
        self._search = own.retrax_search_make(self._layout, byref(options), transcription._set, place)

    @property
    def trajectory(self) -> Trajectory:
        """The iterate: the guess before a run, the solution behind it."""
        place = self._library.retrax_search_trajectory(self._search)
        return Trajectory(self._of, self._part(place, self._of._layout.numbers))

    def run(self) -> SearchStatus:
        """Search an extremal from the guess; an error of the report or of a function, or an interrupt, is raised when
        the search has ended."""
        self._interrupted = False
        with self._interrupts():
            status = SearchStatus(self._library.retrax_search_run(self._search))
        self._of.failure.check()
        if self._interrupted:
            raise KeyboardInterrupt
        return status

    @contextmanager
    def _interrupts(self) -> Iterator[None]:
        """A time in which an interrupt asks the search to stop: where C calls Python, nobody could catch it."""
        usual = signal.default_int_handler
        if current_thread() is not main_thread() or signal.getsignal(signal.SIGINT) is not usual:
            yield
            return

        def note(*_: Any) -> None:
            self._interrupted = True

        signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, usual)

    def _reports(self, iteration: IterationStruct) -> bool:
        """Whether the report, an error of that or of a function, or an interrupt asks to stop."""
        failure = self._of.failure
        try:
            ends = failure.error is not None or self._interrupted
            return ends or (self._report is not None and self._report(iteration))
        except BaseException as error:  # C knows no exceptions
            failure.error = error
            return True

    def read(self) -> SearchResult:
        """Return the result of the last run; the next run overwrites its arrays."""
        found, layout, of = self._library.retrax_search_read(self._search), self._of._layout, self._of
        sizes, z = of.sizes, layout.count[_PLACES["PARTS"]]
        at, first = (Trajectory(of, self._part(place, layout.numbers)) for place in (found.trajectory, found.first))
        judging, steps = (
            Scale(self._part(own.unknowns, z), self._part(own.nodes, sizes.state_size), own.cost)
            for own in (found.judging, found.steps)
        )
        limits = self._part(found.limits, sizes.limits)
        told = (getattr(found, name) for name in SearchResult._fields[5:])
        return SearchResult(at, first, judging, steps, limits, *told)

    def _part(self, place: int, count: int) -> np.ndarray:
        """Numbers of the memory of the search from an address on."""
        first = (place - self._memory.ctypes.data) // BYTES
        return self._memory[first : first + count]


def _told(search: Any, _context: int | None, iteration: Any) -> bool:
    """The report that C calls after each evaluation."""
    own = search()
    return own is None or own._reports(iteration.contents)


_PLACES = {library().retrax_array_name(k).decode(): k for k in range(ARRAYS)}
