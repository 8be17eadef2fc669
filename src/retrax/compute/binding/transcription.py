"""Trajectories of a transcribed problem: their arrays, their linear systems, and steps from one to the next."""

from collections.abc import Callable, Mapping
from ctypes import byref
from functools import cache, cached_property
from threading import local
from typing import Any, NamedTuple, final
from weakref import ref

import numpy as np

from ...errors import InvalidInputError
from ..working_memory import aligned_array
from .library import BYTES, FLOAT, PLACE, address_of, best_instruction_set, library
from .problem_functions import CallbackFunction, Failure, FunctionName
from .structs import ARRAYS, LayoutStruct, ProblemStruct
from .tape_machine import MachineProgram

Function = MachineProgram | CallbackFunction  # of a problem

OPTIONAL = FunctionName.START_COST, FunctionName.END_COST  # functions that a problem may lack
KEPT_ROOM = 2**22  # numbers, 32 MiB: more are made anew, which takes no time beside their use


class _LastRoom(local):
    """The transcription that keeps memory for a search in this thread; no other one does."""

    of: Callable[[], "Transcription | None"] = staticmethod(lambda: None)


_last_room = _LastRoom()


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
    node_costs: int = 0  # 1 where each node at the end of a step has a cost, else 0

    @property
    def limits(self) -> int:
        """Number of inequalities of a step of one point."""
        return self.inequalities + self.node_inequalities


@final
class Scale(NamedTuple):
    """Scaling factors: of the unknowns of a step, shape ``(z,)``, of the nodes, ``(n,)``, and of the cost of a step."""

    unknowns: np.ndarray
    nodes: np.ndarray
    cost: float

    @property
    def copy(self) -> "Scale":
        """The sizes in arrays of their own."""
        return Scale(self.unknowns.copy(), self.nodes.copy(), self.cost)


