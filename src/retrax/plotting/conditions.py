"""Pictures of the conditions of optimality along a solution: conserved quantities, switching functions, multipliers."""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from ..integrators.boundary_value.solution.record import Solution
from ..integrators.boundary_value.solution.report import name_with_label
from ..integrators.problem.optimal_control_problem import OptimalControlProblem
from ..integrators.problem.path_constraints import LOWER, UPPER
from ..integrators.problem.quantities import Quantity
from ..integrators.problem.user_functions import require_concrete
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError
from ..manifolds.numerics.tolerances import ACTIVE, EPS
from ..named_columns import raw_columns, view
from ..tracing import reads_once
from .axes import draw, legend, one, several, time_axis
from .series import History, PictureSeries, as_one, of_controls, panels_of, picture_series


def conserved(solution: Solution, ax: Any = None) -> Any:
    """Errors of the conserved quantities of an extremal: its Hamiltonian, momenta and the equations of its
    manifold.

    Parameters
    ----------
    solution : Solution
        The solution; ``InvalidInputError`` for another object.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes.

    Notes
    -----
    The Hamiltonian is compared with its mean, relative to the largest of its terms. A momentum with constant components
    is compared with its first value, relative to the largest. Violations of the manifold are absolute, at the nodes.
    Errors of zero are drawn at the rounding of 1. With an explicit time the Hamiltonian is not constant.
    """
    found, axis, checks = view(_check(solution)), one(ax), solution.checks
    size = checks.hamiltonian_size or 1.0
    energy = np.abs(solution.hamiltonians - solution.hamiltonians.mean()) / size
    axis.semilogy(found.stage_times, np.maximum(energy, EPS), label="Hamiltonian")
    for name, momentum in solution.momenta.items():
        if checks.conserved[name] == momentum.shape[1]:
            change = np.max(np.abs(momentum - momentum[0]), axis=1) / (np.max(np.abs(momentum)) or 1.0)
            axis.semilogy(found.times, np.maximum(change, EPS), label=f"momentum, {name_with_label(name, solution)}")
    for name, values in _violations(solution).items():
        axis.semilogy(found.times, np.maximum(values, EPS), label=name_with_label(name, solution))
    axis.set_ylabel("error")
    time_axis(axis, found.quantities.time)
    legend(axis)
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
    """The multipliers of the inequalities against time: at the stages per unit of time, and as points at the nodes.

    Parameters
    ----------
    solution : Solution
        A solution with inequalities; ``InvalidInputError`` for another one.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes.

    Notes
    -----
    The legend has the names that are active somewhere. Each curve is relative to the largest multiplier of its name,
    because units differ.
    """
    at_stages, at_nodes = _check(solution).stage_multipliers, solution.node_multipliers
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
            for column, words in zip(rows.T, _entry_names(name, rows.shape[1], found.quantities.controls), strict=True):
                axis.plot(times, column, style, label=words if active.get(name) and np.max(column) > least else None)
    axis.set_ylabel("multiplier")
    time_axis(axis, found.quantities.time)
    legend(axis)
    return axis


def _entry_names(name: str, count: int, controls: tuple[Quantity, ...]) -> list[str]:
    """The names of the entries of an inequality, which for bounds are the names of the controls."""
    side = {LOWER: 0, UPPER: 1}.get(name)
    if side is not None:
        bounds = [
            (f"{own.name} {label}".rstrip(), pair[side]) for own in controls for label, pair in _bounds_of_entries(own)
        ]
        found = [f"{('lower', 'upper')[side]} bound of {words}" for words, bound in bounds if np.isfinite(bound)]
        if len(found) == count:
            return found
    return [f"{name}[{k}]" for k in range(count)] if count > 1 else [name]


def _bounds_of_entries(quantity: Quantity) -> Iterator[tuple[str, tuple[float, float]]]:
    """The names of the entries of a control as pictures show them, and their bounds."""
    return zip(raw_columns(quantity, np.zeros((1, len(quantity.entries)))).labels, quantity.bounds, strict=False)


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
    r"""The switching functions :math:`\partial H / \partial u` at the stages against time.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem of the solution; ``InvalidInputError`` for another one.
    solution : Solution
        The solution.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes.

    Notes
    -----
    A switching function, of :math:`\langle p, X \rangle - F`, is positive where its control is at the upper bound, and
    negative where it is at the lower bound. It is zero between the bounds and other constraints.

    References
    ----------
    Pontryagin et al., The Mathematical Theory of Optimal Processes, 1962.
    """
    found, axis = view(_check(solution), problem), one(ax)
    own = []
    for quantity, values in zip(found.quantities.controls, switching_functions(problem, solution), strict=True):
        bare = Quantity(f"dH/d({quantity.name})", ("",), quantity.entries, quantity.space)
        own.append(History(found.stage_times, raw_columns(bare, values)))
    axis.axhline(0.0, color="0.6", linewidth=0.8)
    return draw(axis, [own], PictureSeries([""], [[found]], []), "dH/du")


def optimality(
    solution: Solution, problem: OptimalControlProblem | None = None, ax: Any = None, degrees: bool = False
) -> np.ndarray:
    """The controls, under them their switching functions, and the multipliers where an inequality is active.

    Parameters
    ----------
    solution : Solution
        The extremal.
    problem : OptimalControlProblem, optional
        The problem of the solution; without it there are no switching functions.
    ax : array of matplotlib axes, optional
        As many axes as there are panels, in this order; by default a new figure.
    degrees : bool
        Whether controls that are angles, or their rates, are drawn in degrees instead of radians.

    Returns
    -------
    ndarray of matplotlib axes
        One to three axes.

    Raises
    ------
    InvalidInputError
        For anything but a ``Solution``, another problem, or another number of axes.
    """
    every = picture_series(_check(solution), problem)
    has_multipliers = any(getattr(solution.checks, "active", {}).values())
    axes = several(ax, 1 + (problem is not None) + has_multipliers, columns=1, panel=(6.4, 2.6))
    draw(axes[0], as_one(panels_of(every, of_controls, degrees)), every, "controls")
    if problem is not None:
        switching(problem, solution, axes[1])
    if has_multipliers:
        multipliers(solution, axes[-1])
    return axes


def _check(solution: Any) -> Solution:
    if not isinstance(solution, Solution):
        raise InvalidInputError(f"expected a Solution, got {brief(solution)}; try one that solve returns")
    return solution
