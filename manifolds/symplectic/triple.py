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
    r"""The isomorphism :math:`\alpha: T^*TQ \to TT^*Q`, ``(q, v, p_q, p_v) -> (q, p, qdot, pdot) = (q, p_v, v,
    p_q)``.

    Parameters
    ----------
    q, v, p_q, p_v : point, tangent vector, covectors
        A covector on ``TQ``; all have the shape of a point.

    Returns
    -------
    tuple
        ``(q, p, qdot, pdot)``.
    """
    return q, p_v, v, p_q


def alpha_inverse(q: Ambient, p: Ambient, qdot: Ambient, pdot: Ambient) -> Quadruple:
    r"""The inverse :math:`\alpha^{-1}: TT^*Q \to T^*TQ`, ``(q, p, qdot, pdot) -> (q, v, p_q, p_v) = (q, qdot, pdot,
    p)``.

    Parameters
    ----------
    q, p, qdot, pdot : point, covector, velocities
        A tangent vector of ``T*Q``; all have the shape of a point.

    Returns
    -------
    tuple
        ``(q, v, p_q, p_v)``: the covector on ``TQ`` at ``(q, v)`` is
        :math:`(dq, dv) \mapsto \langle p_q, dq \rangle + \langle p_v, dv \rangle`.

    Examples
    --------
    >>> alpha_inverse(*alpha(1.0, 2.0, 3.0, 4.0))
    (1.0, 2.0, 3.0, 4.0)
    """
    return q, qdot, pdot, p


def beta(q: Ambient, p: Ambient, qdot: Ambient, pdot: Ambient) -> Quadruple:
    r"""The map :math:`\beta: TT^*Q \to T^*T^*Q`, :math:`v \mapsto i_v \omega`, ``(q, p, qdot, pdot) -> (q, p, -pdot,
    qdot)``.

    Parameters
    ----------
    q, p, qdot, pdot : point, covector, velocities
        A tangent vector of ``T*Q``; all have the shape of a point.

    Returns
    -------
    tuple
        ``(q, p, P_q, P_p)``.

    Notes
    -----
    It is anti-symplectic: with :math:`\omega = dq \wedge dp` it pulls the canonical form of ``T*T*Q`` back to
    :math:`-d_T \omega`.

    Examples
    --------
    >>> [float(part) for part in beta(1.0, 2.0, 3.0, 4.0)]
    [1.0, 2.0, -4.0, 3.0]
    """
    return q, p, vec.scale(-1.0, pdot), qdot


def beta_inverse(q: Ambient, p: Ambient, P_q: Ambient, P_p: Ambient) -> Quadruple:
    r"""The inverse :math:`\beta^{-1}: T^*T^*Q \to TT^*Q`, ``(q, p, P_q, P_p) -> (q, p, qdot, pdot) = (q, p, P_p,
    -P_q)``.

    Parameters
    ----------
    q, p, P_q, P_p : point, covector, covectors
        A covector on ``T*Q``; all have the shape of a point.

    Returns
    -------
    tuple
        ``(q, p, qdot, pdot)``.

    Examples
    --------
    >>> [float(part) for part in beta_inverse(*beta(1.0, 2.0, 3.0, 4.0))]
    [1.0, 2.0, 3.0, 4.0]
    """
    return q, p, P_p, vec.scale(-1.0, P_q)


def Phi(z0: Pair, z1: Pair) -> tuple[Pair, Pair]:
    r"""The map :math:`\Phi: T^*Q \times T^*Q \to T^*(Q \times Q)`, ``(q0, p0; q1, p1) -> ((q0, q1), (-p0, p1))``.

    Parameters
    ----------
    z0, z1 : pairs
        Points ``(q, p)`` of ``T*Q``.

    Returns
    -------
    tuple
        A point of ``Q x Q`` and a covector there.

    Examples
    --------
    >>> z0, z1 = (jnp.ones(1), jnp.full(1, 2.0)), (jnp.full(1, 3.0), jnp.full(1, 4.0))
    >>> np.ravel(Phi(z0, z1)).tolist()
    [1.0, 3.0, -2.0, 4.0]
    """
    (q0, p0), (q1, p1) = z0, z1
    return (q0, q1), (vec.scale(-1.0, p0), p1)


