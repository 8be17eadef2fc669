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
    left, right = blocks.left[:, :, :n], blocks.right[:, :, :n]
    inverses = jnp.linalg.inv(jnp.stack([left, right]))
    forth, back = right @ inverses[0], left @ inverses[1]
    push = blocks.right[:, :, n:] - forth @ blocks.left[:, :, n:]
    push = (push * variance) @ push.mT

    def step(gramians: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        gramians = step[0] @ gramians @ step[0].mT + step[1]
        return gramians, jnp.diagonal(gramians, axis1=1, axis2=2)

    # From the start forward and from the end backward at once.
    moves, pushes = jnp.stack([forth, back[::-1]], axis=1), jnp.stack([push, (back @ push @ back.mT)[::-1]], axis=1)
    _, sizes = jax.lax.scan(step, jnp.zeros((2, n, n), push.dtype), (moves, pushes))
    # One step has no node between its ends.
    between = jnp.minimum(sizes[:-1, 0], sizes[-2::-1, 1]).max(axis=0) if len(sizes) > 1 else sizes[0, 0]
    return jnp.sqrt(jnp.where(jnp.isfinite(between), jnp.maximum(between, 0.0), 0.0))


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
