"""Feedback along an extremal: gains and second derivatives of its optimal cost."""

from dataclasses import dataclass, field
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Evaluator
from ....manifolds import DomainError, InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....retractions import Retraction
from ....tracing import one_tracing
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout
from ...problem_checks.requirements import HELD, require_treated
from ...reporting.records import shapes, write_protect
from ...reporting.text import brief
from ..inputs.arguments import LIMITS, structure_of
from ..transcription.chart import lagrange
from ..transcription.core_transcription import flat_limits
from ..transcription.functions.nodes import NodeFunctions
from ..transcription.kkt_system import KKTSystem
from .interpolation import Interpolant, checked_times
from .record import Solution
from .riccati import recursion


@final
@dataclass(frozen=True, eq=False)
class Feedback:
    r"""The linear feedback law along a minimum, and the second derivatives of its optimal cost.

    Attributes
    ----------
    times : array of shape (N + 1,)
        The times of the nodes.
    gains : array of shape (N s, m, n)
        Derivatives of the optimal controls at the stages with respect to the state at the first node of their step.
        Columns belong to ``manifold.basis(q)`` at that node, rows to the basis of the controls.
    cost_hessians : array of shape (N + 1, n, n)
        Second derivatives :math:`P` of the optimal cost of the remaining steps, in the basis at each node.
    until : float
        The last node from which the controls can correct every deviation; the last time if the end is free.
    solution, maps, bounds : Solution, array, pair of arrays or None
        The minimum; gains of ambient vectors at both ends of each step, ``(N, 2, U, E)``; bounds of the controls.

    Notes
    -----
    :math:`u = u^*(t) + K(t) R^{-1}_{q^*(t)}(q)` with the retraction of the method. The error is of second order in the
    deviation at a node, and of second order in the steps too between nodes. The optimal cost is :math:`J - \langle p, v
    \rangle + v P v / 2` for :math:`v = R^{-1}_{q^*}(q)`, with an error of third order.

    A prescribed end is a constraint. Gains grow toward it, and after ``until`` too few controls are left: the law then
    returns the control of the solution alone. ``cost_hessians`` after ``until`` belong to the deviations from which the
    end can still be reached, and are zero in all other directions. Deviations that violate an active state constraint
    have no gain either.

    A control at a bound has no gain, and all controls are clipped to their bounds. Active constraints are held active,
    and inactive ones are ignored. So beside a switch, the law is right for deviations that move the switch by less than
    one step. Larger deviations cause an error of first order there, over the time by which the switch moves.
    """

    times: np.ndarray
    gains: np.ndarray
    cost_hessians: np.ndarray
    until: float
    solution: Solution = field(repr=False)
    maps: np.ndarray = field(repr=False)
    bounds: tuple[np.ndarray, np.ndarray] | None = field(repr=False)

    def __post_init__(self) -> None:
        write_protect(vars(self))

    def __repr__(self) -> str:
        arrays = (f"{name}={shapes(getattr(self, name))}" for name in ("times", "gains", "cost_hessians"))
        return f"Feedback({', '.join(arrays)}, until={self.until:.6g})"

    def __call__(self, t: Any, q: Any) -> Any:
        """The control at a time in a state, inside its bounds.

        Parameters
        ----------
        t : float or array_like
            Times between the first node and the last.
        q : array, or tuple of arrays
            Points of the manifold. Leading axes are broadcast with the axes of ``t``.

        Raises
        ------
        InvalidInputError, DomainError
            For times outside the horizon and arrays of other shapes; for states so far from the solution, such as half
            a turn, that the inverse of the retraction does not exist.
        """
        interpolant, times, rows = self._interpolant, checked_times(t, self.times), self._rows(q)
        shape = np.broadcast_shapes(times.shape, rows.shape[:-1])
        times = np.broadcast_to(times, shape).ravel()
        rows = np.broadcast_to(rows, (*shape, rows.shape[-1])).reshape(-1, rows.shape[-1])
        now = self.solution(times)
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        place = ((times - self.times[k]) / np.diff(self.times)[k])[:, None, None]
        gain = (1 - place) * self.maps[k, 0] + place * self.maps[k, 1]
        gain = np.where((times <= self.until)[:, None, None], gain, 0.0)
        with one_tracing(), np.errstate(all="ignore"):
            apart = interpolant.apart(interpolant.state.rows(now.states, 1), rows)
            _require_near(apart, times)
            turn = np.einsum("tue,te->tu", gain, apart)
            controls = interpolant.move_controls(interpolant.control.rows(now.controls, 1), turn)
        if self.bounds is not None:
            controls = np.clip(controls, *(side.ravel() for side in self.bounds))
        return interpolant.control.points(controls.reshape(*shape, -1))

    @property
    def _interpolant(self) -> Interpolant:
        return self.solution._between_nodes.interpolant

    def _rows(self, q: Any) -> np.ndarray:
        """States as flat rows."""
        layout: PointLayout = self._interpolant.state
        try:
            arrays = jax.tree.map(lambda _, leaf: np.asarray(leaf), layout.points(np.zeros(layout.size)), q)
            leaves = jax.tree.leaves(arrays)
            axes = leaves[0].ndim - len(layout.shapes[0])
            fits = [leaf.shape for leaf in leaves] == [(*leaves[0].shape[:axes], *shape) for shape in layout.shapes]
            rows = layout.rows(arrays, axes) if fits else None
        except (TypeError, ValueError):
            rows = None
        if rows is None or not np.all(np.isfinite(rows)):
            raise InvalidInputError(
                f"the state must be a point of {self._interpolant.retraction.manifold}, or an array of "
                f"finite points along leading axes, got {brief(q)}; try solution(t).states"
            )
        return rows


