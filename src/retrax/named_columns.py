"""The arrays of a record as real columns with names and units: what pictures draw, and what tables hold."""

import re
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from .integrators.boundary_value.solution.record import Solution
from .integrators.closed_loop.record import ClosedLoop
from .integrators.initial_value.trajectory import Trajectory
from .integrators.problem.optimal_control_problem import OptimalControlProblem
from .integrators.problem.quantities import Quantities, Quantity, with_unit
from .integrators.reporting.text import brief
from .manifolds import Euclidean, InvalidInputError, Manifold

ROTATIONS, POSES, SPHERE = ("SO(2)", "SO(3)"), ("SE(2)", "SE(3)"), "Sphere(2)"
BODY = ("SO(3)", "SE(3)")
RADIANS = re.compile(r"^rad(?![\w^*])")  # units of angles, their rates and accelerations
MOST_JOINED = 3  # names of entries that make the name of their array
SAME = 1e-6  # of a step: rounding of its times
About = OptimalControlProblem | Manifold | None  # what has the names, or at least the spaces, of the arrays of a record


class NamedColumn(NamedTuple):
    """A history: its name, the names and units of its entries, its values, shape ``(N, k)``, and their bounds."""

    name: str
    entries: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    bounds: tuple[tuple[float, float], ...] = ()

    @property
    def unit(self) -> str:
        """The unit of all entries; empty where they have several, or none."""
        return self.units[0] if len(set(self.units)) == 1 else ""

    @property
    def title(self) -> str:
        """The name with the unit of all entries."""
        return with_unit(self.name, self.unit)

    @property
    def labels(self) -> list[str]:
        """The names of the entries, with their units if these differ.

        Three entries without names and with one unit are x, y, z; a single entry has an empty name.
        """
        if self.entries == ("0",):
            return [""]
        if self.entries == ("0", "1", "2") and len(set(self.units)) == 1:
            return list("xyz")
        units = self.units if len(self.units) > 1 and not self.unit else [""] * len(self.entries)
        return [with_unit(*pair) for pair in zip(self.entries, units, strict=True)]

    @property
    def in_degrees(self) -> "NamedColumn":
        """The history with its angles and rates of angles in degrees."""
        is_angle = [bool(RADIANS.match(unit)) for unit in self.units]
        factors = np.where(np.broadcast_to(is_angle, len(self.entries)), np.degrees(1.0), 1.0)
        bounds = tuple((low * factor, high * factor) for (low, high), factor in zip(self.bounds, factors, strict=False))
        units = tuple(RADIANS.sub("deg", unit) for unit in self.units)
        return self._replace(units=units, values=self.values * factors, bounds=bounds)


class View(NamedTuple):
    """Times, states and costates at the nodes, and controls at the stages, of a record, array by array.

    ``stage_times`` and ``controls`` have one leading axis, that of all stages; ``controls`` is empty where there are
    none, and ``costates`` too. ``is_held``: each step has one control, which holds along it.
    """

    times: np.ndarray
    states: list[np.ndarray]
    costates: list[np.ndarray]
    stage_times: np.ndarray
    controls: list[np.ndarray]
    quantities: Quantities
    is_held: bool = False

    def only(self, array: int) -> "View":
        """The view of one array of the state."""
        own = replace(self.quantities, states=self.quantities.states[array : array + 1])
        return self._replace(states=self.states[array : array + 1], quantities=own)


def view(record: Any, problem: About = None) -> View:
    """The arrays of a ``Solution``, a ``Trajectory`` or a ``ClosedLoop``, of which ``problem`` has the names and
    units, or a manifold the spaces.

    Raises ``InvalidInputError`` for anything else, for a batch of trajectories, and if the problem is one of other
    arrays.
    """
    if isinstance(record, Solution):
        states, costates = map(_leaves, (record.states, record.costates))
        controls = [leaf for leaf in _leaves(record.controls) if leaf.size]
        given = record.quantities if problem is None else problem
        quantities, is_held = _quantities(given, states, controls), len(record.stage_times) == record.steps
        found = View(record.times, states, costates, record.stage_times, controls, quantities, is_held)
    elif isinstance(record, ClosedLoop):
        states, controls = map(_leaves, (record.states, record.controls))
        quantities = _quantities(record.quantities if problem is None else problem, states, controls)
        found = View(record.times, states, [], record.stage_times, controls, quantities, record.is_held)
    elif isinstance(record, Trajectory) and np.ndim(record.times) == 1:
        states, costates, stages = _leaves(record.q), _leaves(record.p), np.asarray(record.stage_times)
        controls = [a.reshape(-1, *a.shape[stages.ndim :]) for a in _leaves(record.controls)]
        quantities = _quantities(problem, states, controls)
        times = np.asarray(record.times)
        found = View(times, states, costates, stages.ravel(), controls, quantities, _is_held(times, stages))
    else:
        raise InvalidInputError(
            f"expected a Solution, a Trajectory or a ClosedLoop, got {brief(record)}; try one member of a batch, "
            "record[0], or one of the phases, record.phases[0]"
        )
    found.quantities.require_fits("", tuple(found.states), tuple(found.controls or _nothing(found.quantities)))
    return found


def _is_held(times: np.ndarray, stages: np.ndarray) -> bool:
    """Whether a trajectory has one control from each node to the next, with its stage before or at the middle of a
    step."""
    return stages.size == len(times) - 1 and bool(np.all(stages.ravel() - times[:-1] <= (0.5 + SAME) * np.diff(times)))


