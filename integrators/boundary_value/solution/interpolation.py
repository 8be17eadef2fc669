"""An extremal between its nodes: the polynomials of its method in the charts of its steps."""

from functools import cached_property
from typing import Any, NamedTuple, Protocol, Self, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....manifolds import DomainError, InvalidInputError, Manifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.tolerances import EPS
from ....retractions import Retraction, default_retraction
from ....tracing import one_tracing
from ...problem.point_layout import PointLayout
from ...reporting.geometry_text import as_text, from_text
from ...reporting.text import brief
from ..guess import Guess
from ..transcription.chart import Chart, Polynomials, lagrange

SUMMED = 8 * EPS  # relative to the horizon, and for each step: what the sum of the steps loses


class Sample(NamedTuple):
    """States, controls and costates of an extremal at some times, which are along the leading axes of the arrays."""

    times: np.ndarray
    states: Any
    controls: Any
    costates: Any


class ExtremalArrays(Protocol):
    """The arrays of an extremal at nodes and stages, as ``Solution`` has them."""

    @property
    def times(self) -> np.ndarray: ...
    @property
    def states(self) -> Any: ...
    @property
    def costates(self) -> Any: ...
    @property
    def stage_times(self) -> np.ndarray: ...
    @property
    def stage_states(self) -> Any: ...
    @property
    def stage_costates(self) -> Any: ...
    @property
    def controls(self) -> Any: ...
    @property
    def stage_multipliers(self) -> dict[str, np.ndarray]: ...
    @property
    def node_multipliers(self) -> dict[str, np.ndarray]: ...
    @property
    def jumps(self) -> np.ndarray: ...


class _Steps(NamedTuple):
    """The N steps of an extremal, as flat points: nodes, and the s stages of each step."""

    begin: np.ndarray  # (N, E)
    end: np.ndarray
    begin_costates: np.ndarray
    end_costates: np.ndarray
    states: np.ndarray  # (N, s, E)
    costates: np.ndarray
    controls: np.ndarray  # (N, s, U)
    places: np.ndarray  # (s,)
    jumps: np.ndarray  # (N, 2): whether the covectors at the ends are those beyond a jump, seen from the step


