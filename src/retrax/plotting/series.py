"""Records as they are drawn: solutions between their nodes by the polynomials of their methods."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import jax
import numpy as np

from ..integrators.boundary_value.solution.batch import Solutions
from ..integrators.boundary_value.solution.multiphase_solution import PhasedSolution
from ..integrators.boundary_value.solution.record import Solution
from ..manifolds import InvalidInputError
from ..named_columns import About, NamedColumn, View, control_columns, state_columns, view

CURVE_POINTS = 400  # of a curve, or two of a step


class History(NamedTuple):
    """A channel against time; a held one is constant from each time to the next."""

    times: np.ndarray
    channel: NamedColumn
    is_held: bool = False


Panel = list[list[History]]  # of each record


class PictureSeries(NamedTuple):
    """Records of a picture: their names, their views, several for phases with different arrays, and where phases
    meet."""

    names: list[str]
    parts: list[list[View]]
    borders: list[float]

    @property
    def time(self) -> str:
        """The unit of the time."""
        return self.parts[0][0].quantities.time


def picture_series(record: Any, problem: About = None) -> PictureSeries:
    """The views of one record, of the members of a batch, or of the records of a list or a dictionary with their
    names."""
    names, records = names_and_records(record)
    ends = [record.times[1:-1].tolist() for record in records if isinstance(record, PhasedSolution)]
    return PictureSeries(
        names, [_parts(record, problem) for record in records], sorted({t for each in ends for t in each})
    )


def names_and_records(record: Any) -> tuple[list[str], list[Any]]:
    """The names of records and the records: of one record and of the members of a batch the names are empty."""
    if isinstance(record, Mapping):
        names, records = [str(name) for name in record], list(record.values())
    elif isinstance(record, Solutions) or (type(record) in (list, tuple)):
        records = list(record)
        names = [""] * len(records) if isinstance(record, Solutions) else list(map(str, range(len(records))))
    else:
        names, records = [""], [record]
    if not records:
        raise InvalidInputError("there is no record to draw, got an empty collection; try a Solution")
    return names, records


def view_of(record: Any, problem: About = None) -> View:
    """The view of a solution or a trajectory as it is drawn.

    States are those between the nodes of a solution. Controls are given from the beginning of each step to its end,
    where those of the next may be others, within their bounds; one control of a step holds along it. A trajectory is
    drawn at its nodes, and so is a solution that has no polynomials, or a step that does not fit into a chart.
    """
    found = view(record, problem)
    if isinstance(record, Solution) and record.interpolant is not None:
        found = _between_nodes(record, found)
    if not found.is_held or not found.controls or len(found.stage_times) == len(found.times):
        return found
    own = view(record, problem)
    held = [np.concatenate([values, values[-1:]]) for values in own.controls]
    return found._replace(stage_times=own.times, controls=held)


def of_states(found: View) -> list[History]:
    """The histories of the states of a view."""
    return [History(found.times, channel) for channel in state_columns(found)]


def of_controls(found: View) -> list[History]:
    """The histories of the controls of a view."""
    return [History(found.stage_times, channel, found.is_held) for channel in control_columns(found)]


def panels_of(every: PictureSeries, histories: Callable[[View], list[History]], degrees: bool) -> list[Panel]:
    """A panel for each title among these histories, with the histories of each record."""
    panels: dict[str, Panel] = {}
    for place, parts in enumerate(every.parts):
        for found in (found for part in parts for found in histories(part)):
            own = found._replace(channel=found.channel.in_degrees) if degrees else found
            panels.setdefault(own.channel.title, [[] for _ in every.parts])[place].append(own)
    return list(panels.values())


def as_one(panels: list[Panel]) -> Panel:
    """All histories in one panel."""
    return [[history for own in rows for history in own] for rows in zip(*panels, strict=True)]


def every_panel(every: PictureSeries, degrees: bool) -> list[Panel]:
    """The panels of the states, then the panels of the controls."""
    return panels_of(every, of_states, degrees) + panels_of(every, of_controls, degrees)


def _parts(record: Any, problem: About) -> list[View]:
    """The views of a record: phases with the same arrays are one."""
    if not isinstance(record, PhasedSolution):
        return [view_of(record, problem)]
    views = [view_of(phase, problem) for phase in record.phases]
    runs = groupby(views, key=lambda found: (found.quantities, found.is_held))
    return [_join(list(run)) for _, run in runs]


def _join(views: Sequence[View]) -> View:
    """One view of views that follow each other."""

    def along(name: str) -> Any:
        return np.concatenate([getattr(each, name) for each in views])

    def leaves(name: str) -> list[np.ndarray]:
        return [np.concatenate(rows) for rows in zip(*(getattr(each, name) for each in views), strict=True)]

    times, stages = along("times"), along("stage_times")
    states, costates, controls = (leaves(name) for name in ("states", "costates", "controls"))
    return View(times, states, costates, stages, controls, views[0].quantities, views[0].is_held)


def _between_nodes(record: Solution, found: View) -> View:
    """The view at many places of each step; at the nodes where a step does not fit into a chart."""
    places = np.linspace(0.0, 1.0, 1 + max(2, CURVE_POINTS // record.steps))
    sample = record._between_nodes.within(places, costates=False)
    states, controls = (list(map(np.asarray, jax.tree.leaves(tree))) for tree in (sample.states, sample.controls))
    if not all(np.all(np.isfinite(leaf)) for leaf in (*states, *controls)):
        return found
    states = [leaf.reshape(-1, *leaf.shape[2:]) for leaf in states]
    smooth = found._replace(times=sample.times.ravel(), states=states)
    if found.is_held or not found.controls:
        return smooth
    rows = zip(controls, found.controls, found.quantities.controls, strict=True)
    within = list(_within_bounds(record.steps, rows))
    return smooth._replace(stage_times=sample.times.ravel(), controls=within)


def _within_bounds(steps: int, rows: Any) -> Iterator[np.ndarray]:
    """Controls between the stages, clipped to the range of their bounds and stages.

    A polynomial through controls within their bounds may leave the bounds.
    """
    for between, at_stages, quantity in rows:
        flat, stages = between.reshape(*between.shape[:2], -1), at_stages.reshape(steps, len(at_stages) // steps, -1)
        if quantity.bounds:
            lower, upper = np.array(quantity.bounds).T
            least, most = stages.min(axis=1, keepdims=True), stages.max(axis=1, keepdims=True)
            flat = np.clip(flat, np.minimum(lower, least), np.maximum(upper, most))
        yield flat.reshape(-1, *between.shape[2:])
