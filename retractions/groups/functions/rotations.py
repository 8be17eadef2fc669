"""Functions of skew and orthogonal matrices, with derivatives that are right everywhere, the identity included.

In two and three dimensions a skew matrix has one angle, ``omega^3 = -|w|^2 omega``, and every function of it is a
quadratic polynomial [Lynch, Park 2017, 3.2.3]; in four dimensions it has two.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ....manifolds import hat, vee
from ....manifolds.numerics import series
from ....manifolds.numerics.matrices import lyapunov, symmetric
from . import general, unitary

Matrix = Float[Array, "n n"]


def rotation_sqrt(a: Matrix) -> Matrix:
    """Square root of a rotation without the eigenvalue -1: the polar factor of ``I + a``."""
    return unitary.polar(a)


def squared_angle(omega: Matrix) -> Array:
    """Square of the one angle of a skew matrix, n = 2 or 3: ``|w|^2`` of ``omega = hat(w)``."""
    return jnp.sum(omega * omega) / 2


def smallest_cosine(a: Matrix) -> Array:
    """Cosine of the largest angle of a rotation."""
    n = a.shape[0]
    return (jnp.trace(a) - (n - 2)) / 2 if n <= 3 else jnp.linalg.eigvalsh((a + a.T) / 2)[0]


def exponential(omega: Matrix) -> Matrix:
    """Matrix exponential of a skew matrix; Rodrigues' formula for n = 2 and 3.

    For n = 4 a skew matrix is a sum of two that commute, one its own dual, one minus its own, of two equal angles each:
    ``a a = -s I``, whose exponential is ``cos(sqrt(s)) I + sinc(sqrt(s)) a`` [Mebius 2005].
    """
    n = omega.shape[0]
    if n > 4:
        return general.exponential(omega)
    eye = jnp.eye(n, dtype=omega.dtype)
    if n < 4:
        s = squared_angle(omega)
        return eye + series.sinc(s) * omega + series.cosc(s) * (omega @ omega)
    dual = _dual(omega)
    left, right = (
        series.cosine(s) * eye + series.sinc(s) * a
        for a, s in ((a, squared_angle(a) / 2) for a in ((omega + dual) / 2, (omega - dual) / 2))
    )
    return left @ right


def _dual(omega: Matrix) -> Matrix:
    """The dual of a skew matrix, n = 4, which exchanges entries of the first row with their complementary entries."""
    first, rest = omega[0, 1:], vee(omega[1:, 1:])
    return jnp.block([[jnp.zeros((1, 1), omega.dtype), -rest[None]], [rest[:, None], -hat(first)]])


def logarithm(a: Matrix) -> Matrix:
    """Principal logarithm of a rotation without the eigenvalue -1, NaN for one with it."""
    if a.shape[0] == 2:
        sine, cosine = a[1, 0] - a[0, 1], a[0, 0] + a[1, 1]
        angle = jnp.where((sine != 0) | (cosine > 0), jnp.arctan2(sine, cosine), jnp.nan)
        return angle * jnp.array([[0.0, -1.0], [1.0, 0.0]], a.dtype)
    if a.shape[0] == 3:
        return hat(rotation_vector(a))
    return unitary.logarithm(a)


def rotation_vector(a: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Rotation vector, axis times angle, for an angle below pi; NaN for a half turn.

    Within a quarter turn of the half turn the axis comes from the column of ``a + a'`` that is longest, where the skew
    part of ``a`` has lost its digits. Elsewhere the arguments of that branch are constant and apart, so that none of
    its steps changes there or nearly does.
    """
    sine, cosine = vee(a), (jnp.trace(a) - 1) / 2
    s = sine @ sine
    far = cosine < -0.5
    direct = series.angle_over_sine(jnp.where(far, 0.75, s), jnp.where(far, -0.5, cosine)) * sine
    outer = (a + a.T) / 2 - cosine * jnp.eye(3, dtype=a.dtype)  # (1 - cos) n n'
    column = outer[:, jnp.argmax(jnp.where(far, jnp.diagonal(outer), jnp.arange(3, dtype=a.dtype)))]
    safe, small = jnp.where(far, jnp.stack([column, sine]), jnp.ones((2, 3), a.dtype))
    axis = safe / jnp.sqrt(safe @ safe)
    axis = axis * jnp.where(axis @ small < 0, -1.0, 1.0)
    turned = jnp.arctan2(axis @ small, jnp.where(far, cosine, -0.5)) * axis
    return jnp.where(far, jnp.where(small @ small == 0, jnp.nan, turned), direct)


def cayley(omega: Matrix) -> Matrix:
    """Cayley transform ``(I - omega/2)^-1 (I + omega/2)`` of a skew matrix."""
    if omega.shape[0] > 3:
        return unitary.cayley(omega)
    eye = jnp.eye(omega.shape[0], dtype=omega.dtype)
    return eye + (omega + omega @ omega / 2) / (1 + squared_angle(omega) / 4)


def cayley_inverse(a: Matrix) -> Matrix:
    """``2 (a - I)(a + I)^-1``, skew, for a rotation without the eigenvalue -1."""
    n = a.shape[0]
    if n <= 3:
        below = 4 - n + jnp.trace(a)  # at a half turn it is rounding, as is a - a', which may be 0 without it
        return 2 * (a - a.T) / jnp.where(below > 64 * jnp.finfo(a.dtype).eps, below, jnp.nan)
    omega = general.cayley_inverse(a)
    return (omega - omega.T) / 2


def polar(omega: Matrix) -> Matrix:
    """Orthogonal polar factor of ``I + omega`` for a skew matrix."""
    if omega.shape[0] > 3:
        return unitary.polar(omega)
    r = jnp.sqrt(1 + squared_angle(omega))
    return jnp.eye(omega.shape[0], dtype=omega.dtype) + omega / r + omega @ omega / (r * (r + 1))


def polar_turn(omega: Matrix, g: Matrix, k: Matrix) -> Matrix:
    """The skew ``t`` of ``s t + t s = k`` for a skew ``k``, with the polar factors ``I + omega = g s``."""
    if omega.shape[0] > 3:
        return lyapunov(symmetric(g.T + g.T @ omega), k)
    # As vectors ((tr s) I - s) t = k, where s has the eigenvalue 1 along omega and r across it.
    r = jnp.sqrt(1 + squared_angle(omega))
    return (k - jnp.sum(omega * k) / (4 * r * (r + 1)) * omega) / (r + 1)


def polar_inverse(a: Matrix) -> Matrix:
    """Skew ``omega`` whose ``I + omega`` has the polar factor ``a``, for angles below pi/2."""
    n = a.shape[0]
    return (a - a.T) / (jnp.trace(a) - (n - 2)) if n <= 3 else unitary.polar_inverse(a)
