"""Functions of twists ``[[Omega, v], [0, 0]]`` and rigid motions ``[[R, t], [0, 1]]``, made from functions of
rotations."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ....manifolds.groups.special_euclidean import blocks, homogeneous
from ....manifolds.numerics import series
from . import general, rotations, unitary

Matrix = Float[Array, "n+1 n+1"]
Block = Float[Array, "n n"]


def exponential(a: Matrix) -> Matrix:
    """``(exp Omega, V v)`` with ``V`` the integral of ``exp(s Omega)`` over ``s`` in [0, 1] [Lynch, Park 2017,
    3.3.3]."""
    omega, v = blocks(a)
    return homogeneous(rotations.exponential(omega), left_jacobian(omega) @ v, 1.0)


def logarithm(a: Matrix) -> Matrix:
    """Principal logarithm of a motion, NaN if the rotation has an eigenvalue -1."""
    rotation, translation = blocks(a)
    omega = rotations.logarithm(rotation)
    if omega.shape[0] <= 3:
        s = rotations.squared_angle(omega)
        turned = omega @ translation
        return homogeneous(omega, translation - turned / 2 + series.cotangent_remainder(s) * (omega @ turned), 0.0)
    return homogeneous(omega, jnp.linalg.solve(left_jacobian(omega), translation), 0.0)


def left_jacobian(omega: Block) -> Block:
    """``V = I + (1 - cos t)/t^2 Omega + (t - sin t)/t^3 Omega^2`` for n = 2, 3; a block of an exponential for other
    n."""
    n = omega.shape[0]
    eye = jnp.eye(n, dtype=omega.dtype)
    if n <= 3:
        s = rotations.squared_angle(omega)
        return eye + series.cosc(s) * omega + series.sine_remainder(s) * (omega @ omega)
    zero = jnp.zeros_like(omega)
    return general.exponential(jnp.block([[omega, eye], [zero, zero]]))[:n, n:]


def square_root(a: Matrix) -> Matrix:
    """The motion whose square is ``a``, for a rotation without the eigenvalue -1: ``t = (I + R_h) t_h``."""
    rotation, translation = blocks(a)
    half = rotations.rotation_sqrt(rotation)
    eye = jnp.eye(half.shape[0], dtype=half.dtype)
    return homogeneous(half, jnp.linalg.solve(eye + half, translation), 1.0)


def injective(a: Matrix) -> Bool[Array, ""]:
    """Whether the logarithm inverts the exponential at a twist: as at its rotation."""
    return unitary.injective(blocks(a)[0])


def cayley(a: Matrix) -> Matrix:
    """Cayley transform of the homogeneous matrix: ``(C, (I - Omega/2)^-1 v)`` with ``(I - Omega/2)^-1 = (I + C)/2``."""
    omega, v = blocks(a)
    turned = rotations.cayley(omega)
    return homogeneous(turned, (v + turned @ v) / 2, 1.0)


def cayley_inverse(a: Matrix) -> Matrix:
    """``(Omega, (I - Omega/2) t)`` with the rotation's inverse ``Omega``, for a rotation without the eigenvalue -1."""
    rotation, translation = blocks(a)
    omega = rotations.cayley_inverse(rotation)
    return homogeneous(omega, translation - omega @ translation / 2, 0.0)
