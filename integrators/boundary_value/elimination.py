"""Block elimination of a trajectory's KKT system: cost linear in the number of steps."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

WEIGHT = 2.0**8  # times the number of steps, the curvature of the cost of one being about 1


class BlockSystem(NamedTuple):
    """Linear system in the steps ``d_k`` of the stages and those ``c_k`` of the nodes' multipliers, N stages, N + 1 nodes:

        hessian_k d_k + left_k' c_k - right_k' c_{k+1} = -slope_k
        left_k d_k - right_{k-1} d_{k-1}               = -gap_k

    with no ``left`` at the last node and no ``right`` before the first. Where ``fixed_start`` or ``fixed_end`` is 0 the
    equation of that node's coordinate is ``c = 0`` instead.
    """

    hessian: Float[Array, "N s s"]
    left: Float[Array, "N n s"]
    right: Float[Array, "N n s"]
    slope: Float[Array, "N s"]
    gap: Float[Array, "N+1 n"]
    fixed_start: Float[Array, " n"]
    fixed_end: Float[Array, " n"]


class BlockSolution(NamedTuple):
    """Solution of a ``BlockSystem``, with the symmetric pivot blocks of the elimination, whose inertia is the system's."""

    multipliers: Float[Array, "N+1 n"]
    steps: Float[Array, "N s"]
    pivots: Float[Array, "N-1 n+s n+s"]
    last_pivot: Float[Array, "n+s+n n+s+n"]


def eliminate(system: BlockSystem) -> BlockSolution:
    """Solve by eliminating ``(c_k, d_k)`` stage after stage; each leaves a Schur complement on the next node.

    A pivot is singular where the problem up to its node, with a free end there, has a focal point, as a quarter turn away on a
    sphere. So ``weight (|right_k d_k|^2 - |left_k d_k|^2) / 2`` is added to the cost of each stage: by the equations of the
    nodes these cancel one another, the solution and the inertia stay, but each of those free ends is held by the weight.
    """
    weight = WEIGHT * system.hessian.shape[0]
    held = weight * (system.right.mT @ system.right - system.left.mT @ system.left)
    push = weight * jnp.einsum("kns,kn->ks", system.left, system.gap[:-1])
    solution = _eliminate(system._replace(hessian=system.hessian + held, slope=system.slope - push))
    ends = weight * jnp.einsum("kns,ks->kn", system.right, solution.steps)
    return solution._replace(multipliers=solution.multipliers.at[1:].add(-ends))


def _eliminate(system: BlockSystem) -> BlockSolution:
    """The same without weights. The last node goes with the last stage."""
    n = system.gap.shape[1]
    size = n + system.hessian.shape[1]

    def block(hessian: Array, left: Array, right: Array) -> tuple[Array, Array]:
        corner = jnp.zeros((n, n), hessian.dtype)
        pivot = jnp.block([[corner, left], [left.T, hessian]])
        return pivot, jnp.concatenate([corner, -right.T])

    pivots, couplings = jax.vmap(block)(system.hessian, system.left, system.right)
    sides = jnp.concatenate([-system.gap[:-1], -system.slope], axis=1)

    def forward(carry: tuple[Array, Array], stage: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], tuple]:
        schur, shift = carry
        pivot, coupling, side = stage
        pivot = pivot.at[:n, :n].add(schur)
        reduced = jnp.linalg.solve(pivot, jnp.concatenate([coupling, side.at[:n].add(shift)[:, None]], axis=1))
        onto = -coupling.T @ reduced
        return (onto[:, :n], onto[:, n]), (reduced, pivot)

    start = (jnp.diag(system.fixed_start - 1), jnp.zeros(n, sides.dtype))
    before = (pivots[:-1], couplings[:-1], sides[:-1])
    (schur, shift), (reduced, eliminated) = jax.lax.scan(forward, start, before)
    end = jnp.diag(system.fixed_end - 1)
    last_pivot = jnp.block([[pivots[-1].at[:n, :n].add(schur), couplings[-1]], [couplings[-1].T, end]])
    last = jnp.linalg.solve(last_pivot, jnp.concatenate([sides[-1].at[:n].add(shift), -system.gap[-1]]))

    def backward(following: Array, stage: Array) -> tuple[Array, Array]:
        unknowns = stage[:, n] - stage[:, :n] @ following
        return unknowns[:n], unknowns

    _, unknowns = jax.lax.scan(backward, last[:n], reduced, reverse=True)
    unknowns = jnp.concatenate([unknowns, last[None, :size]])
    multipliers = jnp.concatenate([unknowns[:, :n], last[None, size:]])
    return BlockSolution(multipliers, unknowns[:, n:], eliminated, last_pivot)


def is_strict_minimum(solution: BlockSolution) -> Array:
    """Whether the Hessian is positive definite on the null space of the constraints, beyond rounding.

    This is the second-order sufficient condition of a strict local minimum. By Sylvester's law of inertia it holds exactly
    if the pivots have as many negative eigenvalues as there are node equations, ``(N + 1) n``, and none is zero.
    """
    count = solution.multipliers.size
    negative, smallest = _inertia(solution.pivots)
    negative_last, smallest_last = _inertia(solution.last_pivot[None])
    clear = jnp.finfo(solution.steps.dtype).eps ** 0.6
    return (negative + negative_last == count) & (jnp.minimum(smallest, smallest_last) > clear)


def _inertia(blocks: Float[Array, "N s s"]) -> tuple[Array, Array]:
    """Number of negative pivots of ``L D L'`` of symmetric blocks, all at once, and the smallest pivot's size.

    A fixed random rotation makes leading minors nonzero, so that no interchange is needed [Baboulin et al. 2014]; rows and
    columns are scaled to one size before. Ten times as fast as the eigenvalues of many small blocks.
    """
    size = blocks.shape[-1]
    sizes = jnp.sqrt(jnp.max(jnp.abs(blocks), axis=-1))
    units = jnp.where(sizes > 0, sizes, 1.0)
    rotation = jnp.asarray(np.linalg.qr(np.random.default_rng(0).normal(size=(size, size)))[0], blocks.dtype)
    rotated = rotation.T @ (blocks / (units[:, :, None] * units[:, None, :])) @ rotation

    def pivot(i: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        remaining, negative, smallest = state
        column = remaining[:, :, i]
        diagonal = column[:, i]
        update = column[:, :, None] * column[:, None, :] / diagonal[:, None, None]
        return (
            remaining - update,
            negative + jnp.sum(diagonal < 0),
            jnp.minimum(smallest, jnp.min(jnp.abs(diagonal), initial=jnp.inf)),
        )

    start = rotated, jnp.zeros((), int), jnp.asarray(jnp.inf, blocks.dtype)
    _, negative, smallest = jax.lax.fori_loop(0, size, pivot, start)
    return negative, smallest
