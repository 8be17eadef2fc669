"""Optimal control problems and Pontryagin's Hamiltonian."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compute.jit_cache import digest
from ...hooks import Hook
from ...manifolds import Euclidean, InvalidInputError, Manifold, Product
from ...manifolds.bundles import same_manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import default_retraction
from .argument_errors import arguments_of, require_arguments, require_known_options, takes_more
from .boundary_conditions import PERIODIC, BoundaryConditions, BoundaryConstraint, boundary_words, identity, linkage
from .explicit_time import TIMELESS
from .notation import problem_notation
from .path_constraints import Constraint, Inequalities, constraint_words, node_words
from .problem_statement import Dynamics, ProblemStatement, RunningCost, TerminalCost
from .quantities import Quantities
from .sampling import Sampling
from .user_functions import BoundFunction, in_precision, real_number, shapes_in, with_last

check_functions: Hook[..., None] = Hook("integrators/problem_checks/inspection.py")


@final
class OptimalControlProblem(ProblemStatement):
    r"""An optimal control problem on a manifold: dynamics, cost, constraints and boundary conditions in JAX.

    Parameters
    ----------
    manifold : Manifold
        The states ``q``.
    dynamics : callable
        ``X(q, u)``, a tangent vector at ``q``: the derivative of the state with respect to time.
    running_cost : callable
        ``F(q, u)``, a number.
    controls : Manifold or int
        The control manifold U; ``m`` stands for ``Euclidean(m)``.
    terminal_cost : callable, optional
        ``Phi(q)``, a number, at the end.
    abnormal : bool
        Whether the cost multiplier ``p_0`` is 0 instead of 1.
    initial_cost : callable, optional
        ``Phi_0(q)``, a number, at the start.
    control_bounds : tuple of array_like, optional
        ``(lower, upper)`` for controls in R^m: numbers, or arrays of shape ``(m,)``, possibly infinite.
    constraints : mapping of str to callable, optional
        ``g(q, u) <= 0`` by name, numbers or vectors, at the stages of the method.
    time_dependent : bool
        Whether the functions take the time after these arguments; ``initial_cost`` does not.
    labels, units : mapping, optional
        Names and units of ``"states"`` and ``"controls"``: a word, or a tuple with a word for each entry of a vector or
        each array of a point. ``units`` also names ``"time"`` and ``"cost"``. Reports, pictures and tables use them.
    boundary_constraints : mapping of str to callable, optional
        ``b(q_0, q_T) = 0`` by name, numbers or vectors.
    periodic : bool or callable
        True for ``q(T) = q(0)``; a function ``g`` for ``q(T) = g(q(0))``.
    node_constraints : mapping of str to callable, optional
        ``g(q) <= 0`` by name, at the nodes, where steps meet.
    node_cost : callable, optional
        ``c(q, k)``, a number, at each node ``k = 0, ..., N``, such as the misfit of measurement ``k``; without time.
    sampling : Sampling, optional
        The step of a problem in discrete time, as ``hold_controls`` makes it.

    Notes
    -----
    The problem is to minimize :math:`\Phi_0(q(0)) + \int_0^T F(q, u)\,dt + \Phi(q(T)) + \sum_k c(q_k, k)` subject to
    :math:`\dot q = X(q, u)` and the constraints. Functions with one more argument get the ``parameters`` of ``solve``
    there. ``InvalidInputError`` for other arguments.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> float(line.hamiltonian(jnp.zeros(1), jnp.ones(1), jnp.ones(1)))
    0.5
    """

    @require_known_options
    def __init__(
        self,
        manifold: Manifold,
        dynamics: Dynamics,
        running_cost: RunningCost,
        controls: Manifold | int,
        terminal_cost: TerminalCost | None = None,
        abnormal: bool = False,
        initial_cost: TerminalCost | None = None,
        control_bounds: tuple[Any, Any] | None = None,
        constraints: Mapping[str, Constraint] | None = None,
        time_dependent: bool = False,
        labels: Mapping[str, Any] | Quantities | None = None,
        units: Mapping[str, Any] | None = None,
        boundary_constraints: Mapping[str, BoundaryConstraint] | None = None,
        periodic: bool | Callable[..., Any] = False,
        node_constraints: Mapping[str, Constraint] | None = None,
        node_cost: Callable[..., Any] | None = None,
        sampling: Sampling | None = None,
    ) -> None:
        self.manifold = manifold
        self.dynamics, self.running_cost = dynamics, running_cost
        self.terminal_cost, self.initial_cost, self.node_cost = terminal_cost, initial_cost, node_cost
        self.controls = Euclidean(int(controls)) if isinstance(controls, int | np.integer) else controls
        self.abnormal, self.time_dependent, self.sampling = abnormal, time_dependent, sampling
        self._require_types()
        given: Any = constraints
        is_made = isinstance(given, Inequalities)
        self._limits = given if is_made else Inequalities.of(control_bounds, given, node_constraints, self.controls)
        named = Quantities.of(self.manifold, self.controls, labels, units)
        self.quantities = named.bounded(self._limits.lower, self._limits.upper)
        self._boundary = BoundaryConditions.of(boundary_constraints, periodic, self._limits.every_name)
        expected = (
            ("q", "(q, t)", "(q, u, t)", "(q_0, q_T, t)") if time_dependent else ("q", "q", "(q, u)", "(q_0, q_T)")
        )
        each = self._functions()
        takes = [require_arguments(n, f, (*expected, "(q, k)")[kind], more="parameters") for n, f, kind in each]
        self.takes_parameters = any(takes)

    def _require_types(self) -> None:
        """Raise if an argument that is no function has another type than expected."""
        for name, example in (("manifold", "SO(3)"), ("controls", "Euclidean(3)")):
            if not isinstance(getattr(self, name), Manifold):
                raise InvalidInputError(f"{name} must be a Manifold, got {getattr(self, name)!r}; try {example}")
        flag, sampled = (bool | np.bool_, "True or False"), (Sampling | None, "made by hold_controls")
        for name, (kind, words) in {"abnormal": flag, "time_dependent": flag, "sampling": sampled}.items():
            if not isinstance(getattr(self, name), kind):
                raise InvalidInputError(f"{name} must be {words}, got {getattr(self, name)!r}")

    def _functions(self) -> Iterator[tuple[str, Callable[..., Any], int]]:
        """Names of the functions, the functions, and the kinds of their arguments.

        A kind is 4 for a node and its index, 3 for both ends, 2 for state and control, 1 for a state and its time, 0
        for a state.
        """
        names = ("dynamics", 2), ("running_cost", 2), ("terminal_cost", 1), ("initial_cost", 0), ("node_cost", 4)
        for name, kind in names:
            if getattr(self, name) is not None or kind == 2:
                yield name, getattr(self, name), kind
        for name, function in zip(self._limits.names, self._limits.functions, strict=True):
            yield constraint_words(name), function, 2
        for name, function in zip(self._limits.node_names, self._limits.node_functions, strict=True):
            yield node_words(name), function, 1
        for name, function in zip(self._boundary.names, self._boundary.functions, strict=True):
            yield boundary_words(name), function, 3
        if self._boundary.turn is not None:
            yield PERIODIC, self._boundary.turn, 0

    @property
    def control_bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The bounds of the controls, arrays of their shape; None if there are none."""
        return self._limits.bounds(self._shape)

    @property
    def constraints(self) -> dict[str, Constraint]:
        """The constraints by their names."""
        return dict(zip(self._limits.names, self._limits.functions, strict=True))

    @property
    def node_constraints(self) -> dict[str, Constraint]:
        """The constraints at the nodes by their names."""
        return dict(zip(self._limits.node_names, self._limits.node_functions, strict=True))

    def __repr__(self) -> str:
        """The problem in mathematical notation."""
        return f"OptimalControlProblem:\n{problem_notation(self)}"

    def with_parameters(self, parameters: Any) -> "OptimalControlProblem":
        """The problem with these values as the parameters of its functions.

        Parameters
        ----------
        parameters : pytree of arrays
            The values, as ``solve`` takes them.

        Returns
        -------
        OptimalControlProblem
            The same problem if its functions take no parameters.
        """
        if not self.takes_parameters:
            return self
        # A node cost reads them at a traced index, which arrays of NumPy do not take.
        arrays = parameters if self.node_cost is None else jax.tree.map(jnp.asarray, parameters)
        return self._map_functions(lambda f, kind: with_last(f, self._counts[kind], arrays), self.time_dependent)

    @property
    def _counts(self) -> tuple[int, ...]:
        """The numbers of arguments of functions of each kind, without parameters."""
        return (1, 2, 3, 3, 2) if self.time_dependent else (1, 1, 2, 2, 2)

    @property
    def _first_with_parameters(self) -> str:
        """Words on the first function that takes parameters."""
        first, of, kind = next(part for part in self._functions() if takes_more(part[1], self._counts[part[2]]))
        count = self._counts[kind]
        return f"{first} has the arguments {arguments_of(of)}, one more than the {count} of one without parameters"

    def at_time(self, t: Any) -> "OptimalControlProblem":
        """The problem at one instant, of which no function takes the time.

        Parameters
        ----------
        t : float
            The time, in the unit of the horizon.

        Returns
        -------
        OptimalControlProblem
            The same problem if it is not ``time_dependent``.
        """
        if not self.time_dependent:
            return self
        time = jnp.asarray(t, float)  # of Python's own numbers the inverse of zero is an error
        return self._map_functions(lambda f, kind: f if kind in TIMELESS else BoundFunction(f, time), False)

    def _map_functions(
        self, change: Callable[[Callable[..., Any], int], Callable[..., Any]], time_dependent: bool
    ) -> "OptimalControlProblem":
        """The problem with every function replaced by ``change(function, kind)``."""
        given: dict[str, Any] = {name: change(function, kind) for name, function, kind in self._functions()}
        limits, ends = self._limits, self._boundary
        functions = tuple(given[constraint_words(name)] for name in limits.names)
        at_nodes = tuple(given[node_words(name)] for name in limits.node_names)
        limits = limits.with_functions(functions, at_nodes)
        between = tuple(given[boundary_words(name)] for name in ends.names)
        boundary = BoundaryConditions(ends.names, between, given.get(PERIODIC), ends.factor, ends.closed)
        names = "dynamics", "running_cost", "terminal_cost", "initial_cost", "node_cost"
        more: Any = {"constraints": limits, "boundary_constraints": boundary, "time_dependent": time_dependent}
        return self._with_arguments(**more, **{name: given[name] for name in names if name in given})

    def _with_arguments(self, **changes: Any) -> "OptimalControlProblem":
        """The problem with other arguments, which may be ``Inequalities`` and ``BoundaryConditions`` too."""
        names = "manifold", "dynamics", "running_cost", "controls", "terminal_cost", "initial_cost", "node_cost"
        given: Any = {name: getattr(self, name) for name in (*names, "abnormal", "time_dependent", "sampling")}
        given |= {"constraints": self._limits, "boundary_constraints": self._boundary, "labels": self.quantities}
        return OptimalControlProblem(**given | changes)

    def inequalities(self, q: Ambient, u: Ambient) -> Float[Array, " k"]:
        """The values of all bounds and constraints at a point, each feasible if ``<= 0``.

        Parameters
        ----------
        q, u : point, control
            The state and the control, arrays of the shapes of their manifolds.

        Returns
        -------
        array of shape (k,)
            ``lower - u`` and ``u - upper`` for the finite bounds, then the constraints in order.
        """
        return self._limits.values(q, u)

    def node_inequalities(self, q: Ambient) -> Float[Array, " k"]:
        """The values of the node constraints in order, shape ``(k,)``, each feasible if ``<= 0``.

        Parameters
        ----------
        q : point
            The state, an array or a tuple of arrays of the shapes of the manifold.
        """
        return self._limits.at_node(q)

    def velocity(self, q: Ambient, u: Ambient) -> Ambient:
        """The velocity ``X(q, u)``; ``InvalidInputError`` if ``dynamics`` returns another structure than a point.

        Parameters
        ----------
        q, u : point, control
            The state and the control, arrays of the shapes of their manifolds.
        """
        v = self.dynamics(q, u)
        if v is None:
            raise InvalidInputError("dynamics must return a tangent vector, got nothing; did it forget to return?")
        wrong = self.manifold.describe_mismatch(shapes_in(v), "the value of dynamics, a tangent vector")
        if wrong:
            raise InvalidInputError(wrong)
        return jax.tree.map(lambda s, a: in_precision("dynamics", a, s.dtype), self.manifold.ambient, v)

    def _steer(self, u: Ambient, c: Array) -> Ambient:
        """The control with coordinates ``c``, shape ``(m,)``, in the retraction chart of U around ``u``."""
        retraction = default_retraction(self.controls)
        return retraction.chart(u, retraction.frame(u), c)

    def cost_rate(self, q: Ambient, u: Ambient) -> Array:
        """The running cost ``p_0 F(q, u)``, which is zero in the abnormal case.

        Parameters
        ----------
        q, u : point, control
            The state and the control, arrays of the shapes of their manifolds.
        """
        return jnp.zeros(()) if self.abnormal else real_number("running_cost", self.running_cost(q, u))

    def final_cost(self, q: Ambient) -> Array:
        """The terminal cost ``Phi(q)``, zero for a problem without terminal cost.

        Parameters
        ----------
        q : point
            The state, an array or a tuple of arrays of the shapes of the manifold.
        """
        return jnp.zeros(()) if self.terminal_cost is None else real_number("terminal_cost", self.terminal_cost(q))

    def first_cost(self, q: Ambient) -> Array:
        """The initial cost ``Phi_0(q)``, zero for a problem without initial cost.

        Parameters
        ----------
        q : point
            The state, an array or a tuple of arrays of the shapes of the manifold.
        """
        return jnp.zeros(()) if self.initial_cost is None else real_number("initial_cost", self.initial_cost(q))

    def cost_at_node(self, q: Ambient, k: Any) -> Array:
        """The node cost ``c(q, k)``, zero for a problem without node cost.

        Parameters
        ----------
        q : point
            The state, an array or a tuple of arrays of the shapes of the manifold.
        k : int
            The index of the node.
        """
        return jnp.zeros(()) if self.node_cost is None else real_number("node_cost", self.node_cost(q, k))

    @property
    def _starts_with_cost(self) -> bool:
        """Whether the first node has a cost, the initial cost or a node cost."""
        return self.initial_cost is not None or self.node_cost is not None

    def _start_cost(self, q: Ambient) -> Array:
        """All costs of the first node."""
        return self.first_cost(q) + self.cost_at_node(q, 0)

    def _periodic_end(self, q: Ambient) -> Ambient:
        """``g(q)`` of periodic ends, ``q(T) = g(q(0))``."""
        own = (
            self.manifold.factors[0] if self._boundary.factor and isinstance(self.manifold, Product) else self.manifold
        )
        return linkage(PERIODIC, self._boundary.turn or identity, own, q)

    def _parts(self, q: Ambient, p: Ambient, u: Ambient) -> tuple[Array, Array]:
        """The power ``<p, X(q, u)>`` and the cost rate ``p_0 F(q, u)``."""
        return vec.pairing(p, self.velocity(q, u)), self.cost_rate(q, u)

    def hamiltonian(self, q: Ambient, p: Ambient, u: Ambient) -> Array:
        r"""Pontryagin's Hamiltonian :math:`H(q, p, u) = \langle p, X(q, u) \rangle - p_0 F(q, u)`, a scalar.

        Parameters
        ----------
        q, p, u : point, covector, control
            The state, the costate and the control.
        """
        power, rate = self._parts(q, p, u)
        return power - rate

    def _digest(self, parameters: Any = None) -> bytes | None:
        """A digest of the results of the functions, with the values that they use now; None if there is none.

        ``parameters``: an example of the structure.
        """
        examples = self.manifold.ambient, self.controls.ambient, parameters, np.zeros(()), np.zeros((), int)
        return digest(lambda q, u, p, t, k: self.with_parameters(p).at_time(t)._values(k, q, u), *examples)

    def _values(self, k: Any, q: Ambient, u: Ambient) -> tuple[Any, ...]:
        """The values of all functions, at node ``k``."""
        ends = self._boundary.values(q, q), None if self._boundary.turn is None else self._periodic_end(q)
        costs = self.cost_rate(q, u), self.final_cost(q), self.first_cost(q), self.cost_at_node(q, k)
        return self.velocity(q, u), *costs, self.inequalities(q, u), self.node_inequalities(q), ends

    def check(self, q: Ambient, u: Ambient) -> None:
        """Raise if the functions return a wrong kind at ``(q, u)``, or are not smooth in the controls there.

        Parameters
        ----------
        q, u : point, control
            The state and the control, arrays of the shapes of their manifolds.

        Raises
        ------
        InvalidInputError
            With the name of the function, what the function returns, and what to try.
        """
        check_functions(self, q, u)


def is_same_problem(a: object, b: object) -> bool:
    """Whether two problems have the same manifolds, and functions with the same results for the values used now."""
    if a is b or not (isinstance(a, OptimalControlProblem) and isinstance(b, OptimalControlProblem)):
        return a is b
    return (
        same_manifold(a.manifold, b.manifold)
        and same_manifold(a.controls, b.controls)
        and a._digest() == b._digest() is not None
    )
