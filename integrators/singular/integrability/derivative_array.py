"""The derivative array: time derivatives of the stationarity condition along an extremal.

With ``F_0 = dH/du`` and ``F_{j+1} = D_t F_j``, ``D_t`` the derivative along ``zdot = X_H(z, u)`` and ``(u, u', u'',
...)``, the set ``P^k`` of the integrability algorithm is the projection on ``T*Q`` of ``{F_0 = ... = F_k = 0}``, where
ranks are constant.
"""

from collections.abc import Callable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.experimental.jet import jet
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ....manifolds import CotangentBundle
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem

Pair = tuple[Ambient, Ambient]
Jet = Float[Array, "order+1 m"]
Flat = Float[Array, " N"]
# What jet raises of a primitive that it has no rule for, that is not in its table, and, before JAX 0.11 and since, that
# has derivatives of its own.
UNSUITED = NotImplementedError, KeyError, jax.errors.UnexpectedTracerError, AttributeError


def control_slope(problem: OptimalControlProblem, z: Pair, center: Ambient, c: Array) -> Float[Array, " m"]:
    """``dH/du`` at ``(z, u)`` in the chart of U around ``center``."""
    return jax.grad(lambda c: problem.hamiltonian(*z, problem._steer(center, c)))(c)


def hamiltonian_field(problem: OptimalControlProblem, z: Pair, u: Ambient) -> Pair:
    """``X_H(z, u)``, tangent to ``T*Q`` at ``z``, of the Hamiltonian with ``u`` held."""
    slope = jax.grad(lambda z: problem.hamiltonian(z[0], z[1], u))(z)
    return CotangentBundle(problem.manifold).sharp(z, slope)


@final
class DerivativeArray(eqx.Module):
    """``(F_0, ..., F_order)`` at a point of ``T*Q``, given the control and its derivatives in a chart of U.

    Computed by Taylor arithmetic, at a cost polynomial in the order. Functions that have no rule for it (linear solves,
    loops, those with derivatives of their own, as ``jax.nn.softplus``) fall back to nested derivatives, whose cost
    doubles with every order.
    """

    problem: OptimalControlProblem
    order: int = eqx.field(static=True)

    def __call__(self, z: Pair, center: Ambient, u: Jet) -> Jet:
        """The array, shape ``(order + 1, m)``; row ``i`` of ``u`` is the ``i``-th derivative of the control's
        coordinates."""
        flat, unravel = ravel_pytree(z)
        slope = jax.jit(lambda w, c: control_slope(self.problem, unravel(w), center, c))

        @jax.jit
        def field(w: Flat, c: Array) -> Flat:
            z = unravel(w)
            return ravel_pytree(hamiltonian_field(self.problem, z, self.problem._steer(center, c)))[0]

        try:
            return _taylor(field, slope, flat, u)
        except UNSUITED:
            return jnp.stack(_nest_derivatives(field, slope, self.order)(flat, u))


def _taylor(field: Callable[..., Flat], slope: Callable[..., Array], w: Flat, u: Jet) -> Jet:
    """Derivatives of ``slope`` along the solution of ``wdot = field(w, u)``, from the derivatives of the solution by
    orders."""
    if len(u) == 1:
        return slope(w, u[0])[None]
    rates, controls = [field(w, u[0])], list(u[1:])
    for k in range(1, len(controls)):
        _, further = jet(field, (w, u[0]), (rates[:k], controls[:k]))
        rates.append(further[-1])
    first, rest = jet(slope, (w, u[0]), (rates, controls))
    return jnp.stack([first, *rest])


def _nest_derivatives(
    field: Callable[..., Flat], slope: Callable[..., Array], order: int
) -> Callable[[Flat, Jet], tuple[Array, ...]]:
    """The function of ``_taylor`` by ``order`` nested directional derivatives; each returns all lower derivatives."""
    if order == 0:
        return lambda w, u: (slope(w, u[0]),)
    lower = _nest_derivatives(field, slope, order - 1)

    def array(w: Flat, u: Jet) -> tuple[Array, ...]:
        along = field(w, u[0]), jnp.concatenate([u[1:], jnp.zeros_like(u[:1])])
        values, rates = jax.jvp(lower, (w, u), along)
        return *values, rates[-1]

    return array
