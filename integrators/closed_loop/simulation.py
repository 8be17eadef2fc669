"""Simulation of a controller in closed loop with a plant."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import is_count, is_finite_number
from ..boundary_value.inputs.arguments import check_parameters
from ..boundary_value.inputs.boundary_data import BoundaryDataReader
from ..problem.argument_errors import require_known_options
from ..problem.optimal_control_problem import OptimalControlProblem
from ..reporting.text import brief
from .plant import Plant, SentControls, Signal, idle_control
from .receding_horizon import RecedingHorizon
from .record import ClosedLoop
from .statistics import ControllerStatistics

SAME_SAMPLE = 1e-6  # of a sample time: by which the horizon may differ from a whole number of samples


@require_known_options
def simulate(
    plant: OptimalControlProblem,
    controller: Callable[..., Any],
    start: Any,
    horizon: float,
    sample_time: float,
    parameters: Any = None,
    measure: Callable[..., Any] | None = None,
    delay: float = 0.0,
    idle: Any = None,
    seed: int = 0,
) -> ClosedLoop:
    """The closed loop of a controller with a plant, from a start over a horizon.

    Parameters
    ----------
    plant : OptimalControlProblem
        The dynamics of the plant, its manifold, controls and units. Its cost and constraints play no part.
    controller : RecedingHorizon or callable
        The control ``controller(q, t)`` for a measured state at a time.
    start : point
        The state at time zero.
    horizon : float
        The duration, a whole number of sample times.
    sample_time : float
        The time between two measurements.
    parameters : pytree or callable, optional
        The parameters of the plant, or a function ``(t, rng)`` that returns them for the sample that begins at ``t``:
        disturbances.
    measure : callable, optional
        The measured state ``measure(q, t, rng)`` of a state, with its noise; by default the state.
    delay : float
        The time from a measurement until its control acts.
    idle : control, optional
        The control that acts before the first one, with a delay; by default the nearest to zero within the bounds.
    seed : int
        The seed of ``rng``, the ``numpy.random.Generator`` of the random numbers of ``parameters`` and ``measure``.

    Returns
    -------
    ClosedLoop
        States, controls, measured states, and the solves of a ``RecedingHorizon``.

    Raises
    ------
    InvalidInputError, NotOnManifoldError
        For other arguments.
    DomainError
        If the plant cannot be integrated: its dynamics are stiff, discontinuous or not finite.

    Notes
    -----
    Each control is held until the next one acts (zero-order hold). The controls of a ``RecedingHorizon`` without
    ``hold`` follow its plan. Between the controls the plant moves by the explicit method of Dormand and Prince of order
    8 in charts of the manifold, with substeps for a relative error of 1e-9.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> loop = simulate(line, lambda q, t: -q, np.ones(1), horizon=1.0, sample_time=0.25)
    >>> float(loop.states[-1, 0].round(6))
    0.316406
    """
    count = _samples(plant, controller, horizon, sample_time)
    if not (is_finite_number(delay) and delay >= 0):
        raise InvalidInputError(f"delay must be a finite time of at least zero, got {delay!r}")
    if not (seed == 0 or is_count(seed)):
        raise InvalidInputError(f"seed must be a whole number of at least zero, got {seed!r}")
    reader, rng, moved = BoundaryDataReader.of(plant), np.random.default_rng(seed), Plant(plant)
    q, sent = reader.layout.points(reader.point(start)), SentControls(idle_control(plant, idle, delay))
    times, states, measured, controls = sample_time * np.arange(count + 1), [q], [], []
    for begin, end in pairwise(times):
        seen = q if measure is None else measure(q, float(begin), rng)
        controls.append(_check_control(plant, controller(seen, float(begin))))
        sent.send(begin + delay, _signal_of(controller, controls[-1]))
        parameters_now = parameters(float(begin), rng) if callable(parameters) else parameters
        check_parameters(plant, parameters_now)
        for signal, first, last in sent.between(begin, end):
            q = moved.advance(q, signal, first, last, parameters_now)
        states.append(q)
        measured.append(jax.tree.map(np.asarray, seen))
    solves = controller.statistics if isinstance(controller, RecedingHorizon) else None
    follows = isinstance(controller, RecedingHorizon) and controller.hold is None
    return _record(plant, (times, states, measured), (times[:-1] + delay, controls), not follows, solves)


def _record(
    plant: OptimalControlProblem, nodes: Any, stages: Any, is_held: bool, solves: ControllerStatistics | None
) -> ClosedLoop:
    (times, states, measured), (acting, controls) = nodes, stages
    return ClosedLoop(
        times, vec.stacked(states), acting, vec.stacked(controls), vec.stacked(measured), is_held,
        None if solves is None else solves.last(len(controls)), plant.quantities,
    )  # fmt: skip


def _signal_of(controller: Any, control: Any) -> Signal:
    """The control until the next sample as a function of time."""
    return controller.signal if isinstance(controller, RecedingHorizon) else Signal.constant(control)


def _samples(plant: Any, controller: Any, horizon: Any, sample_time: Any) -> int:
    """The number of samples; raises ``InvalidInputError`` for other arguments."""
    if not isinstance(plant, OptimalControlProblem):
        raise InvalidInputError(f"the plant must be an OptimalControlProblem, got {brief(plant)}; try solver.problem")
    if not callable(controller):
        raise InvalidInputError(
            f"the controller must be a RecedingHorizon or a function (q, t) that returns a control, got "
            f"{brief(controller)}"
        )
    for name, value in (("horizon", horizon), ("sample_time", sample_time)):
        if not (is_finite_number(value) and value > 0):
            raise InvalidInputError(f"{name} must be a positive finite time, got {value!r}")
    count = round(horizon / sample_time)
    if not (count and abs(horizon / sample_time - count) <= SAME_SAMPLE):
        raise InvalidInputError(
            f"the horizon {horizon:.6g} must be a whole number of sample times {sample_time:.6g}, got "
            f"{horizon / sample_time:.6g}; try horizon={max(count, 1) * sample_time:.6g}"
        )
    return count


def _check_control(plant: OptimalControlProblem, control: Any) -> Any:
    """A control as arrays; raises ``InvalidInputError`` for another one."""
    wrong = plant.controls.describe_mismatch(control, "the control of the controller")
    if wrong:
        raise InvalidInputError(wrong)
    return jax.tree.map(lambda leaf: np.array(leaf, float), control)
