"""Tangent and cotangent bundles as embedded manifolds.

A covector is stored as its tangent representative, so as subsets of the ambient space ``T*Q`` and ``TQ`` are the same
set ``{(x, v) : x in Q, v in T_xQ}``. They differ in what lives on them: the canonical forms belong to ``T*Q``.
"""

from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .manifold import Manifold
from .numerics import ambient as vec
from .numerics.ambient import Ambient, Frame

Pair = tuple[Ambient, Ambient]


class VectorBundle(Manifold):
    """``{(x, v) : x in M, v in T_xM}``, of dimension ``2n``."""

    base: Manifold

    def __str__(self) -> str:
        return f"{type(self).__name__}({self.base})"

    @property
    def dimension(self) -> int:
        return 2 * self.base.dimension

    @property
    def ambient(self) -> tuple[Any, Any]:
        return self.base.ambient, self.base.ambient

    def lift(self, z: Pair, a: Ambient, b: Ambient) -> Pair:
        """The vector ``(a, b + D_xP_x(v)[a])`` tangent to the bundle at ``z = (x, v)``, for ``a``, ``b`` tangent at
        ``x``."""
        x, v = z
        return a, vec.add(b, jax.jvp(lambda y: self.base.projection(y, v), (x,), (a,))[1])

    def parts(self, z: Pair, covector: Pair) -> Pair:
        """The tangent ``(s, t)`` with ``<covector, lift(a, b)> = <s, a> + <t, b>`` for all ``a``, ``b`` tangent at
        ``x``."""
        x, v = z
        t = self.base.projection(x, covector[1])
        _, tilt = vec.pullback(lambda y: self.base.projection(y, v), x)
        return self.base.projection(x, vec.add(covector[0], tilt(vec.subtract(covector[1], t))[0])), t

    def spanning_frame(self, z: Pair) -> Frame:
        """The vectors ``lift(e_i, 0)`` and ``lift(0, e_i)``: a basis of the tangent space, not orthonormal."""
        e = self.base.basis(z[0])
        zero = jax.tree.map(jnp.zeros_like, e)
        horizontal = jax.vmap(lambda a, b: self.lift(z, a, b))(e, zero)
        return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), horizontal, (zero, e))

    def basis(self, x: Pair) -> Frame:
        return vec.orthonormalise(self.spanning_frame(x))

    def projection(self, x: Pair, a: Pair) -> Pair:
        frame = self.basis(x)
        return vec.combine(frame, vec.components(frame, a))

    def restore(self, x: Pair) -> Pair:
        base = self.base.restore(x[0])
        return base, self.base.projection(base, x[1])

    def violations(self, x: Pair) -> dict[str, Array]:
        point, v = x
        normal = vec.size(vec.subtract(v, self.base.projection(point, v))) / (1 + vec.size(v))
        base = {f"base point: {words}": value for words, value in self.base.violations(point).items()}
        return {**base, "relative normal part of the fibre": normal}

    def length(self, x: Pair, a: Pair) -> Array:
        return vec.size((self.base.length(x[0], a[0]), a[1]))

    def random_point(self, key: Array) -> Pair:
        first, second = jax.random.split(key)
        x = self.base.random_point(first)
        return x, self.base.random_tangent(second, x)


@final
class TangentBundle(VectorBundle):
    r"""The tangent bundle ``TM`` of a manifold; points are pairs ``(x, v)``.

    Parameters
    ----------
    base : Manifold
        The manifold ``M``.

    Notes
    -----
    A vector at ``(x, v)`` is a pair ``(xdot, vdot)``, in which :math:`\dot v - D P_x(v)[\dot x]` is tangent at ``x``.
    The dimension is :math:`2 \dim M`.
    """


@final
class CotangentBundle(VectorBundle):
    r"""The cotangent bundle ``T*M`` with its canonical forms; points are pairs ``(q, p)`` with ``p`` tangent at
    ``q``.

    Parameters
    ----------
    base : Manifold
        The manifold ``M``.

    Notes
    -----
    The canonical forms are :math:`\theta = p\,dq` and :math:`\omega = -d\theta = dq \wedge dp`. The dimension is
    :math:`2 \dim M`.
    """

    one_point: ClassVar[dict[str, tuple[str, ...]]] = {
        **VectorBundle.one_point,
        "one_form": ("a point", "a tangent vector"),
        "two_form": ("a point", "a tangent vector", "a second tangent vector"),
        "sharp": ("a point", "a covector"),
    }

    def one_form(self, z: Pair, a: Pair) -> Array:
        r"""The canonical one-form :math:`\theta = p\,dq` on a tangent vector, a scalar.

        Parameters
        ----------
        z : pair
            The point ``(q, p)``.
        a : pair
            The tangent vector ``(dq, dp)``.
        """
        return vec.pairing(z[1], a[0])

    def two_form(self, z: Pair, a: Pair, b: Pair) -> Array:
        r"""The canonical two-form :math:`\omega = dq \wedge dp` on two tangent vectors, a scalar.

        Parameters
        ----------
        z : pair
            The point ``(q, p)``.
        a, b : pair
            Tangent vectors ``(dq, dp)``.
        """
        return vec.pairing(a[0], b[1]) - vec.pairing(b[0], a[1])

    def sharp(self, z: Pair, covector: Pair) -> Pair:
        r"""The tangent vector ``a`` at ``z`` with :math:`\omega(a, b) = \langle covector, b \rangle` for every
        tangent ``b``.

        Parameters
        ----------
        z : pair
            The point ``(q, p)``.
        covector : pair
            An ambient covector; for ``dH`` the result is the Hamiltonian vector field.
        """
        s, t = self.parts(z, covector)
        return self.lift(z, t, vec.scale(-1.0, s))


def same_manifold(a: Manifold, b: Manifold) -> bool:
    """Whether two manifolds are of one class with the same data; tangent and cotangent bundles are the same set."""
    if isinstance(a, VectorBundle) and isinstance(b, VectorBundle):
        return same_manifold(a.base, b.base)
    return bool(eqx.tree_equal(a, b))
