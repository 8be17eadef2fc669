"""Units in which a trajectory's KKT system is free of the units that its problem is written in.

A coordinate of the state is measured by what the controls reach in it over the horizon. The cheapest way from rest to a
deviation ``e`` costs ``e' G^-1 e / 2`` with the Gramian ``G_{k+1} = A G_k A' + B W B'`` of the linearised steps, ``W`` the
inverse curvature of the cost in the controls; both ends are fixed, so the smaller of the Gramians from the start and from the
end counts. One factor is left, the size of the trajectory: what its ends, its guess and the slope of the cost ask for.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .elimination import BlockSolution, BlockSystem

SHARE = 1e-3  # of the natural unit: a coordinate that moves by less is not measured by its own size
NOISE = 0.5  # power of the machine epsilon: what is reached less than this, beside others, is not reached


class Units(NamedTuple):
    """Natural sizes of a step of the stages' unknowns and of the nodes' gaps, and of the cost of a stage."""

    unknowns: Float[Array, " s"]
    nodes: Float[Array, " n"]
    cost: Array


def natural_units(blocks: BlockSystem, gradient: Array, states: Float[Array, " n"], controls: Float[Array, " m"]) -> Units:
    """Units from the linearised trajectory, its displacement in the states and the sizes of its controls."""
    count, n = len(blocks.hessian), states.size
    curvature = jnp.sum(jnp.abs(jnp.diagonal(blocks.hessian, axis1=1, axis2=2)), axis=0)
    slope = jnp.sum(jnp.abs(gradient), axis=0)
    own = jnp.concatenate([states, controls])
    convex = jnp.all(curvature[n:] > 0)
    push = jnp.where(convex, 1 / jnp.sqrt(jnp.where(curvature[n:] > 0, curvature[n:], 1.0)), controls)
    reach = jnp.concatenate([_reach(blocks, count * push**2), push])
    asked = jnp.where(reach > 0, own / jnp.where(reach > 0, reach, 1.0), 0.0)
    asked = jnp.maximum(asked, jnp.where(convex, slope * reach / (1 + curvature * reach**2), 0.0))
    typical = jnp.sort(jnp.where(asked > 0, asked, jnp.inf))[jnp.maximum(jnp.sum(asked > 0) - 1, 0) // 2]
    asked = jnp.where(asked * jnp.finfo(reach.dtype).eps ** NOISE <= typical, asked, 0.0)
    unknowns = _or_one(jnp.maximum(own, jnp.max(asked) * reach))
    return Units(unknowns, unknowns[:n], _or_one(jnp.max(jnp.maximum(curvature * unknowns**2, slope * unknowns)) / count))


def _or_one(size: Array) -> Array:
    return jnp.where((size > 0) & jnp.isfinite(size), size, 1.0)


def _reach(blocks: BlockSystem, variance: Float[Array, " m"]) -> Float[Array, " n"]:
    """How far controls of this variance move each coordinate of a node between two fixed ends."""
    n = blocks.left.shape[1]
    ahead = jnp.linalg.solve(blocks.left[:, :, :n], blocks.left[:, :, n:])
    push = blocks.right[:, :, n:] - blocks.right[:, :, :n] @ ahead
    push = (push * variance) @ push.mT
    forth = jnp.linalg.solve(blocks.left[:, :, :n].mT, blocks.right[:, :, :n].mT).mT
    back = jnp.linalg.solve(blocks.right[:, :, :n].mT, blocks.left[:, :, :n].mT).mT

    def forward(gramian: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        gramian = step[0] @ gramian @ step[0].T + step[1]
        return gramian, jnp.diagonal(gramian)

    def backward(gramian: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        gramian = step[0] @ (gramian + step[1]) @ step[0].T
        return gramian, jnp.diagonal(gramian)

    zero = jnp.zeros((n, n), push.dtype)
    before = jax.lax.scan(forward, zero, (forth, push))[1]
    after = jax.lax.scan(backward, zero, (back, push), reverse=True)[1]
    # One step has no node between its ends.
    middle = jnp.where(len(before) > 1, jnp.minimum(before[:-1], after[1:]).max(axis=0, initial=0.0), before[-1])
    return jnp.sqrt(jnp.where(jnp.isfinite(middle), jnp.maximum(middle, 0.0), 0.0))


def scaled(blocks: BlockSystem, units: Units) -> BlockSystem:
    """The system in units, without the equations of free coordinates at its ends."""
    d, g, cost = units
    left = (blocks.left * (d / g[:, None])).at[0].multiply(blocks.fixed_start[:, None])
    right = (blocks.right * (d / g[:, None])).at[-1].multiply(blocks.fixed_end[:, None])
    hessian = blocks.hessian * (d * d[:, None] / cost)
    return BlockSystem(hessian, left, right, blocks.slope * (d / cost), blocks.gap / g, blocks.fixed_start, blocks.fixed_end)


def unscaled(solution: BlockSolution, units: Units) -> tuple[Array, Array]:
    """Steps of the unknowns and of the multipliers in the units of the problem."""
    return solution.steps * units.unknowns, solution.multipliers * (units.cost / units.nodes)