def Phi_inverse(q: Pair, p: Pair) -> tuple[Pair, Pair]:
    r"""The inverse :math:`\Phi^{-1}: T^*(Q \times Q) \to T^*Q \times T^*Q`, ``((q0, q1), (a, b)) -> (q0, -a; q1,
    b)``.

    Parameters
    ----------
    q, p : pairs
        Two points and two covectors, arrays of the shape of a point.

    Returns
    -------
    tuple
        Two points ``(q, p)`` of ``T*Q``.

    Examples
    --------
    >>> q, p = (jnp.ones(1), jnp.full(1, 3.0)), (jnp.full(1, -2.0), jnp.full(1, 4.0))
    >>> np.ravel(Phi_inverse(q, p)).tolist()
    [1.0, 2.0, 3.0, 4.0]
    """
    return (q[0], vec.scale(-1.0, p[0])), (q[1], p[1])


@final
class TulczyjewTriple(Module):
    r"""The Tulczyjew triple :math:`T^*TQ \leftarrow TT^*Q \to T^*T^*Q` over an embedded manifold ``Q``.

    Parameters
    ----------
    base : Manifold
        The manifold ``Q``.

    Notes
    -----
    Points of the three bundles are nested pairs: ``((q, v), (p_q, p_v))``, ``((q, p), (qdot, pdot))``, ``((q, p), (P_q,
    P_p))``. ``alpha`` is symplectic from the canonical form to :math:`d_T \omega`; ``beta`` is anti-symplectic to the
    canonical form.

    Examples
    --------
    >>> print(TulczyjewTriple(Sphere(2)).middle)
    TangentBundle(CotangentBundle(Sphere(2)))
    """

    base: Manifold

    @property
    def lagrangian_side(self) -> CotangentBundle:
        """The bundle ``T*TQ`` of the differential of a Lagrangian."""
        return CotangentBundle(TangentBundle(self.base))

    @property
    def middle(self) -> TangentBundle:
        """The bundle ``TT*Q`` of the dynamics."""
        return TangentBundle(CotangentBundle(self.base))

    @property
    def hamiltonian_side(self) -> CotangentBundle:
        """The bundle ``T*T*Q`` of the differential of a Hamiltonian."""
        return CotangentBundle(CotangentBundle(self.base))

    def alpha(self, y: Pair, covector: Pair) -> tuple[Pair, Pair]:
        r"""The isomorphism :math:`T^*TQ \to TT^*Q`: ``qdot = v`` and the covectors agree on :math:`T_{(q, v)}TQ`.

        Parameters
        ----------
        y : pair
            The point ``(q, v)``.
        covector : pair
            The covector ``(p_q, p_v)`` there.

        Notes
        -----
        :math:`\langle \dot p, dq \rangle + \langle p, dv \rangle = \langle p_q, dq \rangle + \langle p_v, dv \rangle`.
        """
        along, p = TangentBundle(self.base).parts(y, covector)
        z = y[0], p
        return z, CotangentBundle(self.base).lift(z, y[1], along)

    def alpha_inverse(self, z: Pair, zdot: Pair) -> tuple[Pair, Pair]:
        """The inverse of ``alpha``.

        Parameters
        ----------
        z : pair
            The point ``(q, p)``.
        zdot : pair
            The tangent vector ``(qdot, pdot)`` there.
        """
        q, v, p_q, p_v = alpha_inverse(*z, *zdot)
        return (q, v), TangentBundle(self.base).projection((q, v), (p_q, p_v))

    def beta(self, z: Pair, zdot: Pair) -> tuple[Pair, Pair]:
        r"""The map :math:`TT^*Q \to T^*T^*Q`, :math:`v \mapsto i_v \omega`.

        Parameters
        ----------
        z : pair
            The point ``(q, p)``.
        zdot : pair
            The tangent vector ``(qdot, pdot)`` there.
        """
        _, _, P_q, P_p = beta(*z, *zdot)
        return z, CotangentBundle(self.base).projection(z, (P_q, P_p))

    def beta_inverse(self, z: Pair, covector: Pair) -> tuple[Pair, Pair]:
        """The inverse of ``beta``: the tangent vector whose contraction with ``omega`` is the covector.

        Parameters
        ----------
        z : pair
            The point ``(q, p)``.
        covector : pair
            The covector ``(P_q, P_p)`` there.
        """
        return z, CotangentBundle(self.base).sharp(z, covector)
