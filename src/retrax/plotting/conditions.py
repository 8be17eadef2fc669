"""What the conditions of optimality say along a solution: what is conserved, switching functions, multipliers."""

from typing import Any

import jax
import numpy as np

from ..channels import Channel, control_channels, raw, view
from ..integrators import OptimalControlProblem, Quantity, Solution
from ..integrators.functions import require_concrete
from ..integrators.text import brief
from ..manifolds import InvalidInputError
from ..manifolds.numerics.tolerances import ACTIVE, EPS
from ..reading import reads_once
from .axes import draw, draw_controls, one, several, time_axis
from .drawn import drawn


def conserved(solution: Solution, ax: Any = None) -> Any:
    """Errors of what the continuous extremal keeps: its Hamiltonian, its momenta and the equations of its manifold.

    The Hamiltonian is compared with its mean, relative to the largest of its parts; a momentum whose components are all
    constant along the extremal with that at the start, relative to the largest; the equations are those of
    ``manifold.violations`` at the nodes, as they are. Errors of zero are drawn at the rounding of 1. The Hamiltonian of
    a problem with an explicit time is not constant. Returns the axes; raises ``InvalidInputError`` for anything but a
    ``Solution``.
    """
    found, axis, checks = view(_checked(solution)), one(ax), solution.checks
    size = checks.hamiltonian_size or 1.0
    energy = np.abs(solution.hamiltonians - solution.hamiltonians.mean()) / size
    axis.semilogy(found.stage_times, np.maximum(energy, EPS), label="Hamiltonian")
    for name, momentum in solution.momenta.items():
        if checks.conserved[name] == momentum.shape[1]:
            change = np.max(np.abs(momentum - momentum[0]), axis=1) / (np.max(np.abs(momentum)) or 1.0)
            axis.semilogy(found.times, np.maximum(change, EPS), label=f"momentum, {name}")
    for name, values in _violations(solution).items():
        axis.semilogy(found.times, np.maximum(values, EPS), label=name)
    axis.set_ylabel("error")
    time_axis(axis, found)
    axis.legend(fontsize="small")
    return axis


def _violations(solution: Solution) -> dict[str, np.ndarray]:
    """The largest violation of each equation of the manifold at each node; none where the manifold is not known."""
    if solution.interpolant is None:
        return {}
    manifold = solution.interpolant.retraction.manifold
    found = jax.jit(jax.vmap(manifold.violations))(solution.states)
    return {
        name: np.max(np.abs(values).reshape(len(values), -1), axis=1) for name, values in jax.device_get(found).items()
    }


def multipliers(solution: Solution, ax: Any = None) -> Any:
    """The multipliers of the inequalities at the stages, ``nu >= 0`` per unit of time, against time; and as points
    those at the nodes, by which costates jump.

    The legend names those that hold the trajectory somewhere, each relative to the largest of its name: multipliers of
    inequalities in different units cannot be compared. Returns the axes; raises ``InvalidInputError`` for a solution of
    a problem without inequalities.
    """
    at_stages, at_nodes = _checked(solution).stage_multipliers, solution.node_multipliers
    if not (at_stages or at_nodes):
        raise InvalidInputError(
            "the solution has no multipliers at its stages or nodes, its problem has no inequalities; try "
            "control_bounds=, constraints= or node_constraints= of the problem"
        )
    found, axis = view(solution), one(ax)
    active = getattr(solution.checks, "active", {})
    for every, times, style in ((at_stages, found.stage_times, "-"), (at_nodes, found.times, ".")):
        for name, rows in every.items():
            least = ACTIVE * np.max(rows, initial=0.0)
            for k, column in enumerate(rows.T):
                words = f"{name}[{k}]" if rows.shape[1] > 1 else name
                axis.plot(times, column, style, label=words if active.get(name) and np.max(column) > least else None)
    axis.set_ylabel("multiplier")
    time_axis(axis, found)
    if axis.get_legend_handles_labels()[1]:
        axis.legend(fontsize="small")
    return axis


@reads_once
def switching_functions(problem: OptimalControlProblem, solution: Solution) -> list[np.ndarray]:
    """``dH/du = d/du (<p, X> - p_0 F)`` at the stages, without the inequalities, array by array, shape ``(S,
    *shape)``."""
    require_concrete("switching", problem)

    def at(q: Any, p: Any, u: Any, t: Any) -> Any:
        return jax.grad(problem.with_parameters(solution.parameters).at_time(t).hamiltonian, argnums=2)(q, p, u)

    given = solution.stage_states, solution.stage_costates, solution.controls, solution.stage_times
    return [np.asarray(leaf) for leaf in jax.tree.leaves(jax.jit(jax.vmap(at))(*given))]


def switching(problem: OptimalControlProblem, solution: Solution, ax: Any = None) -> Any:
    """The switching functions ``dH/du``, derivatives of ``<p, X> - F`` by the controls at the stages, against time.

    Where a control is at its upper bound its switching function is positive, where it is at its lower one negative,
    between the bounds and other constraints zero (Pontryagin et al. 1962). Returns the axes; raises
    ``InvalidInputError`` if the problem is not that of the solution.
    """
    found, axis = view(_checked(solution), problem), one(ax)
    for quantity, values in zip(found.quantities.controls, switching_functions(problem, solution), strict=True):
        axis.axhline(0.0, color="0.6", linewidth=0.8)
        bare = Quantity(f"dH/d({quantity.name})", ("",), quantity.entries, quantity.space)
        draw(axis, found.stage_times, raw(bare, values), found)
    return axis


def optimality(solution: Solution, problem: OptimalControlProblem | None = None, ax: Any = None) -> np.ndarray:
    """The controls, under them their switching functions if ``problem`` is given, and the multipliers if there are any.

    Bounds of the problem are dashed. ``ax``: as many axes as there are panels, in this order. Returns them, shape
    ``(panels,)``.
    """
    _, found = drawn(_checked(solution), problem)
    has_multipliers = bool(solution.stage_multipliers or solution.node_multipliers)
    rows = 1 + (problem is not None) + has_multipliers
    axes = several(ax, rows, columns=1, panel=(6.4, 2.6))
    channels = control_channels(found)
    draw_controls(axes[0], channels, found)
    for channel in channels:
        _bounds(axes[0], problem, channel)
    if problem is not None:
        switching(problem, solution, axes[1])
    if has_multipliers:
        multipliers(solution, axes[-1])
    return axes


def _bounds(axis: Any, problem: OptimalControlProblem | None, channel: Channel) -> None:
    if problem is None or problem.control_bounds is None or len(channel.entries) != problem.control_bounds[0].size:
        return
    for bound in {float(b) for side in problem.control_bounds for b in side.ravel() if np.isfinite(b)}:
        axis.axhline(bound, color="0.4", linestyle="--", linewidth=0.8)


def _checked(solution: Any) -> Solution:
    if not isinstance(solution, Solution):
        raise InvalidInputError(f"expected a Solution, got {brief(solution)}; try one that solve returns")
    return solution
