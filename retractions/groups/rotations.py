"""Functions of skew and orthogonal matrices, with derivatives that are right everywhere, the identity included."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...manifolds import hat, vee
from ...manifolds.numerics import series
from ...manifolds.numerics.matrices import spd_sqrt

Matrix = Float[Array, "n n"]

_HALVINGS = 3
_GREGORY = tuple(2.0 / (2 * k + 1) for k in range(12))


def rotation_sqrt(a: Matrix) -> Matrix:
    """Square root of a rotation without the eigenvalue -1: the polar factor of ``I + a``."""
    eye = jnp.eye(a.shape[0], dtype=a.dtype)
    return jnp.linalg.solve(spd_sqrt(2 * eye + a + a.T), eye + a)


def squared_angle(omega: Matrix) -> Array:
    """``|w|^2`` of ``omega = hat(w)``."""
    return jnp.sum(omega * omega) / 2


def exponential(omega: Matrix) -> Matrix:
    """Matrix exponential of a skew matrix; Rodrigues' formula for n = 3."""
    if omega.shape[0] == 3:
        s = squared_angle(omega)
        return jnp.eye(3, dtype=omega.dtype) + series.sinc(s) * omega + series.cosc(s) * (omega @ omega)
    return jax.scipy.linalg.expm(omega)


def logarithm(a: Matrix) -> Matrix:
    """Principal logarithm of a rotation without the eigenvalue -1.

    For n = 3 from the sine and cosine of the angle. For other n by repeated square roots until the angles are below
    ``pi/8``, then Gregory's series ``log b = 2 artanh c`` with ``c = (b - I)(b + I)^-1`` [Higham 2008, 11.3].
    """
    if a.shape[0] == 3:
        return hat(rotation_vector(a))
    for _ in range(_HALVINGS):
        a = rotation_sqrt(a)
    c = cayley_inverse(a) / 2
    total, power, square = jnp.zeros_like(c), c, c @ c
    for coefficient in _GREGORY:
        total, power = total + coefficient * power, power @ square
    return 2.0**_HALVINGS * total


def rotation_vector(a: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Rotation vector, angle below pi: axis times angle.

    Within a quarter turn of the half turn the axis comes from the column of ``a + a'`` that is longest, where the skew part
    of ``a`` has lost its digits.
    """
    sine, cosine = vee(a), (jnp.trace(a) - 1) / 2
    s = sine @ sine
    far = cosine < -0.5
    direct = series.angle_over_sine(jnp.where(far, 0.75, s), jnp.where(far, -0.5, cosine)) * sine
    outer = (a + a.T) / 2 - cosine * jnp.eye(3, dtype=a.dtype)  # (1 - cos) n n'
    column = outer[:, jnp.argmax(jnp.where(far, jnp.diagonal(outer), jnp.ones(3, a.dtype)))]
    safe = jnp.where(far, column, jnp.ones(3, a.dtype))
    axis = safe / jnp.sqrt(safe @ safe)
    axis = axis * jnp.where(axis @ sine < 0, -1.0, 1.0)
    turned = jnp.arctan2(axis @ sine, jnp.where(far, cosine, -0.5)) * axis
    return jnp.where(far, turned, direct)


def cayley(omega: Matrix) -> Matrix:
    """Cayley transform ``(I - omega/2)^-1 (I + omega/2)`` of a skew matrix."""
    eye = jnp.eye(omega.shape[0], dtype=omega.dtype)
    if omega.shape[0] == 3:
        return eye + (omega + omega @ omega / 2) / (1 + squared_angle(omega) / 4)
    return jnp.linalg.solve(eye - omega / 2, eye + omega / 2)


def cayley_inverse(a: Matrix) -> Matrix:
    """``2 (a - I)(a + I)^-1``, skew, for a rotation without the eigenvalue -1."""
    if a.shape[0] == 3:
        return 2 * (a - a.T) / (1 + jnp.trace(a))
    eye = jnp.eye(a.shape[0], dtype=a.dtype)
    omega = 2 * jnp.linalg.solve(a + eye, a - eye)
    return (omega - omega.T) / 2


def polar(omega: Matrix) -> Matrix:
    """Orthogonal polar factor of ``I + omega``: ``(I + omega)(I - omega^2)^(-1/2)`` for a skew matrix."""
    eye = jnp.eye(omega.shape[0], dtype=omega.dtype)
    if omega.shape[0] == 3:
        r = jnp.sqrt(1 + squared_angle(omega))
        return eye + omega / r + omega @ omega / (r * (r + 1))
    return jnp.linalg.solve(spd_sqrt(eye - omega @ omega), eye + omega)


def polar_inverse(a: Matrix) -> Matrix:
    """Skew ``omega`` whose ``I + omega`` has the polar factor ``a``: ``2 (a + a')^-1 a - I``."""
    if a.shape[0] == 3:
        return (a - a.T) / (jnp.trace(a) - 1)
    omega = jnp.linalg.solve(a + a.T, a - a.T)
    return (omega - omega.T) / 2


def qr_factor(omega: Matrix) -> Matrix:
    """Orthogonal factor of ``I + omega = q r`` with a positive diagonal of ``r``."""
    q, r = jnp.linalg.qr(jnp.eye(omega.shape[0], dtype=omega.dtype) + omega)
    return q * jnp.where(jnp.diagonal(r) < 0, -1.0, 1.0)


def qr_inverse(a: Matrix) -> tuple[Matrix, Matrix]:
    """Skew ``omega`` and upper triangular ``t`` with ``a t = I + omega``, column by column [Kaneko, Fiori, Tanaka 2013].

    The inverse exists where the diagonal of ``t`` is positive.
    """
    n = a.shape[0]
    t = jnp.zeros_like(a)
    for i in range(n):
        above = jnp.stack([a[i, : j + 1] @ t[: j + 1, j] for j in range(i)]) if i else jnp.zeros(0, a.dtype)
        right = jnp.concatenate([-above, jnp.ones(1, a.dtype)])
        t = t.at[: i + 1, i].set(jnp.linalg.solve(a[: i + 1, : i + 1], right))
    omega = a @ t
    return (omega - omega.T) / 2, t
