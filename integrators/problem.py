"""Optimal control problems and Pontryagin's Hamiltonian."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds import Euclidean, InvalidInputError, Manifold, NotOnManifoldError
from ..manifolds.manifold import default_tolerance, same_manifold, working_precision
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.errors import TRACEABLE
from ..retractions import DiscretizationMap, default_retraction
from .compilation import call_compiled

Dynamics = Callable[[Any, Any], Any]
RunningCost = Callable[[Any, Any], Any]
TerminalCost = Callable[[Any], Any]

CURVATURES = 3  # random controls and covectors at which d2H/du2 is looked at
SPREAD = 0.3  # size of the coordinates of these controls around the resting one
ROUNDING_POWER, SINGULAR_POWER = 0.9, 0.67  # of the machine epsilon: rows that are zero, smallest singular value of the others


@final
class OptimalControlProblem(eqx.Module):
    """Minimise ``int F(q, u) dt + Phi(q(T))`` subject to ``q' = X(q, u)`` on a manifold.

    ``dynamics(q, u)`` returns a tangent vector at ``q``, ``running_cost(q, u)`` and ``terminal_cost(q)`` a scalar; all are
    JAX functions. ``controls`` is the control manifold U. ``abnormal`` sets the cost multiplier p_0 to 0.
    """

    manifold: Manifold
    dynamics: Dynamics
    running_cost: RunningCost
    controls: Manifold
    terminal_cost: TerminalCost | None
    abnormal: bool = eqx.field(static=True)

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
        self.controls = Euclidean(controls) if isinstance(controls, int) else controls
        self.abnormal = abnormal
        for name, value in (("manifold", self.manifold), ("controls", self.controls)):
            if not isinstance(value, Manifold):
                raise InvalidInputError(f"{name} must be a Manifold, got {value!r}; try Euclidean(3)")
        functions = {"dynamics": dynamics, "running_cost": running_cost, "terminal_cost": terminal_cost or (lambda q: 0.0)}
        for name, value in functions.items():
            if not callable(value):
                of = "q" if name == "terminal_cost" else "(q, u)"
                raise InvalidInputError(f"{name} must be a function of {of}, got {value!r}")

    def velocity(self, q: Ambient, u: Ambient) -> Ambient:
        """``X(q, u)``. Raises ``InvalidInputError`` if ``dynamics`` returns something of another structure than a point."""
        v = self.dynamics(q, u)
        wrong = self.manifold.describe_mismatch(jax.eval_shape(lambda: v), "the value of dynamics, a tangent vector")
        if wrong:
            raise InvalidInputError(wrong)
        return v

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
        return jnp.zeros(()) if self.abnormal else _scalar("running_cost", self.running_cost(q, u))

    def final_cost(self, q: Ambient) -> Array:
        """Terminal cost ``Phi(q)``, zero if there is none."""
        return jnp.zeros(()) if self.terminal_cost is None else _scalar("terminal_cost", self.terminal_cost(q))

    def hamiltonian(self, q: Ambient, p: Ambient, u: Ambient) -> Array:
        """Pontryagin's Hamiltonian ``H(q, p, u) = <p, X(q, u)> - p_0 F(q, u)``."""
        return vec.pairing(p, self.velocity(q, u)) - self.cost_rate(q, u)

    def check_discretization(self, discretization: DiscretizationMap) -> None:
        """Raise if a discretization map acts on another manifold than this problem."""
        if not same_manifold(discretization.manifold, self.manifold):
            raise InvalidInputError(
                f"the discretization acts on {discretization.manifold}, the problem on {self.manifold}; use one manifold"
            )

    def check(self, q: Ambient, u: Ambient) -> bool:
        """Whether the problem is regular; raises if its functions return something of the wrong kind at ``(q, u)``.

        Regular: ``d2H/du2`` is invertible at one of a few random controls and covectors at ``q``.
        """
        try:
            found, *_ = call_compiled(_probe, self, q, u, *self._directions())
        except InvalidInputError:
            raise
        except (TypeError, ValueError, IndexError) as error:
            raise InvalidInputError(self._failure(error, q, u)) from error
        probed = jax.tree.map(np.asarray, found)
        self._require_finite(probed, q)
        normal, size = np.max(probed.normals), np.max(probed.sizes)
        if not normal <= default_tolerance() * (1 + size):
            raise NotOnManifoldError(
                f"dynamics leaves the tangent space of {self.manifold}: its normal part is {normal:.3g} (size of the velocity "
                f"{size:.3g}), expected 0; return a tangent vector, for instance manifold.projection(q, ...) of it"
            )
        return any(_invertible(curvature) for curvature in probed.curvatures)

    def _require_finite(self, probed: "_Probed", q: Ambient) -> None:
        """Raise if the functions, or their derivatives by the controls, are not finite where they were probed."""
        first = int(np.argmin(np.isfinite(probed.sizes)))  # the control that was asked for if all are
        u, size = jax.tree.map(lambda leaf: leaf[first], probed.controls), probed.sizes[first]
        if not np.all(np.isfinite((size, *probed.costs))):
            raise InvalidInputError(
                f"the problem's functions are not finite at q = {q}, u = {u}: size of the velocity {size:.3g}, running and "
                f"terminal cost {probed.costs[0]:.3g} and {probed.costs[1]:.3g}; check them there"
            )
        if not np.all(np.isfinite(probed.slopes)):
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
            reason, hint = "JAX cannot trace them", TRACEABLE
        elif not self._has_velocity(q, u) and self._has_velocity(u, q):
            hint = "dynamics accepts (u, q): its arguments are (q, u), in this order"
        return (
            f"the problem's functions fail at a point q of {self.manifold}, shape {shapes[0]}, and a control u of "
            f"{self.controls}, shape {shapes[1]}: {reason}; {hint}"
        )

    def _has_velocity(self, *arguments: Ambient) -> bool:
        try:
            jax.eval_shape(self.velocity, *arguments)
        except (TypeError, ValueError, IndexError):
            return False
        return True