def _leaves(tree: Any) -> list[np.ndarray]:
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def _nothing(quantities: Quantities) -> list[np.ndarray]:
    """Controls with as many entries as there are names for them."""
    return [np.zeros((1, len(quantity.entries))) for quantity in quantities.controls]


def _quantities(given: Any, states: list[np.ndarray], controls: list[np.ndarray]) -> Quantities:
    """The known quantities, of a problem or of a manifold, or unnamed quantities."""
    unnamed = Quantities.unnamed([a.shape[1:] for a in states], [a.shape[1:] for a in controls])
    if isinstance(given, Manifold):
        return replace(unnamed, states=Quantities.of(given, Euclidean(1), None, None).states)
    if isinstance(given, OptimalControlProblem):
        return given.quantities
    if given is None or isinstance(given, Quantities):
        return given or unnamed
    raise InvalidInputError(
        f"problem must be an OptimalControlProblem or a Manifold, got {brief(given)}; try SO(3) * Euclidean(3)"
    )


def state_columns(found: View) -> list[NamedColumn]:
    """The states as pictures show them: rotations as rotation vectors, poses as these and positions, else the
    entries."""
    pairs = zip(found.quantities.states, found.states, strict=True)
    return [channel for quantity, values in pairs for channel in _columns(quantity, values)]


def control_columns(found: View) -> list[NamedColumn]:
    """The controls as pictures show them."""
    pairs = zip(found.quantities.controls, found.controls, strict=bool(found.controls))
    return [channel for quantity, values in pairs for channel in _columns(quantity, values)]


def _columns(quantity: Quantity, values: np.ndarray) -> list[NamedColumn]:
    if quantity.space in ROTATIONS:
        return [_turn(quantity.name, values)]
    if quantity.space in POSES:
        n = values.shape[1] - 1
        place = NamedColumn(f"{quantity.name}, position", tuple("xyz"[:n]), quantity.units[:1], values[:, :n, n])
        return [_turn(quantity.name, values[:, :n, :n]), place]
    return [raw_columns(quantity, values)]


def raw_columns(quantity: Quantity, values: np.ndarray) -> NamedColumn:
    """The entries of an array as they are, with real and imaginary parts of complex entries."""
    rows: Any = values.reshape(len(values), -1)
    entries = quantity.entries
    if np.iscomplexobj(rows):
        entries = tuple(f"{part} {entry}" for entry in entries for part in ("Re", "Im"))
        rows = np.stack([rows.real, rows.imag], axis=2).reshape(len(rows), -1)
        return NamedColumn(quantity.name, entries, quantity.units[:1], rows)
    name = join_names(entries) if quantity.is_named else quantity.name
    return NamedColumn(name, entries, quantity.units, rows, quantity.bounds)


def join_names(entries: tuple[str, ...]) -> str:
    """The name of an array whose entries have names: the names of at most three entries, or the first and the last."""
    return ", ".join(entries) if len(entries) <= MOST_JOINED else f"{entries[0]}, ..., {entries[-1]}"


def _turn(name: str, matrices: np.ndarray) -> NamedColumn:
    """Rotations as angles, or as rotation vectors, which turn on beyond half a turn."""
    if matrices.shape[1] == 2:
        angles = np.unwrap(np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0]))
        return NamedColumn(f"{name}, angle", ("",), ("rad",), angles[:, None])
    return NamedColumn(f"{name}, rotation vector", tuple("xyz"), ("rad",), rotation_vectors(matrices))


def rotation_vectors(matrices: np.ndarray) -> np.ndarray:
    """Rotation vectors of a sequence of rotations, shape ``(N, 3, 3)``, in rad, that follow each other without a jump.

    Each is the one nearest to the one before, of all that turn about its axis by its angle and whole turns.
    ``exp(hat(v)) = R``.
    """
    found = Rotation.from_matrix(matrices).as_rotvec()
    for k in range(1, len(found)):
        angle, before = np.linalg.norm(found[k]), found[k - 1]
        far = np.linalg.norm(before)
        axis = found[k] / angle if angle > 0 else before / far if far > 0 else before
        found[k] = axis * (angle + 2 * np.pi * np.round((before @ axis - angle) / (2 * np.pi)))
    return found


def rotations(found: View, array: int | None = None) -> np.ndarray:
    """The attitudes of a record, shape ``(N, 3, 3)``: of the array at a place, or of the first that has a rotation."""
    return attitude_of(found, array)[1]


def attitude_of(found: View, array: int | None = None) -> tuple[str, np.ndarray]:
    """The name and the attitudes of the array at a place, or of the first that has a rotation.

    Raises ``InvalidInputError`` where it has none.
    """
    spaces = [quantity.space for quantity in found.quantities.states]
    chosen = range(len(spaces)) if array is None else [array]
    for place in chosen:
        if place in range(len(spaces)) and spaces[place] in BODY:
            return found.quantities.states[place].name, found.states[place][:, :3, :3]
    what = "no array" if array is None else f"no array {array}"
    raise InvalidInputError(
        f"the record has {what} of states on SO(3) or SE(3), it has "
        f"{', '.join(space or 'unknown' for space in spaces)}; try a solution of a problem on SO(3) * Euclidean(3), or "
        "problem= for a trajectory"
    )
