"""The Tulczyjew triple ``T*TQ <- TT*Q -> T*T*Q`` and the isomorphism ``T*Q x T*Q -> T*(Q x Q)``.

The functions here act on ambient representatives of covectors; ``TulczyjewTriple`` gives the maps between the embedded
bundles, where every covector is stored as its tangent representative.
[Tulczyjew, "Les sous-varietes lagrangiennes et la dynamique hamiltonienne", 1976; Barbero-Linan, Martin de Diego,
"Presymplectic integrators for optimal control problems via retraction maps", sections 2 and 3.]
"""

from typing import final

from ...module import Module
from ..bundles import CotangentBundle, TangentBundle
from ..manifold import Manifold
from ..numerics import ambient as vec
from ..numerics.ambient import Ambient

Pair = tuple[Ambient, Ambient]
Quadruple = tuple[Ambient, Ambient, Ambient, Ambient]


def alpha(q: Ambient, v: Ambient, p_q: Ambient, p_v: Ambient) -> Quadruple:
    """``alpha: T*TQ -> TT*Q``, ``(q, v, p_q, p_v) -> (q, p, qdot, pdot) = (q, p_v, v, p_q)``."""
    return q, p_v, v, p_q


def alpha_inverse(q: Ambient, p: Ambient, qdot: Ambient, pdot: Ambient) -> Quadruple:
    """``alpha^-1: TT*Q -> T*TQ``, ``(q, p, qdot, pdot) -> (q, v, p_q, p_v) = (q, qdot, pdot, p)``.

    The covector on ``TQ`` at ``(q, v)`` is ``(dq, dv) -> <p_q, dq> + <p_v, dv>``.

    >>> alpha_inverse(*alpha(1.0, 2.0, 3.0, 4.0))
    (1.0, 2.0, 3.0, 4.0)
    """
    return q, qdot, pdot, p


def beta(q: Ambient, p: Ambient, qdot: Ambient, pdot: Ambient) -> Quadruple:
    """``beta: TT*Q -> T*T*Q``, ``v -> i_v omega``, ``(q, p, qdot, pdot) -> (q, p, P_q, P_p) = (q, p, -pdot, qdot)``.

    It is anti-symplectic: with ``omega = dq ^ dp`` it pulls the canonical form of ``T*T*Q`` back to ``-d_T omega``.

    >>> [float(part) for part in beta(1.0, 2.0, 3.0, 4.0)]
    [1.0, 2.0, -4.0, 3.0]
    """
    return q, p, vec.scale(-1.0, pdot), qdot


def beta_inverse(q: Ambient, p: Ambient, P_q: Ambient, P_p: Ambient) -> Quadruple:
    """``beta^-1: T*T*Q -> TT*Q``, ``(q, p, P_q, P_p) -> (q, p, qdot, pdot) = (q, p, P_p, -P_q)``.

    >>> [float(part) for part in beta_inverse(*beta(1.0, 2.0, 3.0, 4.0))]
    [1.0, 2.0, 3.0, 4.0]
    """
    return q, p, P_p, vec.scale(-1.0, P_q)


def Phi(z0: Pair, z1: Pair) -> tuple[Pair, Pair]:
    """``Phi: T*Q x T*Q -> T*(Q x Q)``, ``(q0, p0; q1, p1) -> ((q0, q1), (-p0, p1))``: a point and a covector there.

    >>> z0, z1 = (jnp.ones(1), jnp.full(1, 2.0)), (jnp.full(1, 3.0), jnp.full(1, 4.0))
    >>> np.ravel(Phi(z0, z1)).tolist()
    [1.0, 3.0, -2.0, 4.0]
    """
    (q0, p0), (q1, p1) = z0, z1
    return (q0, q1), (vec.scale(-1.0, p0), p1)


def Phi_inverse(q: Pair, p: Pair) -> tuple[Pair, Pair]:
    """``Phi^-1: T*(Q x Q) -> T*Q x T*Q``, ``((q0, q1), (a, b)) -> (q0, -a; q1, b)``.

    ``q`` and ``p``: pairs of points and of covectors, arrays of the shape of a point.

    >>> q, p = (jnp.ones(1), jnp.full(1, 3.0)), (jnp.full(1, -2.0), jnp.full(1, 4.0))
    >>> np.ravel(Phi_inverse(q, p)).tolist()
    [1.0, 2.0, 3.0, 4.0]
    """
    return (q[0], vec.scale(-1.0, p[0])), (q[1], p[1])


@final
class TulczyjewTriple(Module):
    """``T*TQ <-alpha^-1- TT*Q -beta-> T*T*Q`` over an embedded manifold ``Q``.

    Points of the three bundles are nested pairs: ``((q, v), (p_q, p_v))``, ``((q, p), (qdot, pdot))``, ``((q, p), (P_q,
    P_p))``. ``alpha`` is symplectic from the canonical form to ``d_T omega``, ``beta`` anti-symplectic to the canonical
    form.

    >>> print(TulczyjewTriple(Sphere(2)).middle)
    TangentBundle(CotangentBundle(Sphere(2)))
    """

    base: Manifold

    @property
    def lagrangian_side(self) -> CotangentBundle:
        """``T*TQ``, where the differential of a Lagrangian lives."""
        return CotangentBundle(TangentBundle(self.base))

    @property
    def middle(self) -> TangentBundle:
        """``TT*Q``, where the dynamics lives."""
        return TangentBundle(CotangentBundle(self.base))

    @property
    def hamiltonian_side(self) -> CotangentBundle:
        """``T*T*Q``, where the differential of a Hamiltonian lives."""
        return CotangentBundle(CotangentBundle(self.base))

    def alpha(self, y: Pair, covector: Pair) -> tuple[Pair, Pair]:
        """``T*TQ -> TT*Q``: ``qdot = v`` and ``<pdot, dq> + <p, dv> = <p_q, dq> + <p_v, dv>`` on ``T_(q, v)TQ``."""
        along, p = TangentBundle(self.base).parts(y, covector)
        z = y[0], p
        return z, CotangentBundle(self.base).lift(z, y[1], along)

    def alpha_inverse(self, z: Pair, zdot: Pair) -> tuple[Pair, Pair]:
        """``TT*Q -> T*TQ``."""
        q, v, p_q, p_v = alpha_inverse(*z, *zdot)
        return (q, v), TangentBundle(self.base).projection((q, v), (p_q, p_v))

    def beta(self, z: Pair, zdot: Pair) -> tuple[Pair, Pair]:
        """``TT*Q -> T*T*Q``, ``v -> i_v omega``."""
        _, _, P_q, P_p = beta(*z, *zdot)
        return z, CotangentBundle(self.base).projection(z, (P_q, P_p))

    def beta_inverse(self, z: Pair, covector: Pair) -> tuple[Pair, Pair]:
        """``T*T*Q -> TT*Q``: the tangent vector whose contraction with ``omega`` is the covector."""
        return z, CotangentBundle(self.base).sharp(z, covector)
