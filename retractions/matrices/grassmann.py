"""Retractions of the Grassmann manifold of projectors.

Each is ``R(x, v) = q x q'`` with a rotation ``q = f(Omega)``, ``Omega = [v, x]``, for one of the functions ``f`` by
which the rotation group is retracted. Between two points whose principal angles are below pi/2 there is one such
rotation [Kato 1995, I.4.6; Bendokat, Zimmermann, Absil 2024].
"""

from abc import abstractmethod
from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Grassmann
from ...manifolds.numerics.frames import adapted_frame, polar_factor
from ..groups.functions import rotations
from ..retraction import MidpointRetraction, implicit_preimage, nan_unless
from ..rounding import SINGULAR_DISTANCE, is_seen_beside, keeps_half_the_digits, length


class _RotatedProjector(MidpointRetraction):
    """``R(x, v) = q x q'``; the midpoint projects on the positive eigenspace of ``x0 + x1 - I``.

    The eigenvalues of that are the cosines of the principal angles, with both signs; where one is lost in rounding it
    is NaN.
    """

    manifold: Grassmann

    @abstractmethod
    def rotation(self, omega: Array) -> Array:
        """``f(Omega)``."""

    def retract(self, x: Array, v: Array) -> Array:
        q = self.rotation(self.manifold.rotation(x, v))
        return q @ x @ q.T

    def midpoint(self, x0: Array, x1: Array) -> Array:
        eye = jnp.eye(x0.shape[0], dtype=x0.dtype)
        reflection = polar_factor(x0 + x1 - eye)
        least = jnp.min(jnp.abs(jnp.linalg.eigvalsh(jax.lax.stop_gradient(x0 + x1 - eye))))
        return nan_unless(keeps_half_the_digits(1 / least), (eye + (reflection + reflection.T) / 2) / 2)


def _singular_values(v: Array) -> Array:
    return jnp.linalg.svd(v, compute_uv=False)


def _angles_are_told(angles: Array) -> Bool[Array, ""]:
    """Whether principal angles, each of them twice and the largest first, are below pi/2, and no two near it together.

    Rounding turns directions of the angles ``s`` and ``t`` into each other, magnified by ``pi / (pi - s - t)``.
    """
    turn = angles[0] + angles[2] if angles.size > 2 else 0 * angles[0]
    below = jnp.pi / 2 - angles[0] > jnp.pi * SINGULAR_DISTANCE * jnp.finfo(angles.dtype).eps
    return below & keeps_half_the_digits(jnp.pi / (jnp.pi - turn))


def _direct_rotation(x: Array, y: Array, p: int) -> tuple[Array, Array]:
    """The rotation of least angles that takes ``x`` to ``y``, and the cosine of the largest of these angles.

    Frames of the two images, and of the two kernels, are aligned by polar factors; unlike the polar factor of
    ``yx + (I - y)(I - x)`` this loses no digits where an angle is near pi/2.
    """
    source, target = adapted_frame(x, p), adapted_frame(y, p)
    turned, smallest = [], []
    for part in (slice(None, p), slice(p, None)):
        u, cosines, w = jnp.linalg.svd(target[:, part].T @ source[:, part])
        turned.append(target[:, part] @ (u @ w))
        smallest.append(cosines[-1])
    return jnp.concatenate(turned, axis=1) @ source.T, smallest[0]


class _AlignedProjector(_RotatedProjector):
    """The inverse from ``f^-1`` of the direct rotation."""

    @abstractmethod
    def generator(self, rotation: Array) -> Array:
        """``f^-1`` of a rotation by angles below pi/2."""

    def preimage(self, x: Array, y: Array) -> Array:
        here, there = jax.lax.stop_gradient((x, y))
        rotation, cosine = _direct_rotation(here, there, self.manifold.p)
        omega = self.generator(rotation)
        inside = cosine > SINGULAR_DISTANCE * jnp.finfo(x.dtype).eps
        return nan_unless(inside, implicit_preimage(self, x, y, omega @ here - here @ omega))


@final
class GrassmannExponential(_AlignedProjector):
    r"""The exponential map of subspaces: along its geodesics each principal angle grows linearly.

    Parameters
    ----------
    manifold : Grassmann
        The manifold.

    Notes
    -----
    :math:`R(x, v) = q x q^T` with :math:`q = \exp [v, x]`. Inverse: the logarithm of the direct rotation. Its image is
    where all principal angles are below :math:`\pi/2`; its domain is where the largest singular value of ``v``, the
    largest angle, is below :math:`\pi/2`.

    Examples
    --------
    >>> Exponential(Grassmann(4, 2))
    GrassmannExponential(manifold=Grassmann(n=4, p=2))
    """

    manifold: Grassmann

    def rotation(self, omega: Array) -> Array:
        return rotations.exponential(omega)

    def generator(self, rotation: Array) -> Array:
        return rotations.logarithm(rotation)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return _angles_are_told(_singular_values(v))


@final
class GrassmannCayley(_AlignedProjector):
    r"""The Cayley retraction of subspaces: a singular value :math:`2 \tan(t/2)` of ``v`` gives an angle ``t``.

    Parameters
    ----------
    manifold : Grassmann
        The manifold.

    Notes
    -----
    :math:`R(x, v) = q x q^T` with the Cayley transform ``q`` of :math:`[v, x]`. Its image is where all principal angles
    are below :math:`\pi/2`, its domain where the largest singular value of ``v`` is below 2.

    Examples
    --------
    >>> Cayley(Grassmann(4, 2))
    GrassmannCayley(manifold=Grassmann(n=4, p=2))
    """

    manifold: Grassmann

    def rotation(self, omega: Array) -> Array:
        return rotations.cayley(omega)

    def generator(self, rotation: Array) -> Array:
        return rotations.cayley_inverse(rotation)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return _angles_are_told(2 * jnp.arctan(_singular_values(v) / 2))


@final
class GrassmannPolar(_RotatedProjector):
    r"""The polar retraction of subspaces: the projector on the image of ``(x + v) x``.

    Parameters
    ----------
    manifold : Grassmann
        The manifold.

    Notes
    -----
    It is the polar and the QR retraction of frames, which span the same subspace. A singular value :math:`\tan t` of
    ``v`` gives an angle ``t``. Inverse: :math:`(y - x)(x + y - I)^{-1} (2x - I)`. Its image is where all principal
    angles are below :math:`\pi/2`, its domain every tangent vector shorter than :math:`1/(4\sqrt\epsilon)`.

    Examples
    --------
    >>> Polar(Grassmann(4, 2))
    GrassmannPolar(manifold=Grassmann(n=4, p=2))
    """

    manifold: Grassmann

    def rotation(self, omega: Array) -> Array:
        return nan_unless(is_seen_beside(omega), polar_factor(jnp.eye(omega.shape[0], dtype=omega.dtype) + omega))

    def preimage(self, x: Array, y: Array) -> Array:
        eye = jnp.eye(x.shape[0], dtype=x.dtype)
        cosines = x + y - eye  # symmetric, with eigenvalues of these sizes
        v = jnp.linalg.solve(cosines, y - x).T @ (2 * x - eye)
        inside = jnp.min(jnp.abs(jnp.linalg.eigvalsh(cosines))) > SINGULAR_DISTANCE * jnp.finfo(x.dtype).eps
        return nan_unless(inside, self.manifold.projection(x, v))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return keeps_half_the_digits(length(v))