def _require_near(apart: np.ndarray, times: np.ndarray) -> None:
    """Raise if a state has no inverse of the retraction."""
    far = ~np.all(np.isfinite(apart), axis=1)
    if np.any(far):
        raise DomainError(
            f"the state at t = {times[far][0]:.6g} is too far from the solution: the inverse of the retraction does "
            "not exist there, as at half a turn; try a new solve from this state"
        )


def _require_minimum(problem: OptimalControlProblem, kept: Any, solution: Any) -> None:
    """Raise unless feedback is defined along a solution, whose system the solver has ``kept``."""
    require_treated(problem, "feedback", *LIMITS, "an explicit time", HELD)
    if kept is None:
        got = "another solution" if isinstance(solution, Solution) else brief(solution)
        raise InvalidInputError(
            f"feedback needs a solution of a regular problem that this solver found, got {got}; try "
            "solver.feedback(solver.solve(...)) with one and the same solver"
        )
    if solution.status != "minimum":
        raise InvalidInputError(
            f"feedback takes a strict minimum, with status 'minimum', got the status {solution.status!r}: the optimal "
            "cost has no second derivative there; try another guess"
        )


def feedback(self: Any, solution: Solution) -> Feedback:
    """The feedback law along a strict minimum, and the second derivatives of its optimal cost.

    A free horizon and free parameters keep the values of the solution.

    Parameters
    ----------
    solution : Solution
        A minimum of a regular problem that this solver found; ``InvalidInputError`` for all others.
    """
    formulation, solver, found = self._reformulation.origin(solution) or (None, self, solution)
    kept: Any = solver._kept.get(found) if isinstance(found, Solution) else None
    _require_minimum(self.problem, kept, solution)
    with solver._guard(kept.parameters), np.errstate(all="ignore"):
        key = "feedback", structure_of(kept.parameters)
        if key not in solver._derivatives:
            nodes = kept.transcribed.traced.nodes
            solver._derivatives[key] = Curvatures(nodes, solver.method.retraction, solver._evaluator)
        law = _feedback_of(kept, found, solver._derivatives[key])
    return law if formulation is None else formulation.recover_feedback(law, solution)