@final
class Interpolant:
    """The interpolation of a method between the nodes of an extremal.

    The states of a step are a polynomial of time in the chart of the retraction around the step's centre, for ``s > 1``
    stages of degree ``s``, through both nodes and the points, which is the collocation polynomial; for one stage of
    degree 1, around the base point of the discretization map. The costates are, as covectors of that chart, a
    polynomial through those at the nodes and at the points. Both are continuous, and of order ``s + 1``, or that of the
    map [Hairer, Norsett, Wanner 1993, II.7]; but where a constraint at a node makes the costates jump, or the costs of
    all nodes do (``costs``), they are a polynomial through what is on this side of it, of one order less. The controls
    are the polynomial through those of the stages, of order ``s``, in a chart of their manifold.
    """

    def __init__(self, retraction: Retraction, controls: Manifold, costs: bool = False) -> None:
        if not (isinstance(retraction, Retraction) and isinstance(controls, Manifold)):
            raise InvalidInputError(
                "a solution is interpolated with a retraction and the manifold of the controls, got "
                f"{brief(retraction)} and {brief(controls)}; try those of its method and its problem"
            )
        self.retraction, self.controls, self.costs = retraction, controls, costs
        self.state, self.control = PointLayout.of(retraction.manifold), PointLayout.of(controls)

    def __reduce__(self) -> tuple[Any, ...]:
        """Without what is traced, which no other process could use."""
        return Interpolant, self._parts

    def __eq__(self, other: object) -> bool:
        """Whether the other interpolant has the same retraction and controls."""
        return isinstance(other, Interpolant) and bool(eqx.tree_equal(self._parts, other._parts))

    def __hash__(self) -> int:
        return hash(repr(self._parts))

    @property
    def _parts(self) -> tuple[Any, ...]:
        return self.retraction, self.controls, *([True] if self.costs else [])

    @property
    def text(self) -> str | None:
        """The text of the interpolant in a file; None unless classes of the library and numbers describe the
        interpolant."""
        return as_text(*self._parts)

    @classmethod
    def from_text(cls, text: str) -> Self:
        """The interpolant that wrote ``text``; raises ``InvalidInputError`` for another one."""
        found = from_text(text)
        if len(found) not in (2, 3):
            raise InvalidInputError(
                f"geometry has {len(found)} parts, expected a retraction and the manifold of the controls"
            )
        return cls(*found)

    def require_fits(self, what: str, states: Any, controls: Any) -> None:
        """Raise unless these are points of its manifolds, along a leading axis."""
        for name, layout, given in (("states", self.state, states), ("controls", self.control, controls)):
            if layout.fits(given, 1):
                continue
            manifold = self.retraction.manifold if name == "states" else self.controls
            expected = jax.tree.map(lambda s: s.shape, manifold.ambient)
            got = jax.tree.map(lambda a: np.shape(a)[1:], given)
            if expected != got:
                raise InvalidInputError(
                    f"{what}{name} have the shapes {got} each, expected {expected}, those of {manifold}"
                )
            raise InvalidInputError(f"{what}{name} are complex, expected real numbers, those of {manifold}")

    def along(self, record: ExtremalArrays) -> "Interpolation":
        """The interpolation of an extremal."""
        return Interpolation(self, record)

    @property
    def functions(self) -> dict[str, PointwiseFunction]:
        """The functions of the interpolation by their names, for programs that are exported."""
        return {**self.chart.functions, "control_offset": self._offset, "control_moved": self._control_point}

    @property
    def layouts(self) -> tuple[PointLayout, PointLayout, PointLayout]:
        """The layouts of states, costates and controls."""
        return self.state, self.state, self.control

    def control_offsets(self, bases: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """Coordinates of controls in charts around other controls, all flat, shape (N, s, m)."""
        return self._offset.at(2, bases, controls)[0]

    def control_points(self, bases: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """The controls with some coordinates in charts around other controls, all flat, shape (K, U)."""
        return self._control_point.at(1, bases, offsets)[0]

    def apart(self, bases: np.ndarray, states: np.ndarray) -> np.ndarray:
        """The tangent vectors at points ``bases`` whose retractions are the states, all flat, shape (K, E)."""
        return self._apart.at(1, bases, states)[0]

    def move_controls(self, controls: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """The controls moved by ambient vectors, all flat, shape (K, U)."""
        return self._control_move.at(1, controls, turns)[0]

    @cached_property
    def chart(self) -> Chart:
        """The charts of the retraction."""
        return Chart(self.retraction, AutomaticEvaluator())

    @cached_property
    def _offset(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._offset_of, self.control.size, self.control.size)

    @cached_property
    def _control_point(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._control_point_of, self.control.size, self.controls.dimension)

    @cached_property
    def _apart(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._apart_of, self.state.size, self.state.size)

    @cached_property
    def _control_move(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._control_move_of, self.control.size, self.control.size)

    def _apart_of(self, base: Array, state: Array) -> tuple[Array]:
        point = self.state.point(base)
        return (self.state.flat(self.retraction.preimage(point, self.state.point(state))),)

    def _control_move_of(self, control: Array, turn: Array) -> tuple[Array]:
        u = self.control.point(control)
        moved = default_retraction(self.controls)(u, self.controls.projection(u, self.control.point(turn)))
        return (self.control.flat(moved),)

    def _offset_of(self, base: Array, control: Array) -> tuple[Array]:
        u = self.control.point(base)
        v = default_retraction(self.controls).preimage(u, self.control.point(control))
        return (vec.components(self.controls.basis(u), v),)

    def _control_point_of(self, base: Array, offset: Array) -> tuple[Array]:
        u, turn = self.control.point(base), default_retraction(self.controls)
        return (self.control.flat(turn.chart(u, turn.frame(u), offset)),)


@final
class Interpolation:
    """An extremal between its nodes: the polynomials of all steps, each computed once, when it is first needed."""

    def __init__(self, interpolant: Interpolant, record: ExtremalArrays) -> None:
        self.interpolant, self.times, self.stage_times = interpolant, record.times, record.stage_times
        self._multipliers = record.stage_multipliers, record.node_multipliers
        self._steps = _steps(interpolant, record)

    def __call__(self, t: Any) -> Sample:
        """The extremal at a time, or at an array of times.

        Raises ``InvalidInputError`` for a time outside the horizon, ``DomainError`` where a step does not fit into a
        chart.
        """
        times = checked_times(t, self.times)
        flat = times.ravel()
        k = np.clip(np.searchsorted(self.times, flat, side="right") - 1, 0, len(self.times) - 2)
        states, costates, controls = self._evaluate(k, (flat - self.times[k]) / np.diff(self.times)[k])
        lost = ~np.all(np.isfinite(np.concatenate([states, costates, controls], axis=1)), axis=1)
        if np.any(lost):
            raise DomainError(
                f"the step of the solution at t = {flat[lost][0]:.6g} does not fit into one chart of its retraction, "
                "and has no polynomial there; try more steps, or a retraction with a larger image"
            )
        rows = (a.reshape(*times.shape, a.shape[1]) for a in (states, costates, controls))
        q, p, u = (layout.points(a) for layout, a in zip(self.interpolant.layouts, rows, strict=True))
        return Sample(times, q, u, p)

    def guess(self, times: np.ndarray, stage_times: np.ndarray) -> Guess:
        """The extremal at times of nodes and of stages."""
        every = self(np.minimum(np.concatenate([times, stage_times]), self.times[-1]))
        nodes, stages = (vec.taken(every, part) for part in (slice(len(times)), slice(len(times), None)))
        at_stages, at_nodes = self._multipliers
        multipliers = {name: _along(stage_times, self.stage_times, rows) for name, rows in at_stages.items()}
        before, after = _shares(self.times), _shares(times)
        jumps = {name: after * _along(times, self.times, rows / before) for name, rows in at_nodes.items()}
        return Guess(stages.states, stages.controls, nodes.costates, nodes.states, stages.costates, multipliers, jumps)

    def within(self, places: np.ndarray, costates: bool = True) -> Sample:
        """The extremal at some places of every step, fractions of it, shape ``(N, j)``; at its ends with its own
        controls.

        Entries are NaN where a step does not fit into a chart. Without costates these are None.
        """
        count = len(self.times) - 1
        each, at = np.repeat(np.arange(count), len(places)), np.tile(places, count)
        q, p, u = (
            layout.points(a.reshape(count, len(places), -1)) if len(a) else None
            for layout, a in zip(self.interpolant.layouts, self._evaluate(each, at, costates), strict=True)
        )
        return Sample(self.times[each].reshape(count, -1) + np.outer(np.diff(self.times), places), q, u, p)

    def _evaluate(
        self, k: np.ndarray, places: np.ndarray, costates: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Flat states, costates and controls in the steps ``k``, at fractions ``places`` of them.

        There is an empty array instead of the costates unless these are asked for.
        """
        chart, (through, centres, coordinates), controls = self.interpolant.chart, self.states, self.controls
        with one_tracing(), np.errstate(all="ignore"):
            shares, covectors = lagrange(through, places), np.zeros(0)
            c = np.einsum("tj,tjn->tn", shares, coordinates[k])
            states = chart.points(centres[k], c)
            if costates:
                momentum = np.einsum("tj,tjn->tn", shares, self._momenta[k])
                covectors = chart.pushforward(centres[k], c, momentum)
            offset = np.einsum("tj,tjm->tm", lagrange(controls.places, places), controls.coordinates[k])
            return states, covectors, self.interpolant.control_points(controls.centres[k], offset)

    @cached_property
    def states(self) -> Polynomials:
        """The polynomials of the states; entries are NaN where a step does not fit into a chart."""
        steps, chart = self._steps, self.interpolant.chart
        with one_tracing(), np.errstate(all="ignore"):
            if len(steps.places) > 1:
                return chart.polynomials(steps.places, steps.begin, steps.states, steps.end)
            centres = steps.states[:, 0]  # the base point of a discretization map, which may be at a node
            coordinates = chart.coordinates(centres[:, None], np.stack([steps.begin, steps.end], axis=1))
            return Polynomials(np.array([0.0, 1.0]), centres, coordinates)

    @cached_property
    def controls(self) -> Polynomials:
        """The polynomials of the controls, in charts of the default retraction of their manifold."""
        bases = self._steps.controls[:, 0]
        with one_tracing(), np.errstate(all="ignore"):
            offsets = self.interpolant.control_offsets(bases[:, None], self._steps.controls)
        return Polynomials(self._steps.places, bases, offsets)

    @cached_property
    def _momenta(self) -> np.ndarray:
        """The covectors of the charts of the steps at the places through which their polynomials go."""
        steps, (_, centres, coordinates) = self._steps, self.states
        inner = () if len(steps.places) == 1 else np.moveaxis(steps.costates[:, steps.places < 1.0], 1, 0)
        covectors = np.stack([steps.begin_costates, *inner, steps.end_costates], axis=1)
        momenta = self.interpolant.chart.pullback(centres[:, None], coordinates, covectors)
        return self._on_this_side(momenta) if np.any(steps.jumps) else momenta

    def _on_this_side(self, momenta: np.ndarray) -> np.ndarray:
        """The momenta at the places of steps, at a jump from the polynomial through the remaining momenta."""
        steps, (through, centres, _), extrapolated = self._steps, self.states, np.array(momenta)
        one = len(through) == 2
        if one:  # the stage has the covector theta p_0 + (1 - theta) p_1
            middle = self.interpolant.chart.pullback(centres, np.zeros_like(momenta[:, 0]), steps.costates[:, 0])
            momenta = np.stack([momenta[:, 0], middle, momenta[:, 1]], axis=1)
        for first, last in ((1, 0), (0, 1), (1, 1)):
            which, kept = np.all(steps.jumps == (first, last), axis=1), slice(first, momenta.shape[1] - last)
            if one:
                place = 1 - steps.places[0]
                place = 0.5 if place == first else place  # as the only covector that is left
                through = np.array([0.0, place, 1.0])
            for place, end in ((0, 0.0), (-1, 1.0)):
                if (first, last)[place]:
                    shares = lagrange(through[kept], np.array([end]))[0]
                    extrapolated[which, place] = np.einsum("j,kjn->kn", shares, momenta[which, kept])
        return extrapolated


def _steps(interpolant: Interpolant, record: ExtremalArrays) -> _Steps:
    """The steps of an extremal."""
    state, _, control = interpolant.layouts
    nodes, points, at_nodes, at_points = (
        state.rows(part, 1) for part in (record.states, record.stage_states, record.costates, record.stage_costates)
    )
    steps = np.diff(record.times)
    longest = np.argmax(steps)
    places = (record.stage_times.reshape(len(steps), -1)[longest] - record.times[longest]) / steps[longest]
    shape = len(steps), len(places), -1
    stages = points.reshape(shape), at_points.reshape(shape), control.rows(record.controls, 1).reshape(shape)
    jumps = np.stack([record.jumps[:-1] & (np.arange(len(steps)) == 0), record.jumps[1:] | interpolant.costs], axis=1)
    return _Steps(nodes[:-1], nodes[1:], at_nodes[:-1], at_nodes[1:], *stages, places, jumps)


def _shares(times: np.ndarray) -> np.ndarray:
    """The length of the step that ends at each node, for the first one that begins there, as a column."""
    steps = np.diff(times)
    return np.concatenate([steps[:1], steps])[:, None]


def _along(times: np.ndarray, known: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Multipliers at some times, linear between the known times; a multiplier of the first point alone stays there."""
    interpolated = np.stack([np.interp(times, known, column) for column in rows.T], axis=1)
    if not np.any(rows[1:]):
        interpolated[0] = rows[0]
    return interpolated


def checked_times(t: Any, times: np.ndarray) -> np.ndarray:
    """Times of an extremal as an array; raises ``InvalidInputError`` for what is none."""
    given = np.asarray(t)
    if given.size == 0 or given.dtype.kind not in "fiu" or not np.all(np.isfinite(given)):
        raise InvalidInputError(f"the time must be a finite real number, or an array of them, got {brief(t)}")
    first, last = float(times[0]), float(times[-1])
    slack = SUMMED * len(times) * max(abs(first), abs(last))
    outside = (given < first - slack) | (given > last + slack)
    if np.any(outside):
        raise InvalidInputError(
            f"the time {float(given[outside].flat[0]):.10g} is outside the horizon of the solution, expected one in "
            f"[{first:.10g}, {last:.10g}]"
        )
    return np.clip(given.astype(float), first, last)