class _Probed(NamedTuple):
    """What the functions of a problem give at a point: with the control asked for, and with another."""

    controls: Ambient
    normals: Array  # size of the normal part of the velocity, with each control
    sizes: Array  # size of the velocity, with each control
    costs: tuple[Array, Array]  # running and terminal, with the first control
    slopes: Array  # dH/du at the first control, for several covectors
    curvatures: Array  # d2H/du2, for several controls and covectors


def _probe(problem: OptimalControlProblem, q: Ambient, u: Ambient, directions: Ambient, covectors: Ambient) -> _Probed:
    """The functions at ``(q, u)``; curvatures at controls in ``directions`` from ``u``.

    The covectors are projections of ``covectors``.
    """
    controls = jax.tree.map(lambda *leaves: jnp.stack(leaves), u, problem.steer(u, directions[0]))
    normals, sizes = jax.vmap(lambda control: problem.normal_size(q, control))(controls)
    costs = problem.cost_rate(q, u), problem.final_cost(q)

    def hamiltonian(c: Array, covector: Ambient) -> Array:
        return problem.hamiltonian(q, problem.manifold.projection(q, covector), problem.steer(u, c))

    slopes = jax.vmap(lambda covector: jax.grad(hamiltonian)(jnp.zeros_like(directions[0]), covector))(covectors)
    curvatures = jax.vmap(jax.hessian(hamiltonian))(directions, covectors)
    return _Probed(controls, normals, sizes, costs, slopes, curvatures)


def _invertible(curvature: np.ndarray) -> bool:
    """Whether a symmetric matrix, in units of its rows, is invertible to rounding; so is one that is not finite."""
    if not np.all(np.isfinite(curvature)) or not curvature.size:
        return True
    rows, rounding = np.max(np.abs(curvature), axis=1), np.finfo(curvature.dtype).eps
    if np.min(rows) <= rounding**ROUNDING_POWER * np.max(rows):
        return False
    values = np.linalg.svd(curvature / np.sqrt(np.outer(rows, rows)), compute_uv=False)
    return bool(values[-1] > rounding**SINGULAR_POWER)


def _scalar(name: str, value: Any) -> Array:
    value = jnp.asarray(value)
    if value.shape != ():
        raise InvalidInputError(f"{name} must return a scalar, got an array of shape {value.shape}; sum it or pick an entry")
    return value
