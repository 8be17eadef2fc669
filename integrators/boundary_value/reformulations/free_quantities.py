"""A problem with a free horizon, free parameters or an explicit time as one with none of them, in more states."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, final
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds import Euclidean, Product
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.product import factor_name
from ....retractions import Addition, CollocationMethod, DiscretizationMap, ProductRetraction, Retraction, Theta
from ...problem.boundary_conditions import BoundaryConditions
from ...problem.free_quantities import Free, guess_inside, guess_of, is_free
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import HORIZON_LOWER, HORIZON_UPPER, PARAMETERS_LOWER, PARAMETERS_UPPER, Inequalities
from ...problem.point_layout import PointLayout
from ..guess import Guess
from ..inputs.arguments import BoundaryData, Method
from ..inputs.inputs import InputReader, Inputs
from ..inputs.reformulation_kind import ReformulationKind, entry_rows
from ..solution.covariance import Covariance
from ..solution.diagnostics import Checks
from ..solution.feedback import Feedback
from ..solution.record import Solution
from ..solution.sensitivity import Derivative, Sensitivity
from .reformulation import Reformulation

# Of a bound's size: a guess is no nearer to it; the same where its multiplier is known.
BOUND_MARGIN, MULTIPLIER_MARGIN = 1e-2, 1e-8
BOUND_NAMES = {HORIZON_LOWER, HORIZON_UPPER, PARAMETERS_LOWER, PARAMETERS_UPPER}
OWN_FACTOR = f"{factor_name(0)}, "  # how the names of the factors of Q begin in the product with the added states
OWN_EQUATION = f"{factor_name(0)}: "  # how the names of the equations of Q begin there


@final
class FreeQuantities(Reformulation[Inputs, BoundaryData, Solution, Solution]):
    """The problem on ``Q x R^j x R`` with states ``(q, c, tau)`` that a problem with free quantities or a time is.

    The constants ``c`` are the entries of the free parameters ``theta`` and ``c_0 + s``, ``s = log(T / T_0)``, ``T_0``
    the guess of the free horizon; they are free at both ends. The clock starts at 0. Over ``[0, T_0]``, with ``t =
    t_0 + e^s tau`` and the start time ``t_0``, the last one of the parameters,

        q' = e^s X(q, u, t, theta),   c' = 0,   tau' = 1,   cost Phi_0(q(0), theta) + int e^s F dtau + Phi(q, t, theta),

    so that ``T > 0`` without a bound, and the clock is right whatever ``s`` is. ``c_0``, which is ``at_guess``, is one
    where searches begin anew: that is its size, beside which what it moves by may be rounding. The steps are those of
    the problem over ``[0, T]``. Its costates are those of the problem, and its Hamiltonian is ``e^s H + p_tau``.
    Stationarity by ``s`` says that the mean of the Hamiltonian of a free horizon is zero, or what the terminal cost
    changes by with the time.
    """

    def __init__(self, reader: InputReader, kind: ReformulationKind, at_guess: float = 1.0) -> None:
        self.own, self.kind, self.at_guess = reader.problem, kind, at_guess
        self._interpolant, problem = reader.mesh.interpolant, reader.problem
        self.recovered: WeakKeyDictionary[Solution, Solution] = WeakKeyDictionary()  # from which extremal of this
        self.constants = kind.entries + kind.horizon
        added = [Euclidean(self.constants)] if self.constants else []
        added += [Euclidean(1)] if problem.time_dependent else []
        beside = [Addition(manifold) for manifold in added]
        self.takes = len(kind.shapes) > len(kind.free) or any(kind.horizon_bounds) or bool(kind.below or kind.above)
        self.takes |= problem.time_dependent
        self.method = extend_method(reader.method, beside)
        changes: Any = {
            "dynamics": self._of_state(self._velocity, 2),
            "running_cost": self._of_state(self._rate, 2),
            "terminal_cost": self._of_node(lambda own, q: own.final_cost(q)),
            "initial_cost": self._of_node(lambda own, q: own.first_cost(q)),
            "node_cost": self._of_state(self._node, 2),
        }
        changes = {name: function for name, function in changes.items() if getattr(problem, name) is not None}
        changes |= {"constraints": self._limits(), "boundary_constraints": self._boundary(), "labels": None}
        changes["sampling"] = None  # of the steps that were required of the problem itself
        self.problem = problem._with_arguments(
            manifold=Product(problem.manifold, *added), time_dependent=False, **changes
        )

    def apply(self, data: Inputs, begin: float | None = None) -> BoundaryData:
        """The data in more states; of a batch with one more axis.

        The clock starts at zero, or is free at the start and guessed to ``begin`` there.
        """
        each = [(given, data.guess_of(k)) for k, given in enumerate(data.each)]
        constants, horizon = np.stack([self._guesses(*pair) for pair in each]), data.horizons
        times, every = horizon[:, None] + (begin or 0.0), [self.parameters(given) for given, _ in each]
        if data.axes:
            parameters = vec.stacked(every) if self.takes else None
        else:
            constants, times, horizon, parameters = constants[0], times[0], float(horizon[0]), every[0]
        clock = np.zeros(1) if begin is None else Free(np.full(1, begin))
        first = [Free(constants)] if self.constants else [], [clock] if self.own.time_dependent else []
        last = [None] if self.constants else [], [Free(times)] if self.own.time_dependent else []
        start, end = (data.given.start, *first[0], *first[1]), (data.given.end, *last[0], *last[1])
        return BoundaryData(start, end, horizon, parameters)

    def guess(self, data: Inputs, posed: BoundaryData) -> Any:
        """The guess in more states; of a batch a list."""
        if data.guesses is None:
            return None
        constants = np.reshape(posed.start[1].guess if self.constants else np.zeros(0), (len(data), self.constants))
        begin, known = guess_of(posed.start[-1]) if self.own.time_dependent else 0.0, self._known_covectors(data)
        guesses = list[Guess]()
        for k, row in enumerate(constants):
            nodes, stages = data.reader.mesh.times(float(data.horizons[k]))
            guesses.append(self._in_more_states(data.guess_of(k), row, (begin + nodes, begin + stages), known))
        return guesses if data.axes else guesses[0]

    def _guesses(self, given: BoundaryData, guess: Guess | None) -> np.ndarray:
        """The constants that are guessed, strictly inside their bounds; by little where a guess knows multipliers of
        these."""
        leaves, share = jax.tree.leaves(given.parameters), BOUND_MARGIN
        if guess is not None and not BOUND_NAMES.isdisjoint(guess.multipliers or {}):
            share = MULTIPLIER_MARGIN
        first, lower, upper = (
            np.append(entry_rows(leaves, name), self._in_log(given.horizon, name))
            for name in ("guess", "lower", "upper")
        )
        return guess_inside(first, lower, upper, share)

    def _in_log(self, horizon: Any, name: str) -> np.ndarray:
        """The guess, or a bound, of a free horizon as a value of the constant, the logarithm of the horizon over its
        guess."""
        free, none = is_free(horizon), name == "lower" and is_free(horizon) and horizon.lower <= 0
        logarithm = -np.inf if none else np.log(getattr(horizon, name) / horizon.guess) if free else 0.0
        return np.full(int(free), self.at_guess + logarithm)

    def parameters(self, given: BoundaryData) -> Any:
        """The parameters of the reformulation, fixed parameters, bounds and the start time, or None without any."""
        if not self.takes:
            return None
        leaves = jax.tree.leaves(given.parameters)
        sides = ("lower", self.kind.below), ("upper", self.kind.above)
        below, above = (entry_rows(leaves, name)[list(entries)] for name, entries in sides)
        both = zip(self.kind.horizon_bounds, ("lower", "upper"), strict=True)
        bounds = np.concatenate(
            [*(self._in_log(given.horizon, name) for bounded, name in both if bounded), below, above]
        )
        begin = [np.array(float(given.start_time))] if self.own.time_dependent else []
        return [leaf for leaf in leaves if not is_free(leaf)], ([bounds] if bounds.size else []), begin

    def _known_covectors(self, data: Inputs) -> dict[str, tuple]:
        """The covectors of the constants and of the clock, if the guess is a solution that was recovered from such."""
        known = self.recovered.get(data.guess) if isinstance(data.guess, Solution) else None
        if known is None:
            return {}
        extended_guess = known._guess_on(data.reader.mesh._replace(interpolant=known.interpolant))
        # The clock runs to another time.
        rates = [1.0] * bool(self.constants) + [known.horizon / data.horizons[0]] * self.own.time_dependent
        added = {name: getattr(extended_guess, name)[1:] for name in ("costates", "stage_costates")}
        return {name: tuple(rate * p for rate, p in zip(rates, parts, strict=True)) for name, parts in added.items()}

    def _in_more_states(
        self, guess: Any, constants: np.ndarray, times: tuple[np.ndarray, np.ndarray], known: dict[str, tuple]
    ) -> Guess:
        """A guess with the constants, and the times of the nodes and of the stages; covectors of what is added are
        known, or zero."""
        at, changes = {"n": times[0], "s": times[1]}, dict[str, Any]()
        for name, where in (("states", "s"), ("costates", "n"), ("nodes", "n"), ("stage_costates", "s")):
            constant = [np.broadcast_to(constants, (len(at[where]), self.constants))] if self.constants else []
            added: Any = *constant, *([at[where][:, None]] if self.own.time_dependent else [])
            if "costates" in name:
                added = known.get(name, tuple(np.zeros(np.shape(a)) for a in added))
            if getattr(guess, name) is not None:
                changes[name] = getattr(guess, name), *added
        multipliers, horizon = guess.multipliers or {}, times[0][-1] - times[0][0]
        bounds = {name: horizon * rows for name, rows in multipliers.items() if name in (HORIZON_LOWER, HORIZON_UPPER)}
        return guess._replace(multipliers={**multipliers, **bounds}, **changes)

    @np.errstate(all="ignore")  # a horizon that vanished, or has no bound, is said in the result
    def recover(self, posed: BoundaryData, found: Solution) -> Solution:
        """The solution of the problem itself."""
        constants = found.states[1][0] if self.constants else np.zeros(0)
        rate = np.exp(constants[-1] - self.at_guess) if self.kind.horizon else np.float64(1.0)
        clock = found.stage_costates[-1][:, 0] / rate if self.own.time_dependent else 0.0
        begin = float(found.parameters[2][0]) if self.own.time_dependent else 0.0
        states: Any = {
            name: getattr(found, name)[0] for name in ("states", "costates", "stage_states", "stage_costates")
        }
        along = "momenta", "body_costates", "spatial_costates"
        named: Any = {name: self._by_name(getattr(found, name)) for name in along}
        solution = replace(
            found,
            times=begin + rate * found.times,
            stage_times=begin + rate * found.stage_times,
            hamiltonians=found.hamiltonians / rate - clock,
            checks=self._checks(found.checks, rate),
            parameters=self.kind.parameters(constants, found.parameters[0] if self.takes else ()),
            multipliers=self._multipliers(found, rate),
            interpolant=self._interpolant,
            quantities=self.own.quantities,
            **states,
            **named,
        )
        self.recovered[solution] = found
        return solution

    def _multipliers(self, found: Solution, rate: float) -> dict[str, np.ndarray]:
        """The multipliers in the time of the problem, with the bounds of ``s`` as bounds of ``T``."""
        between = self.own._boundary.names
        multipliers = {name: values / (1.0 if name in between else rate) for name, values in found.multipliers.items()}
        bounds = multipliers.keys() & {HORIZON_LOWER, HORIZON_UPPER}
        return multipliers | {name: multipliers[name] / (rate * found.horizon) for name in bounds}

    def _checks(self, checks: Checks, rate: float) -> Checks:
        """The checks in the time of the problem; the Hamiltonian that is constant has the clock's part."""
        names = "hamiltonian", "hamiltonian_spread", "hamiltonian_size"
        own: Any = {name: float(getattr(checks, name) / rate) for name in names}
        named: Any = {name: self._by_name(getattr(checks, name)) for name in ("momentum_spreads", "conserved")}
        return replace(checks, violations=self._by_name(checks.violations, OWN_EQUATION), **own, **named)

    def _by_name(self, values: dict[str, Any], prefix: str = OWN_FACTOR) -> dict[str, Any]:
        """Values of the factors of Q, without the added states, under the names of the problem."""
        label = partial(self.own.quantities.labelled, count=len(getattr(self.own.manifold, "factors", ())))
        return {label(name.removeprefix(prefix)): value for name, value in values.items() if name.startswith(prefix)}

    def recover_sensitivity(self, found: Sensitivity) -> Sensitivity:
        """The derivatives of a solution of the problem; by what is free there are none."""
        n = self.own.manifold.dimension

        def own(derivative: Derivative, entries: slice | None = None) -> Derivative:
            cut = (lambda leaf: leaf) if entries is None else (lambda leaf: leaf[entries])
            parts = derivative.cost, derivative.states[0], derivative.costates[0], derivative.controls
            return Derivative(*(jax.tree.map(cut, part) for part in parts))

        ends = own(found.start, slice(0, n)), own(found.end, slice(0, n))
        horizon = None if self.kind.horizon or found.horizon is None else own(found.horizon)
        fixed = iter(found.parameters[0] if self.takes else ())
        leaves = [None if place in self.kind.free else own(next(fixed)) for place in range(len(self.kind.shapes))]
        return Sensitivity(*ends, horizon, jax.tree.unflatten(self.kind.structure, leaves) if leaves else None)

    def recover_feedback(self, found: Feedback, solution: Solution) -> Feedback:
        """The law of the problem for a solution of it: constants and clock do not deviate."""
        n, size = self.own.manifold.dimension, PointLayout.of(self.own.manifold).size
        gains, hessians = found.gains[..., :n], found.cost_hessians[:, :n, :n]
        at, maps = solution.times, found.maps[..., :size]
        until = float(at[np.searchsorted(found.times, found.until)])
        return replace(found, times=at, gains=gains, cost_hessians=hessians, until=until, solution=solution, maps=maps)

    def recover_covariance(self, found: Covariance) -> Covariance:
        """The covariance of the states and free parameters, a part of the covariance of the extended states."""
        n, every = self.own.manifold.dimension, found.states
        free = slice(n, n + self.kind.entries)
        return Covariance(every[:, :n, :n], every[0, free, free], every[:, :n, free])

    def rate(self, y: tuple) -> Any:
        """``e^s``, the time over that which is guessed."""
        return jnp.exp(y[1][-1] - self.at_guess) if self.kind.horizon else 1.0

    def _at(self, y: tuple, given: Any) -> tuple[Ambient, OptimalControlProblem, Any]:
        """The state, the problem with its parameters and its time, and the rate of that."""
        q, *added = y
        bound, entries, rate = self.own, self.kind.entries, self.rate(y)
        if bound.takes_parameters:
            bound = bound.with_parameters(
                self.kind.parameters(added[0][:entries] if self.constants else None, given[0])
            )
        return q, bound.at_time(given[2][0] + rate * added[-1][0] if self.own.time_dependent else None), rate

    def _velocity(self, y: tuple, u: Ambient, given: Any) -> tuple:
        q, bound, rate = self._at(y, given)
        velocity = bound.velocity(q, u)
        constants = [jnp.zeros(self.constants)] if self.constants else []
        clock = [jnp.ones(1)] if self.own.time_dependent else []
        return vec.scale(rate, velocity) if self.kind.horizon else velocity, *constants, *clock

    def _rate(self, y: tuple, u: Ambient, given: Any) -> Array:
        q, bound, rate = self._at(y, given)
        return rate * bound.cost_rate(q, u)

    def _node(self, y: tuple, k: Any, given: Any) -> Array:
        q, bound, _ = self._at(y, given)
        return bound.cost_at_node(q, k)

    def _boundary(self) -> BoundaryConditions:
        """The conditions of both ends."""
        boundary = self.own._boundary
        functions = tuple(self._of_state(self._between(place), 2) for place in range(len(boundary.names)))
        turn = None if boundary.turn is None else self._of_node(lambda bound, q: bound._periodic_end(q))
        return BoundaryConditions(boundary.names, functions, turn, factor=True, closed=boundary.closed)

    def _between(self, place: int) -> Callable[[tuple, tuple, Any], Any]:
        def between(first: tuple, last: tuple, given: Any) -> Any:
            (q, *_), (end, bound, _) = self._at(first, given), self._at(last, given)
            return bound._boundary.functions[place](q, end)

        return between

    def _limits(self) -> Inequalities:
        """The inequalities of the problem, and the bounds of the horizon and of the parameters at the first point."""
        limits, kind, names = self.own._limits, self.kind, list[str]()
        functions = [self._of_state(self._limit(place), 2) for place in range(len(limits.names))]
        begin = 0
        for name, bounded, sign in zip((HORIZON_LOWER, HORIZON_UPPER), kind.horizon_bounds, (1, -1), strict=True):
            if bounded:
                names.append(name)
                functions.append(self._of_state(self._bound_of([self.constants - 1], begin, sign), 2))
                begin += 1
        for name, entries, sign in ((PARAMETERS_LOWER, kind.below, 1), (PARAMETERS_UPPER, kind.above, -1)):
            if entries:
                names.append(name)
                functions.append(self._of_state(self._bound_of(list(entries), begin, sign), 2))
                begin += len(entries)
        at_nodes = tuple(
            self._of_node(lambda bound, q, k=k: bound._limits.node_functions[k](q))
            for k, _ in enumerate(limits.node_names)
        )
        held = (*limits.names, *names), tuple(functions), limits.at_first | frozenset(names)
        clock = not kind.horizon if self.own.time_dependent else None
        return Inequalities(limits.lower, limits.upper, *held, limits.node_names, at_nodes, clock)

    def _limit(self, place: int) -> Callable[[tuple, Ambient, Any], Any]:
        def limit(y: tuple, u: Ambient, given: Any) -> Any:
            q, bound, _ = self._at(y, given)
            return bound._limits.functions[place](q, u)

        return limit

    def _bound_of(self, entries: list[int], begin: int, sign: int) -> Callable[[tuple, Ambient, Any], Array]:
        def bound(y: tuple, u: Ambient, given: Any) -> Array:
            (bounds,) = given[1]
            return sign * (bounds[begin : begin + len(entries)] - y[1][np.array(entries)])

        return bound

    def _of_node(self, value: Callable[[OptimalControlProblem, Ambient], Any]) -> Callable[..., Any]:
        """A function of a state ``y``, from one of the problem at the time and of its own state."""

        def at(y: tuple, given: Any) -> Any:
            q, bound, _ = self._at(y, given)
            return value(bound, q)

        return self._of_state(at, 1)

    def _of_state(self, function: Callable[..., Any], count: int) -> Callable[..., Any]:
        """A function with parameters, or without if there are none."""
        if count == 1:
            return (lambda y, given: function(y, given)) if self.takes else (lambda y: function(y, ((), (), ())))
        return (
            (lambda y, u, given: function(y, u, given)) if self.takes else (lambda y, u: function(y, u, ((), (), ())))
        )


def extend_method(method: Method, beside: list[Addition]) -> Method:
    """The method on the product with vector spaces."""
    if isinstance(method, CollocationMethod):
        return method.on(ProductRetraction(method.retraction, *beside))
    if isinstance(method, Theta):
        other = None if method.other is None else ProductRetraction(method.other, *beside)
        return Theta(ProductRetraction(method.backward, *beside), method.theta, other)
    return _MethodBeside(method, tuple(beside))


@final
class _MethodBeside(DiscretizationMap):
    """A discretization map on a manifold, beside steps of vector spaces of which the base point has the same place."""

    first: DiscretizationMap
    beside: tuple[Addition, ...]

    @property
    def theta(self) -> float:
        return self.first.theta

    @property
    def order(self) -> int:
        return self.first.order

    @property
    def retraction(self) -> Retraction:
        return ProductRetraction(self.first.retraction, *self.beside)

    def __call__(self, x: tuple, v: tuple) -> tuple[tuple, tuple]:
        begin, end = self.first(x[0], v[0])
        rest = list(zip(x[1:], v[1:], strict=True))
        return (begin, *(a - self.theta * b for a, b in rest)), (end, *(a + (1 - self.theta) * b for a, b in rest))
