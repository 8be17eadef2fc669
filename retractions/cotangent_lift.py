"""The cotangent lift of a discretization map, a symplectomorphism from TT*Q to T*Q x T*Q.

``R_d^{T*} = Phi^-1 o hat(R_d) o alpha^-1`` with ``hat(F) = (TF^-1)^*``, ``alpha: T*TQ -> TT*Q`` and
``Phi: T*Q x T*Q -> T*(Q x Q)`` [Barbero-Linan, Martin de Diego, "Presymplectic integrators for optimal control problems via
retraction maps", section 3.1, with alpha read in the direction in which its formula is written].
"""

from collections.abc import Callable
from typing import final

import jax
import jax.numpy as jnp

from ..manifolds import CotangentBundle, InvalidInputError, Manifold, Product, TangentBundle
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from .discretization import DiscretizationMap
from .retraction import Retraction

Pair = tuple[Ambient, Ambient]
Quadruple = tuple[Ambient, Ambient, Ambient, Ambient]


def alpha(q: Ambient, v: Ambient, p_q: Ambient, p_v: Ambient) -> Quadruple:
    """``alpha: T*TQ -> TT*Q``, ``(q, v, p_q, p_v) -> (q, p, qdot, pdot) = (q, p_v, v, p_q)``."""
    return q, p_v, v, p_q


def alpha_inverse(q: Ambient, p: Ambient, qdot: Ambient, pdot: Ambient) -> Quadruple:
    """``alpha^-1: TT*Q -> T*TQ``, ``(q, p, qdot, pdot) -> (q, v, p_q, p_v) = (q, qdot, pdot, p)``.

    The covector on ``TQ`` at ``(q, v)`` is ``(dq, dv) -> <p_q, dq> + <p_v, dv>``.
    """
    return q, qdot, pdot, p


def Phi(z0: Pair, z1: Pair) -> tuple[Pair, Pair]:
    """``Phi: T*Q x T*Q -> T*(Q x Q)``, ``(q0, p0; q1, p1) -> ((q0, q1), (-p0, p1))``: a point and a covector there."""
    (q0, p0), (q1, p1) = z0, z1
    return (q0, q1), (vec.scale(-1.0, p0), p1)


def Phi_inverse(q: Pair, p: Pair) -> tuple[Pair, Pair]:
    """``Phi^-1: T*(Q x Q) -> T*Q x T*Q``, ``((q0, q1), (a, b)) -> (q0, -a; q1, b)``."""
    return (q[0], vec.scale(-1.0, p[0])), (q[1], p[1])


def cotangent_lift(
    diffeomorphism: Callable[[Ambient], Ambient], source: Manifold, target: Manifold
) -> Callable[[Ambient, Ambient], Pair]:
    """Cotangent lift ``hat(F) = (TF^-1)^*: T*M1 -> T*M2`` of a (local) diffeomorphism ``F: M1 -> M2``.

    The result takes a point ``x`` of ``source`` and a covector ``p`` there (any ambient array) to ``F(x)`` and the covector
    ``p'`` with ``<p', DF(x) e> = <p, e>`` for every tangent vector ``e`` at ``x``.
    """

    def lifted(x: Ambient, p: Ambient) -> Pair:
        y, push = jax.linearize(diffeomorphism, x)
        frame, there = source.basis(x), target.basis(y)
        images = jax.vmap(push)(frame)
        matrix = jax.vmap(lambda image: vec.components(there, image))(images)
        return y, vec.combine(there, jnp.linalg.solve(matrix, vec.components(frame, p)))

    return lifted


@final
class CotangentLift(DiscretizationMap):
    """Cotangent lift ``R_d^{T*}: TT*Q -> T*Q x T*Q`` of a discretization map on ``Q``: a discretization map on ``T*Q``.

    At ``z = (x, p)`` and ``zdot = (xdot, pdot)`` its value ``(q0, p0; q1, p1)`` is ``(q0, q1) = R_d(x, xdot)`` and, for every
    ``(dx, dv)`` tangent to ``TQ`` at ``(x, xdot)``,

        -<p0, D R1[dx, dv]> + <p1, D R2[dx, dv]> = <pdot, dx> + <p, dv>.

    It pulls ``pr2* omega - pr1* omega`` back to the tangent lift of ``omega``.
    """

    discretization: DiscretizationMap

    def __init__(self, discretization: DiscretizationMap) -> None:
        if not isinstance(discretization, DiscretizationMap):
            raise InvalidInputError(f"CotangentLift takes a discretization map, got {discretization!r}; try Midpoint(retraction)")
        self.discretization = discretization

    @property
    def retraction(self) -> Retraction:
        return BundleRetraction(base=self.discretization.retraction)

    @property
    def theta(self) -> float:
        return self.discretization.theta

    def __call__(self, x: Pair, v: Pair) -> tuple[Pair, Pair]:
        base = self.discretization.manifold
        lift = cotangent_lift(lambda z: self.discretization(*z), TangentBundle(base), Product(base, base))
        q, qdot, p_q, p_v = alpha_inverse(*x, *v)
        return Phi_inverse(*lift((q, qdot), (p_q, p_v)))

    def preimage(self, x0: Pair, x1: Pair) -> tuple[Pair, Pair]:
        """Inverse from the inverse of ``R_d``: the covector on ``T(Q x Q)`` is pulled back, then made tangent to ``T*Q``."""
        ends, covector = Phi(x0, x1)
        base = self.discretization.manifold
        q, qdot = self.discretization.preimage(*ends)
        _, pull = jax.vjp(self.discretization, q, qdot)
        p_q, p_v = pull(covector)
        # The same covector on TQ with p_v tangent, then the rate of p that keeps it tangent along qdot.
        p = base.projection(q, p_v)
        _, tilt = jax.vjp(lambda y: base.projection(y, qdot), q)
        along = base.projection(q, vec.add(p_q, tilt(vec.subtract(p_v, p))[0]))
        bend = jax.jvp(lambda y: base.projection(y, p), (q,), (qdot,))[1]
        return (q, p), (qdot, vec.add(along, vec.subtract(bend, base.projection(q, bend))))


@final
class BundleRetraction(Retraction):
    """Retraction of ``T*Q`` over a retraction of ``Q``: move the base, project the moved covector."""

    base: Retraction

    def __init__(self, base: Retraction) -> None:
        self.base = base

    @property
    def manifold(self) -> CotangentBundle:
        return CotangentBundle(self.base.manifold)

    def __call__(self, x: Pair, v: Pair) -> Pair:
        q = self.base(x[0], v[0])
        return q, self.base.manifold.projection(q, vec.add(x[1], v[1]))