def _feedback_of(kept: Any, solution: Solution, curvatures: "Curvatures") -> Feedback:
    """The feedback along a solution whose system the solver has kept."""
    system, nodes = kept.found.system(kept.place), kept.transcribed.traced.nodes
    held, limits = np.zeros((len(system.left), 0), bool), kept.found.inequalities
    if limits is not None:
        active = (limits.active & (limits.weights > 0))[kept.place]
        held = system.in_steps(flat_limits(kept.transcribed.traced.steps, active))
    rows = [limit_rows[which] for limit_rows, which in zip(system.limits[0], held, strict=True)]
    law = recursion(system, rows)
    if not law.complete.any():
        raise InvalidInputError(
            "there is no node from which the controls can correct every deviation before the prescribed end; try more "
            "steps, or leave the coordinates of the end free that no control moves"
        )
    last = int(np.flatnonzero(law.complete)[-1])
    sizes = system.sizes
    n, count, stages = sizes.state_size, sizes.steps, sizes.points
    gains = law.response[:, n:].reshape(count, stages, -1, n)
    curvature = law.curvature + curvatures(system)
    whole = gains
    directions = nodes.control_frames(system.array("CONTROLS", 1, count, stages, -1))
    if directions is not None:
        whole = np.einsum("ksmu,ksmn->ksun", directions[0], gains)
    places = (solution.stage_times[:stages] - solution.times[0]) / (solution.times[1] - solution.times[0])
    first = np.einsum("s,ksun,kne->kue", lagrange(places, np.zeros(1))[0], whole, system.frames[:-1])
    return Feedback(
        solution.times,
        gains.reshape(count * stages, -1, n),
        curvature,
        float(solution.times[last]),
        solution,
        _both_ends(first),
        nodes.problem.control_bounds,
    )


def _both_ends(first: np.ndarray) -> np.ndarray:
    """The gains at both ends of each step; constant next to a bound, and in the last step."""
    following = np.concatenate([first[1:], first[-1:]])
    blended = np.any(first != 0, axis=2) & np.any(following != 0, axis=2)
    return np.stack([first, np.where(blended[..., None], following, first)], axis=1)


@final
class Curvatures:
    """Share of a retraction in the second derivatives of the optimal cost, traced once."""

    def __init__(self, nodes: NodeFunctions, retraction: Retraction, evaluator: Evaluator) -> None:
        self.nodes, self.retraction = nodes, retraction
        n, e, cost = nodes.problem.manifold.dimension, nodes.layout.size, nodes.problem.terminal_cost
        self._retraction_curvature = evaluator.derivatives(self._retraction_curvature_of, n, e, e)
        self._cost_curvature = (
            None if cost is None else evaluator.derivatives(self._cost_curvature_of, n, e, nodes.parameter.size)
        )

    def __call__(self, system: KKTSystem) -> np.ndarray:
        """The share at the nodes, with the terminal cost at the last node, (N + 1, n, n)."""
        covectors = np.einsum("kn,kne->ke", system.multipliers, system.frames)
        curvatures, given = (
            np.array(self._retraction_curvature.at(1, system.nodes, covectors)[0]),
            system.array("PARAMETERS", 1, -1),
        )
        curvatures[-1] = (
            0.0 if self._cost_curvature is None else self._cost_curvature.at(1, system.nodes[-1:], given)[0][0]
        )
        return curvatures

    def _at(self, d: Array, q: Array) -> Any:
        point = self.nodes.layout.point(q)
        return self.retraction(point, vec.combine(self.retraction.manifold.basis(point), d))

    def _retraction_curvature_of(self, d: Array, q: Array, p: Array) -> tuple[Array, Array]:
        return -vec.pairing(self.nodes.layout.point(p), self._at(d, q)), jnp.zeros(0)

    def _cost_curvature_of(self, d: Array, q: Array, parameters: Array) -> tuple[Array, Array]:
        bound: Any = self.nodes.problem.with_parameters(self.nodes.parameter.point(parameters))
        return bound.terminal_cost(self._at(d, q)), jnp.zeros(0)
