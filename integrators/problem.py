"""Optimal control problems and Pontryagin's Hamiltonian."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds import Euclidean, InvalidInputError, Manifold, NotOnManifoldError, RetraxError
from ..manifolds.manifold import default_tolerance, same_manifold, working_precision
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.errors import TRACEABLE
from ..manifolds.numerics.reading import traced
from ..retractions import DiscretizationMap, Gauss, default_retraction
from .compilation import call_compiled, digest
from .functions import failing_line, in_precision, real_number
from .options import HORIZON, known_options, require_arguments, takes_more
from .probing import (
    CURVATURES,
    LADDER,
    ROUNDING,
    SPREAD,
    Probed,
    along_lines,
    bend,
    cost_rates,
    flats,
    kink_words,
    probe,
    terminal_costs,
)

FAILURES = TypeError, ValueError, IndexError, AttributeError, KeyError  # of functions that are given something else than expected

Dynamics = Callable[[Any, Any], Any]
RunningCost = Callable[[Any, Any], Any]
TerminalCost = Callable[[Any], Any]


@final
class OptimalControlProblem(eqx.Module):
    """Minimise ``int F(q, u) dt + Phi(q(T))`` subject to ``q' = X(q, u)`` on a manifold.

    ``dynamics(q, u)`` returns a tangent vector at ``q``, ``running_cost(q, u)`` and ``terminal_cost(q)`` a scalar; all are
    JAX functions. ``controls`` is the control manifold U. ``abnormal`` sets the cost multiplier p_0 to 0. Functions that take one
    more argument are given the ``parameters`` of a call of ``solve`` there, any pytree of numbers and arrays; then
    ``takes_parameters`` is True, and ``with_parameters`` makes a problem without them.
    """

    manifold: Manifold
    dynamics: Dynamics
    running_cost: RunningCost
    controls: Manifold
    terminal_cost: TerminalCost | None
    abnormal: bool = eqx.field(static=True)
    takes_parameters: bool = eqx.field(static=True)

    @known_options
    def __init__(
        self,
        manifold: Manifold,
        dynamics: Dynamics,
        running_cost: RunningCost,
        controls: Manifold | int,
        terminal_cost: TerminalCost | None = None,
        abnormal: bool = False,
    ) -> None:
        self.manifold = manifold
        self.dynamics, self.running_cost, self.terminal_cost = dynamics, running_cost, terminal_cost
        self.controls = Euclidean(int(controls)) if isinstance(controls, int | np.integer) else controls
        self.abnormal = abnormal
        for name, value in (("manifold", self.manifold), ("controls", self.controls)):
            if not isinstance(value, Manifold):
                raise InvalidInputError(f"{name} must be a Manifold, got {value!r}; try Euclidean(3)")
        if not isinstance(abnormal, bool | np.bool_):
            raise InvalidInputError(f"abnormal must be True or False, got {abnormal!r}")
        takes = require_arguments("dynamics", dynamics, "(q, u)", more="parameters")
        takes |= require_arguments("running_cost", running_cost, "(q, u)", more="parameters")
        if terminal_cost is not None:
            takes |= require_arguments("terminal_cost", terminal_cost, "q", more="parameters")
        self.takes_parameters = takes

    def with_parameters(self, parameters: Any) -> "OptimalControlProblem":
        """The problem whose functions have the parameters; the problem itself if they take none."""
        if not self.takes_parameters:
            return self
        names = (("dynamics", 2), ("running_cost", 2), ("terminal_cost", 1))
        bound = (_bound(getattr(self, name), count, parameters) for name, count in names)
        dynamics, running_cost, terminal_cost = bound
        return OptimalControlProblem(self.manifold, dynamics, running_cost, self.controls, terminal_cost, self.abnormal)

    def velocity(self, q: Ambient, u: Ambient) -> Ambient:
        """``X(q, u)``. Raises ``InvalidInputError`` if ``dynamics`` returns something of another structure than a point."""
        v = self.dynamics(q, u)
        wrong = self.manifold.describe_mismatch(jax.eval_shape(lambda: v), "the value of dynamics, a tangent vector")
        if wrong:
            raise InvalidInputError(wrong)
        return jax.tree.map(lambda s, a: in_precision("dynamics", a, s.dtype), self.manifold.ambient, v)

    def steer(self, u: Ambient, c: Array) -> Ambient:
        """The control with coordinates ``c``, shape ``(m,)``, in the retraction chart of U around ``u``."""
        retraction = default_retraction(self.controls)
        return retraction.chart(u, retraction.frame(u), c)

    def normal_size(self, q: Ambient, u: Ambient) -> tuple[Array, Array]:
        """Sizes of the normal part of ``X(q, u)``, which is zero for dynamics on the manifold, and of ``X(q, u)``."""
        v = self.velocity(q, u)
        return vec.size(vec.subtract(v, self.manifold.projection(q, v))), vec.size(v)

    def cost_rate(self, q: Ambient, u: Ambient) -> Array:
        """``p_0 F(q, u)``: the running cost, zero in the abnormal case."""
        return jnp.zeros(()) if self.abnormal else real_number("running_cost", self.running_cost(q, u))

    def final_cost(self, q: Ambient) -> Array:
        """Terminal cost ``Phi(q)``, zero if there is none."""
        return jnp.zeros(()) if self.terminal_cost is None else real_number("terminal_cost", self.terminal_cost(q))

    def parts(self, q: Ambient, p: Ambient, u: Ambient) -> tuple[Array, Array]:
        """The power ``<p, X(q, u)>`` and the cost rate ``p_0 F(q, u)``."""
        return vec.pairing(p, self.velocity(q, u)), self.cost_rate(q, u)

    def hamiltonian(self, q: Ambient, p: Ambient, u: Ambient) -> Array:
        """Pontryagin's Hamiltonian ``H(q, p, u) = <p, X(q, u)> - p_0 F(q, u)``."""
        power, rate = self.parts(q, p, u)
        return power - rate

    def imprecise(self, q: Ambient, u: Ambient) -> str:
        """Words on functions that compute in a lower precision than is in use; empty if none does."""
        eps = np.finfo(working_precision()).eps
        for name in ("dynamics", "running_cost"):
            kinds = [leaf.dtype for leaf in jax.tree.leaves(jax.eval_shape(getattr(self, name), q, u))]
            low = [kind for kind in kinds if jnp.issubdtype(kind, jnp.inexact) and jnp.finfo(kind).eps > eps]
            if low:
                return (
                    f"{name} returns {low[0]} values where {working_precision()} is in use, and no condition can be met to more "
                    f"digits than these have; compute it in {working_precision()}, or give a tolerance above "
                    f"{float(jnp.finfo(low[0]).eps):.0e}"
                )
        return ""

    def digest(self) -> bytes | None:
        """A digest of what the functions compute, with the values that they read now; None where that cannot be told."""

        def functions(q: Ambient, u: Ambient) -> tuple[Ambient, Array, Array]:
            return self.velocity(q, u), self.cost_rate(q, u), self.final_cost(q)

        return digest(functions, self.manifold.ambient, self.controls.ambient)

    def check_discretization(self, discretization: DiscretizationMap | Gauss) -> None:
        """Raise if a discretization map or a Gauss method acts on another manifold than this problem."""
        if not same_manifold(discretization.manifold, self.manifold):
            raise InvalidInputError(
                f"the discretization acts on {discretization.manifold}, the problem on {self.manifold}; use one manifold"
            )

    def check(self, q: Ambient, u: Ambient) -> bool:
        """Whether the problem is regular; raises if its functions return something of the wrong kind at ``(q, u)``.

        Regular: ``d2H/du2`` is invertible at one of a few random controls and covectors at ``q``. Raises too where it is not,
        and the functions have a kink in the controls.
        """
        directions, covectors = self._directions()
        probed = self._probed(q, u, directions, covectors)
        self._require_finite(probed, q)
        normal, size = np.max(probed.normals), np.max(probed.sizes)
        if not normal <= default_tolerance() * (1 + size):
            raise NotOnManifoldError(
                f"dynamics leaves the tangent space of {self.manifold}: its normal part is {normal:.3g} (size of the velocity "
                f"{size:.3g}), expected 0; return a tangent vector, for instance manifold.projection(q, ...) of it"
            )
        return self._is_regular(probed, q, u, directions, covectors)

    def require_no_kink(self, q: Ambient) -> None:
        """Raise if ``d2H/du2`` has null directions along which ``dH/du`` is not constant, as that of ``|u|``."""
        u, (directions, covectors) = resting_control(self.controls), self._directions()
        self._is_regular(self._probed(q, u, directions, covectors), q, u, directions, covectors)

    def require_cost(self, q: Ambient, end: Ambient, fixed: tuple[bool, ...] = ()) -> None:
        """Raise if both costs are a number each, near ``q`` and at random points with random controls.

        The terminal one at points of which the arrays that are ``fixed`` at the end are those of ``end``.
        """
        directions = np.concatenate([size * self._directions()[0] for size in (1, 1e2, 1e4)])
        moves = np.random.default_rng(0).standard_normal((CURVATURES + 1, self.manifold.dimension)).astype(directions.dtype)
        moves[0] = 0.0
        costs, slopes = call_compiled(cost_rates, self, q, moves, resting_control(self.controls), directions)[0]
        if self.abnormal or not _is_one_number(costs, np.max(slopes)):
            return
        terminal = "no terminal cost of a free end is given"
        if self.terminal_cost is not None and not (fixed and all(fixed)):
            ends, tilts = self._terminal(self._points(end, fixed))
            if not _is_one_number(ends, max(np.max(np.abs(tilt)) for tilt in _free_leaves(tilts, fixed))):
                return
            terminal = f"the terminal cost is {float(ends[0]):.6g} at every end"
        raise InvalidInputError(
            f"the running cost is {float(costs[0, 0]):.6g} at every state and control that was tried, and {terminal}: over a "
            "fixed horizon all curves from start to end then cost the same, and none is the solution; expected a cost of states "
            f"or controls, such as u @ u / 2; if time is to be short, {HORIZON}"
        )

    def is_steep_at(self, fixed: tuple[bool, ...] = ()) -> bool:
        """Whether the differential of the terminal cost vanishes nowhere, because an entry of it is one number, not zero.

        Where that is free, of arrays that are not ``fixed``, no extremal ends with ``p = 0``.
        """
        if self.terminal_cost is None:
            return False
        _, tilts = self._terminal(self._points(self.manifold.random_point(jax.random.key(1))))
        rounding = ROUNDING * np.finfo(working_precision()).eps
        return any(
            bool(np.any((a[0] != 0) & np.all(np.abs(a - a[0]) <= rounding * np.abs(a[0]), axis=0)))
            for a in _free_leaves(tilts, fixed)
        )

    def _points(self, q: Ambient, fixed: tuple[bool, ...] = ()) -> Ambient:
        """A point and random ones, along the leading axis; those of its arrays that are ``fixed`` are the same in all."""
        keys = jax.random.split(jax.random.key(0), CURVATURES)
        points = [jax.tree.map(np.asarray, x) for x in (q, *map(self.manifold.random_point, keys))]
        leaves, structure = jax.tree.flatten(jax.tree.map(lambda *leaves: np.stack(leaves), *points))
        known = fixed or (False,) * len(leaves)
        leaves = [np.broadcast_to(a[0], a.shape) if is_known else a for a, is_known in zip(leaves, known, strict=True)]
        return jax.tree.unflatten(structure, leaves)

    def _terminal(self, points: Ambient) -> tuple[np.ndarray, Ambient]:
        return jax.tree.map(np.asarray, call_compiled(terminal_costs, self, points)[0])

    def _probed(self, q: Ambient, u: Ambient, directions: np.ndarray, covectors: Ambient) -> Probed:
        """The functions at ``(q, u)`` and around, in NumPy arrays; raises if they fail there."""
        try:
            found, *_ = call_compiled(probe, self, q, u, directions, covectors)
        except RetraxError:
            raise
        except FAILURES as error:
            raise InvalidInputError(self._failure(error, q, u)) from error
        return jax.tree.map(np.asarray, found)

    def require_values(self) -> None:
        """Raise if the functions cannot be called with a point and a control, or return something of another kind."""
        q, u = (jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), m.ambient) for m in (self.manifold, self.controls))
        try:
            traced(lambda q, u: (self.velocity(q, u), self.cost_rate(q, u), self.final_cost(q)), q, u)
        except RetraxError:
            raise
        except FAILURES as error:
            raise InvalidInputError(self._failure(error, q, u)) from error

    def _is_regular(self, probed: Probed, q: Ambient, u: Ambient, directions: np.ndarray, covectors: Ambient) -> bool:
        """Whether a second derivative by the controls is invertible; raises if it is not because of a kink."""
        found = flats(probed, directions)
        if not all(found):
            return True
        every = [flat for ways in found for flat in ways]
        bases, ways = (np.stack([getattr(flat, name) for flat in every]) for name in ("bases", "direction"))
        given = jax.tree.map(lambda leaf: leaf[np.array([flat.sample for flat in every])], covectors)
        ladder = LADDER.astype(directions.dtype)
        along = jax.device_get(call_compiled(along_lines, self, q, u, given, bases, ways, ladder)[0])
        bends = [bend(flat, jax.tree.map(lambda leaf, k=k: leaf[k], along)) for k, flat in enumerate(every)]
        for flat, bent, slopes in zip(every, bends, along.slopes, strict=True):
            if bent is not None and not bent.smooth:
                there = [self.steer(u, flat.bases[bent.line] + t * flat.direction) for t in (0.0, LADDER[bent.place])]
                raise InvalidInputError(kink_words(bent, flat.direction, slopes[bent.line, [0, bent.place], bent.part], there))
        counts = np.cumsum([0, *map(len, found)])
        return any(all(bent is not None for bent in bends[a:b]) for a, b in pairwise(counts))

    def _require_finite(self, probed: Probed, q: Ambient) -> None:
        """Raise if the functions, or their derivatives by the controls, are not finite where they were probed."""
        first = int(np.argmin(np.isfinite(probed.sizes)))  # the control that was asked for if all are
        u, size = jax.tree.map(lambda leaf: leaf[first], probed.controls), probed.sizes[first]
        if not np.all(np.isfinite((size, *probed.costs))):
            raise InvalidInputError(
                f"the problem's functions are not finite at q = {q}, u = {u}: size of the velocity {size:.3g}, running and "
                f"terminal cost {probed.costs[0]:.3g} and {probed.costs[1]:.3g}; check them there"
            )
        if not np.all(np.isfinite(probed.slopes[0])):
            raise InvalidInputError(
                f"the problem's functions have no finite derivative by the controls at q = {q}, u = {u}; try functions that "
                "are smooth there, as u @ u or sqrt(u @ u + 1e-6) in place of sqrt(u @ u)"
            )

    def _directions(self) -> tuple[np.ndarray, Ambient]:
        """Random coordinates of controls and random ambient covectors, the same at every call."""
        draw = np.random.default_rng(0).standard_normal
        covectors = jax.tree.map(lambda s: draw((CURVATURES, *s.shape)).astype(s.dtype), self.manifold.ambient)
        return SPREAD * draw((CURVATURES, self.controls.dimension)).astype(working_precision()), covectors

    def _failure(self, error: Exception, q: Ambient, u: Ambient) -> str:
        """Words on an error that a function of the problem raises at ``(q, u)``: what it is given, and what to try."""
        shapes = [jax.tree.map(np.shape, a) for a in (q, u)]
        reason, hint = str(error), "try another number of controls, or index what is there"
        if isinstance(error, jax.errors.JAXTypeError):
            reason, hint = f"JAX cannot trace them ({type(error).__name__})", TRACEABLE
        elif not self._has_velocity(q, u) and self._has_velocity(u, q):
            hint = "dynamics accepts (u, q): its arguments are (q, u), in this order"
        names = "dynamics", "running_cost", "terminal_cost"
        where = failing_line(error, {name: getattr(self, name) for name in names})
        return (
            f"the problem's functions fail at a point q of {self.manifold}, shape {shapes[0]}, and a control u of "
            f"{self.controls}, shape {shapes[1]}{where and ', in ' + where}: {reason}; {hint}"
        )

    def _has_velocity(self, *arguments: Ambient) -> bool:
        try:
            jax.eval_shape(self.velocity, *arguments)
        except FAILURES:
            return False
        return True


