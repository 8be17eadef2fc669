"""The KKT system of a discrete trajectory, assembled stage by stage.

``min sum_k cost(y_k) + Phi(q_N)`` subject to the end of each stage being the beginning of the next, with Lagrangian
``sum_k cost(y_k) + <p_k, R1(y_k)> - <p_{k+1}, R2(y_k)> + ...``: the multipliers are the costates.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, Frame
from ..stages import Stage
from .boundary import NodeCondition
from .elimination import BlockSystem

BEFORE, AFTER = slice(None, -1), slice(1, None)  # the node before and the node after each stage


class Iterate(NamedTuple):
    """Unknowns of the stages (leading axis N) and costates at the nodes (leading axis N + 1, ambient arrays)."""

    unknowns: Any
    costates: Ambient


class Assembled(NamedTuple):
    """The KKT system at an iterate, in the units of the problem, and what tells how far the iterate is from satisfying it."""

    blocks: BlockSystem  # with the equations of free coordinates, which ``scaled`` leaves out
    gradient: Array  # of the cost alone, shape (N, s)
    charts: Any  # what the charts of the stages need of their bases
    frames: Frame  # at the nodes
    coordinates: Array  # multipliers in the frames, shape (N + 1, n)
    nodes: Ambient
    costates: Ambient
    cost: Array
    gap: Array  # largest distance between ends that should meet, for each entry of the ambient space, shape (E,)


class _Parts(NamedTuple):
    """Quantities of one stage whose derivatives fill a block row."""

    slope: Array
    start: Array
    end: Array
    cost: Array


class _AtNodes(NamedTuple):
    """What an iterate says at its nodes; slope and curvature are those of the terminal cost."""

    charts: Any
    nodes: Ambient
    distance: Array
    frames: Frame
    gap: Array
    coordinates: Array
    costates: Ambient
    slope: Array
    curvature: Array


@final
class DiscreteTrajectory(eqx.Module):
    """A discrete optimal control problem: the same stage N times between two node conditions."""

    stage: Stage
    start: NodeCondition
    end: NodeCondition
    terminal_cost: Callable[[Any], Array]

    def assemble(self, iterate: Iterate, near: Assembled, chord: ArrayLike) -> Assembled:
        """The KKT system at an iterate: values, first derivatives, and the Hessian of the Lagrangian.

        If ``chord``, the matrices are those of ``near``, for a step of the chord method: a fifth of the work. The residual is
        the iterate's own, so the iteration has the same limit.
        """
        at = self._at_nodes(iterate)
        stages = iterate.unknowns, *self._around(at)

        def anew() -> tuple[BlockSystem, Array, Array]:
            return self._linearised(at, *stages)

        def again() -> tuple[BlockSystem, Array, Array]:
            zero = jnp.zeros(self.stage.dimension)
            parts = jax.vmap(lambda *stage: self._parts(zero, *stage))(*stages)
            starts, ends = shares(near.blocks, at.coordinates)
            return near.blocks._replace(slope=parts.slope, gap=at.gap), parts.slope - starts + ends, parts.cost

        return self._assembled(at, *jax.lax.cond(chord, again, anew))

    def unassembled(self, iterate: Iterate) -> Assembled:
        """A KKT system of the right shapes, all zero."""

        def shaped(iterate: Iterate) -> Assembled:
            at, s = self._at_nodes(iterate), self.stage.dimension
            count, n = at.gap.shape[0] - 1, at.gap.shape[1]
            node, rows = jnp.zeros((count, n, s)), jnp.zeros((count, s))
            blocks = BlockSystem(jnp.zeros((count, s, s)), node, node, rows, at.gap, self.start.mask(), self.end.mask())
            return self._assembled(at, blocks, rows, jnp.zeros(count))

        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(shaped, iterate))

    def move(self, iterate: Iterate, assembled: Assembled, steps: Array, multipliers: Array, fraction: Array) -> Iterate:
        """The iterate moved by a fraction of a step of the block system, through the charts of the stages."""
        y = jax.vmap(self.stage.move)(iterate.unknowns, assembled.charts, fraction * steps)
        return Iterate(y, jax.vmap(vec.combine)(assembled.frames, assembled.coordinates + fraction * multipliers))

    def _at_nodes(self, iterate: Iterate) -> _AtNodes:
        begins, finishes = jax.vmap(self.stage.ends)(iterate.unknowns)
        nodes, gaps = self._nodes(begins, finishes)
        frames = jax.vmap(self.stage.manifold.basis)(nodes)
        gap = jax.vmap(vec.components)(frames, gaps)
        gap = gap.at[0].multiply(self.start.mask()).at[-1].multiply(self.end.mask())
        distance = vec.largest(vec.flatten_frame(gaps), axis=0)
        charts = jax.vmap(self.stage.frame)(iterate.unknowns)
        return _AtNodes(charts, nodes, distance, frames, gap, *self._multipliers(iterate.costates, nodes, frames))

    def _around(self, at: _AtNodes) -> tuple[Any, Ambient, Ambient, Frame, Frame]:
        """Charts of the stages, costates and frames at the nodes before and after each."""
        (p0, e0), (p1, e1) = (jax.tree.map(lambda leaf, s=s: leaf[s], (at.costates, at.frames)) for s in (BEFORE, AFTER))
        return at.charts, p0, p1, e0, e1

    def _linearised(self, at: _AtNodes, *stages: Any) -> tuple[BlockSystem, Array, Array]:
        """Blocks, gradient of the cost, and cost of every stage."""
        rows, parts = jax.vmap(self._block_row)(*stages)
        last = rows.end[-1]
        hessian = rows.slope.at[-1].add(last.T @ at.curvature @ last)
        gradient = rows.cost.at[-1].add(at.slope @ last)
        fixed = self.start.mask(), self.end.mask()
        return BlockSystem(hessian, rows.start, rows.end, parts.slope, at.gap, *fixed), gradient, parts.cost

    def _assembled(self, at: _AtNodes, blocks: BlockSystem, gradient: Array, costs: Array) -> Assembled:
        cost = jnp.sum(costs) + self.terminal_cost(jax.tree.map(lambda leaf: leaf[-1], at.nodes))
        at_nodes = at.charts, at.frames, at.coordinates, at.nodes, at.costates
        return Assembled(blocks, gradient, *at_nodes, cost, at.distance)

    def _nodes(self, begins: Ambient, finishes: Ambient) -> tuple[Ambient, Ambient]:
        """Nodes ``q_0 ... q_N`` and, at each, the beginning of the stage after it minus the end of the one before."""
        first = self.start.node(jax.tree.map(lambda leaf: leaf[0], begins))
        last = self.end.node(jax.tree.map(lambda leaf: leaf[-1], finishes))
        before = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, finishes)
        after = jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), begins, last)
        nodes = jax.tree.map(lambda a, b: jnp.concatenate([a[:-1], b[None]]), before, last)
        return nodes, vec.subtract(after, before)

    def _multipliers(self, costates: Ambient, nodes: Ambient, frames: Frame) -> tuple[Array, Ambient, Array, Array]:
        """Coordinates of the multipliers, the covectors they stand for, and slope and curvature of the terminal cost.

        The multiplier of the last node is ``p_N + dPhi`` on fixed directions and zero on free ones (transversality); the
        covector keeps the whole ambient gradient of Phi, whose normal part enters the Hessian.
        """
        last, frame = (jax.tree.map(lambda leaf: leaf[-1], tree) for tree in (nodes, frames))
        derivative = vec.gradient(self.terminal_cost, last)
        slope = vec.components(frame, derivative)
        push = jax.vmap(lambda e: jax.jvp(lambda q: vec.gradient(self.terminal_cost, q), (last,), (e,))[1])(frame)
        curvature = jax.vmap(lambda image: vec.components(frame, image))(push)
        coordinates = jax.vmap(vec.components)(frames, costates)
        coordinates = coordinates.at[-1].add(slope)
        coordinates = coordinates.at[0].multiply(self.start.mask()).at[-1].multiply(self.end.mask())
        covectors = jax.vmap(vec.combine)(frames, coordinates)
        covectors = jax.tree.map(lambda leaf, d: leaf.at[-1].add(-d), covectors, derivative)
        return coordinates, covectors, slope, curvature

    def _parts(self, d: Array, y: Any, chart: Any, p0: Ambient, p1: Ambient, e0: Frame, e1: Frame) -> _Parts:
        """Parts of one stage at the coordinates ``d`` of its chart."""

        def lagrangian(d: Array) -> tuple[Array, tuple[Array, Array, Array]]:
            moved = self.stage.move(y, chart, d)
            begin, finish = self.stage.ends(moved)
            cost = self.stage.cost(moved)
            parts = vec.components(e0, begin), vec.components(e1, finish), cost
            return cost + vec.pairing(p0, begin) - vec.pairing(p1, finish), parts

        slope, parts = jax.grad(lagrangian, has_aux=True)(d)
        return _Parts(slope, *parts)

    def _block_row(self, *stage: Any) -> tuple[_Parts, _Parts]:
        """Derivatives of one stage's parts in its chart, and the parts themselves."""
        zero = jnp.zeros(self.stage.dimension)
        values, push = jax.linearize(lambda d: self._parts(d, *stage), zero)
        return jax.vmap(push, out_axes=-1)(jnp.eye(zero.size)), values


def shares(blocks: BlockSystem, coordinates: Array) -> tuple[Array, Array]:
    """What the multipliers of the nodes before and after each stage contribute to the derivative of the Lagrangian."""
    return (
        jnp.einsum("kns,kn->ks", blocks.left, coordinates[:-1]),
        jnp.einsum("kns,kn->ks", blocks.right, coordinates[1:]),
    )
