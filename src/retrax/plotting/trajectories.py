"""Trajectories of Hamiltonian systems and on P_f: energy errors, and phase portraits."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from ..integrators.initial_value.trajectory import Trajectory
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError
from ..tracing import reads_once
from .axes import legend, one


@reads_once
def _along(function: Callable[[Any, Any], Any], trajectory: Trajectory) -> np.ndarray:
    """The values of a function of ``(q, p)`` at the nodes."""
    values = np.asarray(jax.jit(jax.vmap(function))(trajectory.q, trajectory.p))
    if values.ndim != 1:
        raise InvalidInputError(
            f"the function of (q, p) must return a number, got shape {values.shape[1:]}; try one entry of it"
        )
    return values


def energy(
    trajectory: Trajectory, hamiltonian: Callable[[Any, Any], Any], label: str | None = None, ax: Any = None
) -> Any:
    """The energy error :math:`H(q, p) - H(q_0, p_0)` along a trajectory against time.

    Parameters
    ----------
    trajectory : Trajectory
        One trajectory; ``InvalidInputError`` for another object.
    hamiltonian : callable
        ``H(q, p)``; for a singular problem with the control ``classification.control(q, p)``.
    label : str, optional
        The label in the legend.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes.
    """
    values = _along(hamiltonian, _check(trajectory))
    axis = one(ax)
    axis.plot(np.asarray(trajectory.times), values - values[0], label=label)
    axis.ticklabel_format(axis="y", scilimits=(-2, 3))
    axis.set_xlabel("time")
    axis.set_ylabel("energy error")
    legend(axis)
    return axis


def phase_portrait(
    trajectories: Trajectory | Sequence[Trajectory],
    coordinates: tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]],
    names: tuple[str, str] = ("", ""),
    ax: Any = None,
) -> Any:
    """Trajectories in two coordinates of ``T*Q``, or of ``P_f``; a dot marks a start.

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
        The trajectories; ``InvalidInputError`` for other objects.
    coordinates : tuple of two callables
        Two JAX functions of ``(q, p)`` that return a number.
    names : tuple of two str
        The labels of the axes.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes.
    """
    axis = one(ax)
    for trajectory in [trajectories] if isinstance(trajectories, Trajectory) else trajectories:
        x, y = (_along(coordinate, _check(trajectory)) for coordinate in coordinates)
        (drawn,) = axis.plot(x, y, linewidth=1)
        axis.plot(x[:1], y[:1], "o", color=drawn.get_color(), markersize=3)
    axis.set_xlabel(names[0])
    axis.set_ylabel(names[1])
    return axis


def _check(trajectory: Any) -> Trajectory:
    if not isinstance(trajectory, Trajectory) or np.ndim(trajectory.times) != 1:
        raise InvalidInputError(f"expected a Trajectory, got {brief(trajectory)}; try one that integrate returns")
    return trajectory