def _free_leaves(tree: Any, fixed: tuple[bool, ...]) -> list[np.ndarray]:
    """Arrays of a pytree that are not ``fixed``, all if that is empty."""
    leaves = jax.tree.leaves(tree)
    return [leaf for leaf, known in zip(leaves, fixed or (False,) * len(leaves), strict=True) if not known]


def _is_one_number(values: np.ndarray, slope: Any) -> bool:
    """Whether values of a function, and the largest of its slopes, say that it is constant."""
    rounding = ROUNDING * np.finfo(working_precision()).eps * np.max(np.abs(values))
    return bool(np.ptp(values) <= rounding and slope <= rounding)


def resting_control(controls: Manifold) -> Ambient:
    """A point of the control manifold to begin from: zero in Euclidean space, a fixed random point elsewhere."""
    return (
        np.zeros(controls.shape, working_precision())
        if isinstance(controls, Euclidean)
        else controls.random_point(jax.random.key(0))
    )


def is_same_problem(a: object, b: object) -> bool:
    """Whether two problems have the same manifolds, and functions that compute the same with the values that they read now."""
    if a is b or not (isinstance(a, OptimalControlProblem) and isinstance(b, OptimalControlProblem)):
        return a is b
    return (
        same_manifold(a.manifold, b.manifold) and same_manifold(a.controls, b.controls) and a.digest() == b.digest() is not None
    )


def _bound(function: Any, count: int, parameters: Any) -> Any:
    """The function of its first arguments, with the parameters where it takes them."""
    if function is None or not takes_more(function, count):
        return function
    return lambda *arguments: function(*arguments, parameters)
