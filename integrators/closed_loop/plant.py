"""The motion of a plant under given controls, and the controls that act on it."""

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any, NamedTuple, final

import jax
import numpy as np

from ...manifolds import DomainError, Euclidean, InvalidInputError
from ...manifolds.numerics.ambient import Ambient
from ...retractions import default_retraction
from ..boundary_value.inputs.arguments import ALONG, BETWEEN, structure_of
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.point_layout import PointLayout, parameter_layout
from ..problem_checks.requirements import require_treated
from ..stages.explicit_runge_kutta import ExplicitRungeKutta, dop853


class Signal(NamedTuple):
    """A control as a function of time, of one time or an array of times, and the times at which it is not smooth."""

    function: Callable[[Any], Any]
    breaks: np.ndarray

    def __call__(self, t: Any) -> Any:
        return self.function(t)

    @classmethod
    def constant(cls, control: Any) -> "Signal":
        """A control that is held."""
        return cls(
            lambda t: jax.tree.map(lambda leaf: np.broadcast_to(leaf, (*np.shape(t), *np.shape(leaf))), control),
            np.zeros(0),
        )


ACCURACY = 1e-9  # of the motion between two samples, relative to the largest entries of each array of the state
LEAST_ACCURACY = 1e-6  # the same where more substeps no longer help
MOST_SUBSTEPS = 512  # between two samples
END_MARGIN = 1e-9  # of a span: by how much the times at its ends are moved inside, where a control may jump at the ends


@final
class Plant:
    """The motion of the states of a problem under given controls, by the method of Dormand and Prince of order 8.

    The method is explicit: controls are given and smooth between samples, so that a step needs no iteration, and order
    8 reaches ``ACCURACY`` in few steps. The number of substeps is doubled until it is reached, and kept.
    """

    def __init__(self, problem: OptimalControlProblem) -> None:
        self.problem, self.substeps = problem, 1
        self._state, self._control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self._methods: dict[Any, ExplicitRungeKutta] = {}
        self._largest = np.zeros(len(self._state.shapes))

    def advance(self, q: Ambient, signal: Signal, begin: float, end: float, parameters: Any = None) -> Ambient:
        """The state at a time from a state at another one; ``DomainError`` if it cannot be computed."""
        layout = None if parameters is None else parameter_layout(parameters)
        values = np.zeros(0) if layout is None else layout.rows(parameters, 0)
        method = self._method(structure_of(parameters), layout)
        row, span = self._state.rows(q, 0), (begin, end)
        coarse = self._integrate(method, row, signal, span, values)
        while True:
            fine = self._integrate(method, row, signal, span, values, 2)
            error = self._error(coarse, fine)
            if error <= ACCURACY:
                return self._state.points(fine)
            if self.substeps >= MOST_SUBSTEPS:
                break
            self.substeps, coarse = 2 * self.substeps, fine
        if not error <= LEAST_ACCURACY:
            raise DomainError(
                f"the plant cannot be integrated from {begin:.6g} to {end:.6g}: with {MOST_SUBSTEPS} substeps of an "
                f"explicit method the relative error is {error:.1g}, expected {ACCURACY:.0e}; the dynamics are stiff, "
                "discontinuous, or not finite; try a shorter sample time"
            )
        return self._state.points(fine)

    def _method(self, structure: Any, layout: PointLayout | None) -> ExplicitRungeKutta:
        if structure not in self._methods:
            require_treated(self.problem, "a simulation", *ALONG, *BETWEEN)
            retraction = default_retraction(self.problem.manifold)
            self._methods[structure] = ExplicitRungeKutta(self.problem, retraction, dop853(), layout)
        return self._methods[structure]

    def _integrate(
        self, method: ExplicitRungeKutta, row: np.ndarray, signal: Signal, span: tuple[float, float],
        parameters: np.ndarray, refined: int = 1,
    ) -> np.ndarray:  # fmt: skip
        """The flat state at the end of a span."""
        count, (begin, end), places = refined * self.substeps, span, method.tableau.nodes
        h, q, at = (end - begin) / count, row[None], {place: k for k, place in enumerate(places)}
        rest, turn = np.zeros((1, self.problem.manifold.dimension)), np.zeros((1, self.problem.controls.dimension))
        times = begin + h * np.arange(count)
        margin = END_MARGIN * (end - begin)
        inside = np.clip(times[:, None] + h * places, begin + margin, end - margin)
        controls = self._control.rows(signal(inside), 2)
        with np.errstate(all="ignore"):  # the error is NaN where the state is not finite
            for t, control in zip(times, controls, strict=True):
                step = np.array([[t]]), np.array([[h]])
                c = method.step(q, rest, *step, lambda place, u=control: (u[at[place]][None], turn), parameters[None])
                q = method.points(q, c)
        return q[0]

    def _error(self, coarse: np.ndarray, fine: np.ndarray) -> float:
        """The difference relative to the largest entries that each array of the state has had."""
        sizes = np.array([np.max(np.abs(fine[place]), initial=0.0) for place in self._state.places])
        self._largest = np.fmax(self._largest, np.where(np.isfinite(sizes), sizes, 0.0))
        apart = [np.max(np.abs(coarse - fine)[place], initial=0.0) for place in self._state.places]
        scales = np.where(self._largest > 0, self._largest, 1.0)
        return float(np.max(apart / scales))


@final
class SentControls:
    """The controls that were sent to a plant: each acts from its time until the next one does."""

    def __init__(self, idle: Any) -> None:
        self._acting: list[tuple[float, Signal]] = [(-np.inf, Signal.constant(idle))]

    def send(self, time: float, signal: Signal) -> None:
        """Add a control that acts from a time on."""
        self._acting.append((time, signal))

    def between(self, begin: float, end: float) -> Iterator[tuple[Signal, float, float]]:
        """The controls that act between two times, and from when to when each is smooth; controls before are
        forgotten."""
        last = max(k for k, (time, _) in enumerate(self._acting) if time <= begin)
        del self._acting[:last]
        times = [*(max(time, begin) for time, _ in self._acting), np.inf]
        for (_, signal), (first, following) in zip(self._acting, pairwise(times), strict=True):
            until = min(following, end)
            inside = signal.breaks[(signal.breaks > first) & (signal.breaks < until)]
            for a, b in pairwise([first, *inside, until] if first < until else []):
                yield signal, float(a), float(b)


def idle_control(problem: OptimalControlProblem, given: Any, delay: float) -> Any:
    """The control that acts before the first control of a loop: as given, or as near to zero as the bounds allow."""
    if given is not None or not delay:
        return given
    if not isinstance(problem.controls, Euclidean):
        raise InvalidInputError(
            f"with a delay a control acts before the first one, and there is no zero in {problem.controls}; try idle=u"
        )
    return clip_to_bounds(problem, np.zeros(problem.controls.shape))


def clip_to_bounds(problem: OptimalControlProblem, u: Any) -> Any:
    """A control inside the bounds of the problem."""
    bounds = problem.control_bounds
    return u if bounds is None else np.clip(u, *bounds)
