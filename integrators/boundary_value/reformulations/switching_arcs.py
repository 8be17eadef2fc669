"""Arcs along which controls stay at their bounds, with free durations: switches are then nodes, and found to all
digits."""

from dataclasses import replace
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ...problem.boundary_conditions import BoundaryConditions
from ...problem.free_quantities import Free, is_free
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import LOWER, PARAMETERS_LOWER, PARAMETERS_UPPER, UPPER, Inequalities
from ...problem.point_layout import PointLayout, parameter_layout
from ..guess import Guess, Mesh
from ..inputs.arguments import BoundaryData, structure_of
from ..solution.record import Solution
from ..transcription.chart import lagrange
from .reformulation import Reformulation

REFINED_ARC = 4  # for each stage: where the signs of switching functions are looked at
OWN_PARAMETERS, DURATIONS, LAST = "own", "durations", "duration of the last arc"


class _Arc(NamedTuple):
    """The state of an arc at a time: its duration, the time of the problem, and the fixed controls with their
    values."""

    duration: Array
    time: Array
    fixed: Array
    values: Array


class ArcData(NamedTuple):
    """Boundary data, and a solution as a guess, with the times of its switches between both ends, and the mesh over
    ``[0, K]``."""

    given: BoundaryData
    guess: Solution
    times: np.ndarray  # (K + 1,)
    mesh: Mesh