@final
class Transcription:
    """A transcribed problem as the core has it, for one thread: its functions share registers.

    ``parts``: where the arrays of a trajectory stand; the first ``iterate_numbers`` determine all others.

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
        self.instruction_set = best_instruction_set() if instruction_set is None else instruction_set
        self.tableau, self.groups, self.control_groups = tableau, groups, control_groups
        self.kept, self.bounds = kept, bounds
        self._problem = ProblemStruct(*sizes, *self._addresses(), bounds, False)
        self._kept = list[object]()  # what C reads of the functions
        size = self._library.retrax_layout_memory(byref(self._problem))
        room = self._library.retrax_workspace(byref(self._problem))
        if not size or not room:
            raise InvalidInputError(
                f"the problem has {sizes}; expected sizes of at most 1024, 1 to 2^20 steps and at most 2^20 parameters"
            )
        self._set_functions()
        self._workspace_size = -(-room // BYTES)
        self._memory, self.layout = aligned_array(-(-size // BYTES)), LayoutStruct()
        place = address_of(self._memory, FLOAT, self._memory.shape, "memory of a layout")
        self._library.retrax_layout_make(byref(self._problem), place, byref(self.layout))
        firsts, counts = self.layout.first[:], self.layout.count[:]
        self.parts = {name: slice(firsts[k], firsts[k] + counts[k]) for name, k in array_places().items()}
        self.iterate_numbers = firsts[array_places()["POINT_CENTRES"]]
        self._room = aligned_array(1)

    def _addresses(self) -> tuple[Any, ...]:
        """The addresses of the arrays of the problem, for its struct."""
        sizes, (matrix, weights), s = self.sizes, self.tableau, self.sizes.points
        of_controls = self.control_groups or ()
        for groups in (*self.groups, *of_controls):
            if groups.size and not (groups.min() >= 0 and groups.max() < groups.size):
                raise InvalidInputError(f"columns of entries lie in 0 to {groups.size - 1}, got {groups}")
        return (
            address_of(matrix, FLOAT, (s, s), "matrix of a tableau"),
            address_of(weights, FLOAT, (s,), "weights of a tableau"),
            *(address_of(a, PLACE, (sizes.state_numbers,), "columns of the entries of a state") for a in self.groups),
            bool(of_controls),
            *(address_of(a, PLACE, (sizes.control_numbers,), "columns of controls") for a in of_controls),
            *(() if of_controls else (None, None)),
            address_of(self.kept, FLOAT, (sizes.limits,), "bounds that no iterate leaves"),
        )

    @cached_property
    def _workspace(self) -> np.ndarray:
        return aligned_array(self._workspace_size)

    @property
    def workspace(self) -> int:
        """The address of the workspace; one thread uses it at a time."""
        return address_of(self._workspace, FLOAT, self._workspace.shape, "workspace")

    @property
    def layout_memory(self) -> int:
        """The bytes of memory of a layout."""
        return self._library.retrax_layout_memory(byref(self._problem))

    def search_room(self, size: int) -> np.ndarray:
        """Numbers for the memory of a search.

        Unless they are many, the next search of this problem in this thread takes them too.
        """
        last = _last_room.of()
        if last is not None and last is not self:
            last._room = aligned_array(1)
        if size > KEPT_ROOM:
            return aligned_array(size)
        _last_room.of = ref(self)
        if len(self._room) < size:
            self._room = aligned_array(size)
        return self._room

    def trajectory(self) -> "Trajectory":
        """Return a trajectory, all of whose numbers are zero."""
        return Trajectory(self)

    def _set_functions(self) -> None:
        """Hand the functions of the problem to its struct."""
        points = (self.sizes.steps + 1) * self.sizes.points
        tapes = [program for program in self.programs.values() if isinstance(program, MachineProgram)]
        self._registers = aligned_array(max([1, *(own.sizes[2] * own.lanes(points) for own in tapes)]))
        for name in FunctionName:
            if name is not FunctionName.CONTROL_FRAMES or self.control_groups is not None:
                self._set_function(name, self.programs.get(name), points)

    def _set_function(
        self, name: FunctionName, function: MachineProgram | CallbackFunction | None, points: int
    ) -> None:
        problem, own = byref(self._problem), self._library
        sizes = own.retrax_function_inputs(problem, name), own.retrax_function_outputs(problem, name)
        if function is None:
            if any(sizes) and name not in OPTIONAL:
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
        self._problem.functions[name], context = function.as_function(
            self._registers, function.lanes(points), self.instruction_set
        )
        self._kept.append(context)


@final
class IterateNumbers(NamedTuple):
    """The given arrays and the unknowns of a trajectory, or of several: all from which the rest is evaluated."""

    numbers: np.ndarray
    parts: Mapping[str, slice]

    def array(self, name: str) -> np.ndarray:
        """The entries of an array, a view of shape ``(..., count)``."""
        return self.numbers[..., self.parts[name]]

    def copy(self) -> "IterateNumbers":
        """The iterate in memory of its own."""
        return self._replace(numbers=self.numbers.copy())


@final
class Trajectory:
    """The arrays of a trajectory; ``retrax_core.h`` names them."""

    def __init__(self, transcription: Transcription, numbers: np.ndarray | None = None) -> None:
        self._of, self._layout = transcription, transcription.layout
        if numbers is None:
            numbers = aligned_array(self._layout.numbers)
            numbers[...] = 0.0
        self._numbers = numbers

    def __getitem__(self, name: str) -> np.ndarray:
        """The entries of an array, a view of shape ``(count,)``."""
        return self._numbers[self._of.parts[name]]

    def __setitem__(self, name: str, entries: np.ndarray) -> None:
        self._numbers[self._of.parts[name]] = entries

    def take(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take entries of arrays by their names, of any shapes."""
        for name, array in arrays.items():
            self._numbers[self._of.parts[name]] = array.ravel()

    @property
    def iterate(self) -> IterateNumbers:
        """A copy of all that is given and of the unknowns, which come first."""
        return IterateNumbers(self._numbers[: self._of.iterate_numbers].copy(), self._of.parts)

    def set_iterate(self, iterate: IterateNumbers) -> None:
        """Take all that is given and the unknowns from an iterate."""
        self._numbers[: self._of.iterate_numbers] = iterate.numbers

    def copy_from(self, other: "Trajectory") -> None:
        """Copy all numbers of another trajectory of the same transcription."""
        self._numbers[...] = other._numbers

    def evaluate(self) -> None:
        """Evaluate the functions of the problem at the unknowns, and assemble the linear system."""
        own, here = self._of._library, (byref(self._layout), self._address)
        own.retrax_evaluate_trajectory(*here)
        if self._of.sizes.limits:
            own.retrax_add_inequalities(*here)
        own.retrax_assemble_system(*here, self._of.workspace, self._of.instruction_set)
        own.retrax_write_right_sides(*here)
        own.retrax_survey_trajectory(*here)
        self._of.failure.check()

    @property
    def _address(self) -> int:
        return address_of(self._numbers, FLOAT, self._numbers.shape, "numbers of a trajectory")


@cache
def array_places() -> dict[str, int]:
    """The places of the arrays of a trajectory in the core's list, by their names."""
    return {library().retrax_array_name(k).decode(): k for k in range(ARRAYS)}
