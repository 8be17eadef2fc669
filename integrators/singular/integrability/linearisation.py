"""The derivative array linearised at one point of the jet space over ``T*Q``."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ....manifolds import CotangentBundle
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient, Frame
from ....manifolds.symplectic import form_matrix
from .derivative_array import DerivativeArray, Pair, hamiltonian_field
from .lost_digits import loses_digits


class Linearisation(NamedTuple):
    """The values of the kernel at one point of the jet space over ``T*Q``."""

    z: Pair
    control: Ambient
    frame: Frame  # of T_z T*Q: horizontal, then vertical vectors, so that its scale does not depend on that of p
    jet: Array  # (order + 1, m): the control and its derivatives
    array: Array  # (order + 1, m): F_0 ... F_order
    by_state: Array  # (order + 1, m, 2n): derivatives along that frame
    by_jet: Array  # (order + 1, m, order + 1, m)
    position: Array  # (n,): components of the point along the frame's horizontal part, its coordinates in R^n
    velocity: Array  # (2n,): X_H in that frame
    omega: Array  # (2n, 2n): the canonical form in that frame
    costate: Array  # (n,): components of p along the frame's horizontal part
    cost_rate: Array
    lost: Array  # whether functions of the problem underflow


def linearise(array: DerivativeArray, z: Pair, center: Ambient, jet: Array) -> Linearisation:
    """The derivative array at a point of the jet space, with its derivatives along the state and the jet."""
    bundle = CotangentBundle(array.problem.manifold)
    frame, count = bundle.spanning_frame(z), bundle.dimension
    function = jax.jit(lambda z, u: array(z, center, u))
    along = jnp.concatenate([jnp.zeros((count, jet.size)), jnp.eye(jet.size)]).reshape(-1, *jet.shape)
    moved = jax.tree.map(lambda leaf: jnp.concatenate([leaf, jnp.zeros((jet.size, *leaf.shape[1:]))]), frame)
    value, slopes = jax.vmap(lambda a, b: jax.jvp(function, (z, jet), (a, b)), out_axes=(None, 0))(moved, along)
    slopes = jnp.moveaxis(slopes, 0, -1)
    base, control = array.problem.manifold.basis(z[0]), array.problem._steer(center, jet[0])
    return Linearisation(
        z=z,
        control=control,
        frame=frame,
        jet=jet,
        array=value,
        by_state=slopes[..., :count],
        by_jet=slopes[..., count:].reshape(*jet.shape, *jet.shape),
        position=vec.components(base, z[0]),
        velocity=jnp.concatenate([vec.components(base, part) for part in hamiltonian_field(array.problem, z, control)]),
        omega=form_matrix(bundle.two_form, z, frame),
        costate=vec.components(base, z[1]),
        cost_rate=array.problem.cost_rate(z[0], control),
        lost=loses_digits(lambda q, u: (array.problem.velocity(q, u), array.problem.cost_rate(q, u)), z[0], control),
    )