@final
class SwitchingArcs(Reformulation[ArcData, BoundaryData, Solution, Solution]):
    """A problem whose controls are at known bounds along K arcs, as a problem over ``[0, K]`` in which each arc lasts
    1.

    Over arc j, with the durations ``d`` as free parameters, ``t = d_1 + ... + d_(j-1) + (tau - j) d_j`` and

        dq/dtau = d_j X(q, u, t),    cost  int d_j F dtau,    u_i = its bound where it is fixed, else v_i,

    so that nothing jumps within a step, and stationarity by ``d_j`` says that the switches are where they should be.
    Nothing depends on the ``v_i`` of a control that is fixed, which a cost ``v_i^2`` holds amid its bounds. With a
    given horizon the last duration is what the others leave. ``unit``: that of the cost over time.
    """

    def __init__(self, problem: OptimalControlProblem, sides: np.ndarray, horizon: Any, unit: float) -> None:
        self.own, self.horizon, self.unit, self.count = problem, horizon, unit, len(sides)
        lower, upper = (np.array(side) for side in (problem._limits.lower, problem._limits.upper))
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self._slope: dict[Any, PointwiseFunction] = {}
        self.sides, self.fixed = sides, (sides != 0).astype(float)
        self.values = np.where(sides < 0, lower, np.where(sides > 0, upper, 0.0))
        both = np.isfinite(lower) & np.isfinite(upper)
        self.room = np.where(both, upper - lower, 1.0)
        nearest = np.where(np.isfinite(lower), lower + 1, np.where(np.isfinite(upper), upper - 1, 0.0))
        self.middle = np.where(both, (np.where(both, lower, 0) + np.where(both, upper, 0)) / 2, nearest)
        last = () if is_free(horizon) else (LAST,)
        names, limits = problem._limits.names, [self._limit(place) for place in range(len(problem._limits.names))]
        own, every = problem._limits, (*limits, self._last) if last else tuple(limits)
        at_nodes = own.node_names, tuple(map(self._node_limit, range(len(own.node_names))))
        held: Any = Inequalities(own.lower, own.upper, names + last, every, own.at_first | frozenset(last), *at_nodes)
        changes: Any = {
            "dynamics": self._velocity,
            "running_cost": self._rate,
            "constraints": held,
            "time_dependent": True,
        }
        costs = ("terminal_cost", self._final), ("initial_cost", self._first)
        changes |= {name: cost for name, cost in costs if getattr(problem, name) is not None}
        self.problem = problem._with_arguments(boundary_constraints=self._boundary(), **changes)

    def apply(self, data: ArcData) -> BoundaryData:
        """The data over ``[0, K]``, with guessed durations among the parameters."""
        durations, own = np.diff(data.times), data.given.near(data.guess).parameters
        parameters = {
            DURATIONS: Free(durations if is_free(self.horizon) else durations[:-1], lower=0.0),
            OWN_PARAMETERS: () if own is None else own,
        }
        return BoundaryData(data.given.start, data.given.end, float(self.count), parameters)

    def durations(self, found: Any) -> Any:
        """The durations of all arcs from the free durations."""
        return (
            found
            if is_free(self.horizon)
            else jnp.concatenate([found, jnp.reshape(self.horizon - jnp.sum(found), (1,))])
        )

    def guess(self, data: ArcData, posed: BoundaryData) -> Guess:
        """The solution at the nodes and stages of the mesh."""
        solution, (nodes, stages) = data.guess, data.mesh.times(1.0)

        def time(tau: np.ndarray) -> np.ndarray:
            return np.clip(np.interp(tau, np.arange(self.count + 1), data.times), *solution.times[[0, -1]])

        at_stages, at_nodes = solution(time(stages)), solution(time(nodes))
        arc = self.arc(stages)
        flat = np.asarray(at_stages.controls).reshape(len(stages), -1)
        controls = np.where(self.fixed[arc] > 0, self.middle, flat).reshape(np.shape(at_stages.controls))
        return Guess(at_stages.states, controls, at_nodes.costates, at_nodes.states, at_stages.costates)

    def arc(self, tau: np.ndarray) -> np.ndarray:
        """The arc to which a time belongs."""
        return np.clip(np.floor(tau).astype(int), 0, self.count - 1)

    def recover(self, posed: BoundaryData, found: Solution) -> Solution:
        """The solution of the problem, with the multipliers of bounds that switching functions ``d(<p, X> - F)/du``
        are.

        A failure is returned as it is.
        """
        if not found.success:
            return found
        durations = np.asarray(self.durations(found.parameters[DURATIONS]))
        ends = np.concatenate([[0.0], np.cumsum(durations)])
        arc, rates = self.arc(found.stage_times), durations[self.arc(found.stage_times)]
        flat = np.where(self.fixed[arc] > 0, self.values[arc], np.asarray(found.controls).reshape(len(arc), -1))
        checks: Any = found.checks
        hamiltonians, multipliers = found.hamiltonians / rates, self._multipliers(found, durations, rates)
        solution = replace(
            found,
            times=np.interp(found.times, np.arange(self.count + 1), ends),
            stage_times=np.interp(found.stage_times, np.arange(self.count + 1), ends),
            controls=flat.reshape(np.shape(found.controls)),
            hamiltonians=hamiltonians,
            parameters=found.parameters[OWN_PARAMETERS] if self.own.takes_parameters else None,
            checks=replace(
                checks,
                hamiltonian=float(hamiltonians[0]),
                hamiltonian_spread=float(np.ptp(hamiltonians)),
                hamiltonian_size=checks.hamiltonian_size / np.max(durations),
            ),
        )
        return self._with_switching_functions(solution, multipliers, self.sides[arc])

    def _with_switching_functions(
        self, solution: Solution, multipliers: dict[str, np.ndarray], sides: np.ndarray
    ) -> Solution:
        """The solution with these multipliers, and with switching functions in their place at bounds that fix a
        control, on the ``sides`` of the stages."""
        checks: Any = solution.checks
        along = solution.stage_states, solution.stage_costates, solution.controls, solution.stage_times
        slopes = self._slopes(along, multipliers, solution.parameters)
        names = {*multipliers, *solution.node_multipliers}
        active = {name: count for name, count in checks.active.items() if name in names}
        for name, sign in ((LOWER, -1), (UPPER, 1)):
            if name in multipliers:
                held = np.maximum(sign * slopes, 0.0)
                multipliers[name] = np.where(sides == sign, held, np.where(sides == 0, multipliers[name], 0.0))
                active[name] = int(np.sum(np.any(sides == sign, axis=1)))
        return replace(solution, multipliers=multipliers, checks=replace(checks, active=active))

    def _multipliers(self, found: Solution, durations: np.ndarray, rates: np.ndarray) -> dict[str, np.ndarray]:
        """The multipliers of the problem per unit of time; of bounded controls where the arcs leave them free."""
        multipliers = {name: rows for name, rows in found.multipliers.items() if name != LAST}
        multipliers |= {name: rows / rates[:, None] for name, rows in found.stage_multipliers.items() if name != LAST}
        for name in (PARAMETERS_LOWER, PARAMETERS_UPPER):  # of the durations first, in the order of the names
            rows = multipliers.pop(name, None)
            more = 0 if name == PARAMETERS_UPPER else durations.size - (not is_free(self.horizon))
            if rows is not None and rows.shape[1] > more:
                multipliers[name] = rows[:, more:] * rates[:, None] / np.sum(durations)
        return multipliers

    def lack(self, solution: Solution, arcs: np.ndarray) -> float:
        """By how much the cost falls, to first order and relative to it, if controls leave bounds to which nothing
        pulls them.

        ``int max(-side d(<p, X> - F)/du, 0) room dt`` along the polynomials of the steps, of which ``arcs`` are the
        arcs.
        """
        stages = len(solution.stage_times) // solution.steps
        places = (np.arange(REFINED_ARC * stages) + 0.5) / (REFINED_ARC * stages)
        sample = solution._between_nodes.within(places)
        rows = {name: rows.reshape(solution.steps, stages, -1) for name, rows in solution.stage_multipliers.items()}
        at = (solution.stage_times[:stages] - solution.times[0]) / (solution.times[1] - solution.times[0])
        shares = lagrange(at, places)
        own = {
            name: np.einsum("is,ksc->kic", shares, values).reshape(-1, values.shape[2]) for name, values in rows.items()
        }
        flat = (
            jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), part)
            for part in (sample.states, sample.costates, sample.controls)
        )
        slopes = self._slopes((*flat, sample.times.ravel()), own, solution.parameters).reshape(*sample.times.shape, -1)
        wrong = np.mean(np.maximum(-self.sides[arcs][:, None] * slopes, 0.0), axis=1) @ self.room
        return float(np.diff(solution.times) @ wrong / (self.unit * (solution.times[-1] - solution.times[0])))

    def _slopes(
        self, along: tuple[Any, Any, Any, np.ndarray], multipliers: dict[str, np.ndarray], parameters: Any
    ) -> np.ndarray:
        """The switching functions with the share of the constraints, at states, costates, controls and times in a
        row."""
        parameter = parameter_layout(parameters)
        held = np.concatenate(
            [np.zeros((len(along[3]), 0)), *(multipliers[name] for name in self.own._limits.names)], axis=1
        )
        key = structure_of(parameters), held.shape[1]
        if key not in self._slope:
            self._slope[key] = self._slope_of(parameter, held.shape[1])
        given = parameter.rows(parameters, 0)
        layouts = self.state, self.state, self.control
        rows = (layout.rows(points, 1) for layout, points in zip(layouts, along, strict=False))
        return self._slope[key](*rows, along[3][:, None], held, given[None])[0]

    def _slope_of(self, parameter: PointLayout, count: int) -> PointwiseFunction:
        def slope(q: Array, p: Array, u: Array, time: Array, nu: Array, parameters: Array) -> tuple[Array]:
            bound = self.own.with_parameters(parameter.point(parameters)).at_time(time[0])
            point, covector = self.state.point(q), self.state.point(p)

            def hamiltonian(u: Array) -> Array:
                values = [jnp.zeros(0), *bound._limits.of_points(point, self.control.point(u))]
                return bound.hamiltonian(point, covector, self.control.point(u)) - nu @ jnp.concatenate(values)

            return (jax.grad(hamiltonian)(u),)

        return AutomaticEvaluator().values(
            slope, self.state.size, self.state.size, self.control.size, 1, count, parameter.size
        )

    def _arc(self, tau: Array, given: Any) -> _Arc:
        durations = self.durations(given[DURATIONS])
        begins, places = jnp.cumsum(durations) - durations, np.arange(self.count)
        below, above = np.where(places > 0, places, -np.inf), np.where(places + 1 < self.count, places + 1, np.inf)
        here = jnp.where((tau >= below) & (tau < above), 1.0, 0.0)
        d = here @ durations
        return _Arc(d, here @ (begins - places * durations) + tau * d, here @ self.fixed, here @ self.values)

    def _problem_at(self, t: Any, given: Any) -> OptimalControlProblem:
        own = given[OWN_PARAMETERS] if self.own.takes_parameters else None
        return self.own.with_parameters(own).at_time(t)

    def _control(self, v: Array, arc: _Arc) -> Array:
        return jnp.reshape(arc.fixed * arc.values + (1 - arc.fixed) * jnp.ravel(v), jnp.shape(v))

    def _velocity(self, q: Any, v: Array, tau: Array, given: Any) -> Any:
        arc = self._arc(tau, given)
        velocity = self._problem_at(arc.time, given).velocity(q, self._control(v, arc))
        return jax.tree.map(lambda a: arc.duration * a, velocity)

    def _rate(self, q: Any, v: Array, tau: Array, given: Any) -> Array:
        arc = self._arc(tau, given)
        idle = arc.fixed * (jnp.ravel(v) - self.middle) / self.room
        return (
            arc.duration * self._problem_at(arc.time, given).cost_rate(q, self._control(v, arc))
            + self.unit * idle @ idle / 2
        )

    def _final(self, q: Any, tau: Array, given: Any) -> Array:
        return self._problem_at(jnp.sum(self.durations(given[DURATIONS])), given).final_cost(q)

    def _first(self, q: Any, given: Any) -> Array:
        return self._problem_at(0.0, given).first_cost(q)

    def _boundary(self) -> BoundaryConditions:
        boundary = self.own._boundary
        turn = None if boundary.turn is None else self._turn
        return BoundaryConditions(boundary.names, tuple(map(self._between, range(len(boundary.names)))), turn)

    def _between(self, place: int) -> Any:
        def between(first: Any, last: Any, tau: Array, given: Any) -> Any:
            end = jnp.sum(self.durations(given[DURATIONS]))
            return self._problem_at(end, given)._boundary.functions[place](first, last)

        return between

    def _turn(self, q: Any, given: Any) -> Any:
        return self._problem_at(0.0, given)._periodic_end(q)

    def _last(self, q: Any, v: Array, tau: Array, given: Any) -> Array:
        return -self.durations(given[DURATIONS])[-1]

    def _limit(self, place: int) -> Any:
        def limit(q: Any, v: Array, tau: Array, given: Any) -> Any:
            arc = self._arc(tau, given)
            return self._problem_at(arc.time, given)._limits.functions[place](q, self._control(v, arc))

        return limit

    def _node_limit(self, place: int) -> Any:
        def limit(q: Any, tau: Array, given: Any) -> Any:
            return self._problem_at(self._arc(tau, given).time, given)._limits.node_functions[place](q)

        return limit
