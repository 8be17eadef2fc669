"""Optimal control problems and Pontryagin's Hamiltonian."""

from collections.abc import Callable
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds import Euclidean, InvalidInputError, Manifold, NotOnManifoldError
from ..manifolds.manifold import default_tolerance, same_manifold, working_precision
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
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
            probed, *_ = call_compiled(_probe, self, q, u, *self._directions())
        except InvalidInputError:
            raise
        except (TypeError, ValueError, IndexError) as error:
            raise InvalidInputError(self._failure(error, q, u)) from error
        normal, size, costs, curvatures = jax.tree.map(np.asarray, probed)
        if not np.all(np.isfinite((normal, size, *costs))):
            raise InvalidInputError(
                f"the problem's functions are not finite at q = {q}, u = {u}: size of the velocity {size}, running and terminal "
                f"cost {costs}; check them there"
            )
        if not normal <= default_tolerance() * (1 + size):
            raise NotOnManifoldError(
                f"dynamics leaves the tangent space of {self.manifold}: its normal part is {normal:.3g} (size of the velocity "
                f"{size:.3g}), expected 0; return a tangent vector, for instance manifold.projection(q, ...) of it"
            )
        return any(_invertible(curvature) for curvature in curvatures)

    def _directions(self) -> tuple[np.ndarray, Ambient]:
        """Random coordinates of controls and random ambient covectors, the same at every call."""
        draw = np.random.default_rng(0).standard_normal
        covectors = jax.tree.map(lambda s: draw((CURVATURES, *s.shape)).astype(s.dtype), self.manifold.ambient)
        return SPREAD * draw((CURVATURES, self.controls.dimension)).astype(working_precision()), covectors

    def _failure(self, error: Exception, q: Ambient, u: Ambient) -> str:
        """Words on an error that a function of the problem raises at ``(q, u)``: what it is given, and what to try."""
        shapes = [jax.tree.map(np.shape, a) for a in (q, u)]
        hint = "try another number of controls, or index what is there"
        if not self._has_velocity(q, u) and self._has_velocity(u, q):
            hint = "dynamics accepts (u, q): its arguments are (q, u), in this order"
        return (
            f"the problem's functions fail at a point q of {self.manifold}, shape {shapes[0]}, and a control u of "
            f"{self.controls}, shape {shapes[1]}: {error}; {hint}"
        )

    def _has_velocity(self, *arguments: Ambient) -> bool:
        try:
            jax.eval_shape(self.velocity, *arguments)
        except (TypeError, ValueError, IndexError):
            return False
        return True


def _probe(
    problem: OptimalControlProblem, q: Ambient, u: Ambient, directions: Ambient, covectors: Ambient
) -> tuple[Array, Array, tuple[Array, Array], Array]:
    """Largest normal part and size of the velocity, for ``u`` and for another control, both costs, and ``d2H/du2``.

    The last at controls in ``directions`` from ``u``, with the covectors that are projections of ``covectors``.
    """

    def probe(control: Ambient) -> tuple[Array, Array]:
        return problem.normal_size(q, control)

    def curvature(c: Array, covector: Ambient) -> Array:
        p = problem.manifold.projection(q, covector)
        return jax.hessian(lambda c: problem.hamiltonian(q, p, problem.steer(u, c)))(c)

    normal, size = (jnp.maximum(a, b) for a, b in zip(probe(u), probe(problem.steer(u, directions[0])), strict=True))
    costs = problem.cost_rate(q, u), problem.final_cost(q)
    return normal, size, costs, jax.vmap(curvature)(directions, covectors)


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
