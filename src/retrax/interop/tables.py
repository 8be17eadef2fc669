"""Solutions, batches of them and trajectories as tables with names and units: xarray, pandas, CSV."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..integrators.boundary_value.solution.batch import Solutions
from ..integrators.boundary_value.solution.record import Solution
from ..integrators.problem.quantities import Quantity, with_unit
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError
from ..named_columns import About, View, raw_columns, view
from ..optional import require_package


def to_xarray(record: Any, problem: About = None) -> Any:
    """A solution, a batch of solutions or a trajectory as an ``xarray.Dataset`` with named dimensions and units.

    Parameters
    ----------
    record : Solution, Solutions, Trajectory or ClosedLoop
        The record.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold.

    Returns
    -------
    xarray.Dataset
        Variables by the names of the quantities.

    Raises
    ------
    InvalidInputError
        For another record.
    MissingPackageError
        Without xarray.

    Notes
    -----
    States, costates (``costate of NAME``) and multipliers of node constraints have the dimension ``time`` of the nodes.
    Controls, other multipliers and the Hamiltonian have the dimension ``stage_time``. A batch has ``member`` first,
    then ``node`` or ``stage``, with times for each member. Axes of an array are ``NAME_0``, ``NAME_1``; named entries
    are coordinates. A variable has the attribute ``units`` if all its entries have one unit.
    """
    xarray = require_package("xarray", "to_xarray")
    if isinstance(record, Solutions):
        datasets = [_index(xarray, member, problem, k) for k, member in enumerate(record)]
        if not datasets:
            raise InvalidInputError("the batch has no members, expected one or more")
        times = [name for name in ("time", "stage_time") if name in datasets[0].coords]
        how = {"coords": [*times, "member"], "data_vars": "all", "compat": "equals", "join": "exact"}
        return xarray.concat(datasets, dim="member", **how)
    return _dataset(xarray, record, problem)


def _dataset(xarray: Any, record: Any, problem: About) -> Any:
    found = view(record, problem)
    stamps = {"units": found.quantities.time} if found.quantities.time else {}
    coordinates: dict[str, Any] = {"time": ("time", found.times, stamps)}
    if found.controls or isinstance(record, Solution):
        coordinates["stage_time"] = ("stage_time", found.stage_times, stamps)
    variables: dict[str, Any] = {}
    for prefix, leaves, own, axis in _groups(found):
        for quantity, values in zip(own, leaves, strict=True):
            name = f"{prefix}{quantity.name}"
            dims = [axis, *(f"{quantity.name}_{k}" for k in range(values.ndim - 1))]
            variables[name] = (dims, values, {"units": quantity.unit} if quantity.unit and not prefix else {})
            if quantity.is_named:
                coordinates[dims[1]] = (dims[1], list(quantity.entries))
    made = xarray.Dataset(variables, coordinates)
    return _with_record(made, record, found) if isinstance(record, Solution) else made


def _with_record(made: Any, solution: Solution, found: View) -> Any:
    """The data set with what a solution has besides its states and controls."""
    made["hamiltonian"] = ("stage_time", solution.hamiltonians)
    for name, rows in solution.multipliers.items():
        along = ("stage_time",) if rows.ndim > 1 else ()
        made[f"multiplier of {name}"] = ((*along, f"{name}_0"), rows)
    for name, rows in solution.node_multipliers.items():
        made[f"multiplier of {name}"] = (("time", f"{name}_0"), rows)
    made.attrs = {"cost": solution.cost, "success": int(solution.success), "result": solution.result}
    if found.quantities.cost:
        made.attrs["cost_units"] = found.quantities.cost
    return made


def _index(xarray: Any, member: Solution, problem: About, k: int) -> Any:
    """A member of a batch, with its numbers as variables, and along nodes and stages, because its times are its own."""
    made = _dataset(xarray, member, problem).assign_coords(member=k)
    numbers = {name: made.attrs.pop(name) for name in ("cost", "success", "result")}
    made = made.reset_index(["time", "stage_time"]).rename_dims({"time": "node", "stage_time": "stage"})
    return made.assign({name: ((), value) for name, value in numbers.items()})


def _groups(found: View) -> Iterator[tuple[str, list[np.ndarray], Sequence[Quantity], str]]:
    yield "", found.states, found.quantities.states, "time"
    if found.costates:
        yield "costate of ", found.costates, found.quantities.states, "time"
    if found.controls:
        yield "", found.controls, found.quantities.controls, "stage_time"


def to_pandas(record: Any, at: Any = "nodes", problem: About = None) -> Any:
    """A record as a ``pandas.DataFrame`` with a row for each time and a column for each entry, such as ``body
    rate[1]``.

    Parameters
    ----------
    record : Solution, Solutions, Trajectory or ClosedLoop
        The record.
    at : {"nodes", "stages"} or array_like
        ``"nodes"``: states, costates and multipliers of node constraints. ``"stages"``: controls, and for a solution
        states, costates, other multipliers and the Hamiltonian. Times: a solution is interpolated there.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold.

    Returns
    -------
    pandas.DataFrame
        The table; ``frame.attrs["units"]`` has the units by column. ``Solutions`` have the ``member`` as the first
        level of the index.

    Raises
    ------
    InvalidInputError
        For another record or place.
    MissingPackageError
        Without pandas.
    """
    pandas = require_package("pandas", "to_pandas")
    if isinstance(record, Solutions):
        frames = {k: to_pandas(member, at, problem) for k, member in enumerate(record)}
        if not frames:
            raise InvalidInputError("the batch has no members, expected one or more")
        made = pandas.concat(frames, names=["member"])
        made.attrs = frames[0].attrs
        return made
    times, columns, units = _columns(record, at, problem)
    made = pandas.DataFrame(columns, index=pandas.Index(times, name="time"))
    made.attrs = {"units": units}
    return made


def to_csv(record: Any, path: str | Path, at: Any = "nodes", problem: About = None) -> None:
    """Write the table of ``to_pandas`` to a CSV file, with names and units such as ``body rate[1] [rad/s]`` in its
    head.

    Parameters
    ----------
    record : Solution, Solutions, Trajectory or ClosedLoop
        The record; ``InvalidInputError`` as ``to_pandas``.
    path : str or Path
        The file.
    at, problem
        As in ``to_pandas``.

    Notes
    -----
    Numbers have 17 digits, so that a reader gets the same numbers.
    """
    members = list(record) if isinstance(record, Solutions) else [record]
    tables = [_columns(member, at, problem) for member in members]
    if not tables:
        raise InvalidInputError("the batch has no members, expected one or more")
    units = tables[0][2]
    head = [with_unit(name, units[name]) for name in ("time", *tables[0][1])]
    batch = isinstance(record, Solutions)
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        file.write(",".join(_quote(word) for word in ["member"] * batch + head) + "\n")
        for k, (times, columns, _) in enumerate(tables):
            for row in np.stack([times, *columns.values()], axis=1):
                file.write(",".join([str(k)] * batch + [f"{value:.17g}" for value in row]) + "\n")


def _quote(word: str) -> str:
    return '"' + word.replace('"', '""') + '"' if set(',"\n') & set(word) else word


def _columns(record: Any, at: Any, problem: About) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, str]]:
    """Times, columns and their units."""
    found = view(record, problem)
    rows = _rows(record, found, at)
    columns, units = {}, {"time": found.quantities.time}
    for prefix, quantity, values in rows[1]:
        channel = raw_columns(quantity, values)
        is_real = channel.entries == quantity.entries
        names = quantity.columns if is_real else tuple(f"{quantity.name}[{entry}]" for entry in channel.entries)
        for k, (name, column) in enumerate(zip(names, channel.values.T, strict=True)):
            columns[f"{prefix}{name}"] = column
            units[f"{prefix}{name}"] = quantity.unit_of(k if is_real else 0) if not prefix else ""
    return rows[0], columns, units


def _rows(record: Any, found: View, at: Any) -> tuple[np.ndarray, list[tuple[str, Quantity, np.ndarray]]]:
    """The times, and for each array a prefix of its names, its quantity and its values."""
    own, controls = found.quantities.states, found.quantities.controls
    words = isinstance(at, str)
    if words and at == "nodes":
        more = _multipliers(record.node_multipliers) if isinstance(record, Solution) else []
        costates = _name_leaves("costate of ", own, found.costates) if found.costates else []
        return found.times, [*_name_leaves("", own, found.states), *costates, *more]
    if words and at == "stages" and not isinstance(record, Solution):
        return found.stage_times, _name_leaves("", controls, found.controls)
    if not isinstance(record, Solution) or (words and at != "stages"):
        expected = '"nodes", "stages"' + (" or times" if isinstance(record, Solution) else "")
        raise InvalidInputError(f"at must be {expected}, got {brief(at)}")
    if words:
        times, parts, more = (
            found.stage_times,
            (record.stage_states, record.stage_costates, record.controls),
            [_plain("hamiltonian", record.hamiltonians), *_multipliers(record.stage_multipliers)],
        )
    else:
        sample, more = record(np.ravel(at)), []
        times, parts = sample.times, (sample.states, sample.costates, sample.controls)
    states, costates, values = ([np.asarray(leaf) for leaf in jax.tree.leaves(part)] for part in parts)
    kept = [
        *_name_leaves("", own, states),
        *_name_leaves("costate of ", own, costates),
        *_name_leaves("", controls, values),
        *more,
    ]
    return times, kept


def _multipliers(multipliers: Mapping[str, np.ndarray]) -> list[tuple[str, Quantity, np.ndarray]]:
    """Multipliers as quantities."""
    return [_plain(f"multiplier of {name}", rows) for name, rows in multipliers.items()]


def _plain(name: str, rows: np.ndarray) -> tuple[str, Quantity, np.ndarray]:
    """Rows of numbers without a unit, or a number each, as a quantity."""
    entries = tuple(map(str, range(rows.shape[1]))) if rows.ndim > 1 else ("",)
    return "", Quantity(name, ("",), entries, ""), rows


def _name_leaves(
    prefix: str, own: Sequence[Quantity], leaves: Sequence[np.ndarray]
) -> list[tuple[str, Quantity, np.ndarray]]:
    return [(prefix, quantity, values) for quantity, values in zip(own, leaves, strict=True)]
