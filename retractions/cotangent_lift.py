"""The cotangent lift of a discretization map, a symplectomorphism from TT*Q to T*Q x T*Q.

``R_d^{T*} = Phi^-1 o hat(R_d) o alpha^-1`` with ``hat(F) = (TF^-1)^*``, ``alpha: T*TQ -> TT*Q`` and
``Phi: T*Q x T*Q -> T*(Q x Q)`` [Barbero-Linan, Martin de Diego, "Presymplectic integrators for optimal control problems
via retraction maps", section 3.1, with alpha read in the direction in which its formula is written].
"""

from collections.abc import Callable
from typing import final

import jax
import jax.numpy as jnp

from ..manifolds import CotangentBundle, InvalidInputError, Manifold, Product, TangentBundle
from ..manifolds.bundles import VectorBundle, same_manifold
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.symplectic import Phi, Phi_inverse, TulczyjewTriple, alpha_inverse
from .collocation import CollocationMethod
from .discretization import DiscretizationMap
from .retraction import Retraction

Pair = tuple[Ambient, Ambient]


def cotangent_lift(
    diffeomorphism: Callable[[Ambient], Ambient], source: Manifold, target: Manifold
) -> Callable[[Ambient, Ambient], Pair]:
    r"""The cotangent lift :math:`\hat F = (TF^{-1})^*: T^*M_1 \to T^*M_2` of a (local) diffeomorphism.

    Parameters
    ----------
    diffeomorphism : callable
        ``F``, from points of ``source`` to points of ``target``.
    source, target : Manifold
        The manifolds.

    Returns
    -------
    callable
        A function of a point ``x`` of ``source`` and a covector ``p`` of its shape. It returns ``F(x)`` and
        the covector ``p'`` with :math:`\langle p', DF(x) e \rangle = \langle p, e \rangle` for every tangent vector
        ``e``.

    Examples
    --------
    >>> lift = cotangent_lift(lambda x: 2.0 * x, Euclidean(1), Euclidean(1))
    >>> [part.tolist() for part in lift(jnp.ones(1), jnp.ones(1))]
    [[2.0], [0.5]]
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
    r"""The cotangent lift of a discretization map on ``Q``: a discretization map on ``T*Q``.

    Parameters
    ----------
    discretization : DiscretizationMap
        The map :math:`R_d = (R_1, R_2)` on ``Q``.

    Raises
    ------
    InvalidInputError
        For another object.

    Notes
    -----
    At ``z = (x, p)`` and ``zdot = (xdot, pdot)`` its value is :math:`(q_0, p_0; q_1, p_1)` with
    :math:`(q_0, q_1) = R_d(x, \dot x)` and, for every :math:`(dx, dv)` tangent to ``TQ`` at :math:`(x, \dot x)`,

    .. math::
        -\langle p_0, DR_1[dx, dv] \rangle + \langle p_1, DR_2[dx, dv] \rangle
        = \langle \dot p, dx \rangle + \langle p, dv \rangle.

    It pulls :math:`pr_2^* \omega - pr_1^* \omega` back to the tangent lift of :math:`\omega`.

    References
    ----------
    Barbero-Liñán and Martin de Diego, Retraction maps: a seed of geometric integrators, 2022.

    Examples
    --------
    >>> CotangentLift(Midpoint(Cayley(SO(3)))).theta
    0.5
    """

    discretization: DiscretizationMap

    def __init__(self, discretization: DiscretizationMap) -> None:
        if not isinstance(discretization, DiscretizationMap):
            whole = (
                "; a collocation method is given to an integrator as it is"
                if isinstance(discretization, CollocationMethod)
                else ""
            )
            raise InvalidInputError(
                f"CotangentLift takes a discretization map, got {discretization!r}{whole}; try Midpoint(retraction)"
            )
        self.discretization = discretization

    @property
    def retraction(self) -> Retraction:
        return BundleRetraction(base=self.discretization.retraction)

    @property
    def theta(self) -> float:
        return self.discretization.theta

    @property
    def order(self) -> int:
        return self.discretization.order

    def __call__(self, x: Pair, v: Pair) -> tuple[Pair, Pair]:
        base = self.discretization.manifold
        lift = cotangent_lift(lambda z: self.discretization(*z), TangentBundle(base), Product(base, base))
        q, qdot, p_q, p_v = alpha_inverse(*x, *v)
        return Phi_inverse(*lift((q, qdot), (p_q, p_v)))

    def preimage(self, x0: Pair, x1: Pair) -> tuple[Pair, Pair]:
        """The inverse by the inverse of ``R_d``: the covector on ``T(Q x Q)`` is pulled back, then made tangent to
        ``T*Q``.
        """
        ends, covector = Phi(x0, x1)
        base = self.discretization.manifold
        q, qdot = self.discretization.preimage(*ends)
        _, pull = vec.pullback(self.discretization, q, qdot)
        return TulczyjewTriple(base).alpha((q, qdot), pull(covector))


@final
class BundleRetraction(Retraction):
    r"""The retraction of ``T*Q`` or ``TQ`` over a retraction of ``Q``: it moves the base and projects the moved fibre.

    Parameters
    ----------
    base : Retraction
        The retraction of ``Q``.
    manifold : CotangentBundle or TangentBundle, optional
        The bundle of ``Q``, by default ``T*Q``.

    Raises
    ------
    InvalidInputError
        For a bundle over another manifold than that of ``base``.

    Notes
    -----
    :math:`R((q, p), (\dot q, \dot p)) = (R_Q(q, \dot q), P(p + \dot p))` with the tangent projection ``P`` at the moved
    point.

    Examples
    --------
    >>> CotangentLift(Midpoint(Projection(Sphere(2)))).retraction
    BundleRetraction(
      base=SphereProjection(manifold=Sphere(n=2)),
      manifold=CotangentBundle(base=Sphere(n=2))
    )
    """

    base: Retraction
    manifold: VectorBundle

    def __init__(self, base: Retraction, manifold: VectorBundle | None = None) -> None:
        self.base, self.manifold = base, CotangentBundle(base.manifold) if manifold is None else manifold
        if not same_manifold(self.manifold.base, base.manifold):
            raise InvalidInputError(
                f"the retraction acts on {base.manifold}, and the bundle {manifold} is over another manifold; expected "
                "a bundle over the same one"
            )

    def retract(self, x: Pair, v: Pair) -> Pair:
        q = self.base(x[0], v[0])
        return q, self.base.manifold.projection(q, vec.add(x[1], v[1]))

    def preimage(self, x: Pair, y: Pair) -> Pair:
        """The inverse by the inverse of the base; the part along the fibre solves linear equations."""
        base, manifold = self.base.manifold, self.manifold
        moved, frame, there = self.base.preimage(x[0], y[0]), base.basis(x[0]), base.basis(y[0])
        _, tilt = manifold.lift(x, moved, jax.tree.map(jnp.zeros_like, moved))
        matrix = jax.vmap(lambda e: vec.components(there, e), out_axes=1)(frame)
        missing = vec.components(there, vec.subtract(y[1], vec.add(x[1], tilt)))
        return manifold.lift(x, moved, vec.combine(frame, jnp.linalg.solve(matrix, missing)))
