"""Boundary conditions of an extremal on the final manifold ``P_f``, and whether each end alone can be met there."""

from collections.abc import Callable, Iterator
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....manifolds import InvalidInputError, Manifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient, Frame
from ....retractions import Retraction
from ...compilation import compiled
from ...problem import OptimalControlProblem
from ...singular import Classification, FinalEquations
from ..boundary import NodeCondition, Part
from .least_squares import least_squares
from .shooting import Pair

MOST_STARTS = 8
CONTRADICTED = 1e-9  # residual of the equations of P_f, which are of order one near it


@final
class EndConditions(eqx.Module):
    """``q`` as prescribed at both ends; where it is free ``p = 0`` at the start and ``p = -dPhi`` at the end: ``2n`` in all."""

    problem: OptimalControlProblem
    start: NodeCondition
    end: NodeCondition

    def costate_at_start(self, z: Pair) -> Ambient:
        """The covector that vanishes along the directions free at the start."""
        return z[1]

    def costate_at_end(self, z: Pair) -> Ambient:
        """The covector ``p + dPhi`` that vanishes along the directions free at the end."""
        return vec.add(z[1], vec.gradient(self.problem.final_cost, z[0]))

    def at_start(self, z: Pair) -> Float[Array, " n"]:
        """The conditions at the start, in coordinates of the tangent space of Q."""
        return _rows(self.problem.manifold, self.start, z[0], self.costate_at_start(z))

    def at_end(self, z: Pair) -> Float[Array, " n"]:
        """The conditions at the end."""
        return _rows(self.problem.manifold, self.end, z[0], self.costate_at_end(z))

    def at(self, first: Pair, frame: Frame, last: Pair, moves: Frame) -> "AtEnds":
        """The conditions at both ends, and their derivatives along frames there."""
        start, by_first = _along(self.at_start, first, frame)
        end, by_last = _along(self.at_end, last, moves)
        missed = *_violations(self.start, first, start), *_violations(self.end, last, end)
        return AtEnds(start, by_first, end, by_last, dict(missed))


class AtEnds(NamedTuple):
    """The boundary conditions, shape (n,) each, with their derivatives, (n, vectors of a frame).

    ``violations``: for each part of both ends, in words, by how much it is missed in the ambient space, relative to 1 + size.
    """

    start: Array
    by_first: Array
    end: Array
    by_last: Array
    violations: dict[str, Array]


def _along(function: Callable[[Pair], Array], z: Pair, frame: Frame) -> tuple[Array, Array]:
    """Values of a function and its derivatives along the vectors of a frame, shape ``(values, vectors)``."""
    return jax.vmap(lambda a: jax.jvp(function, (z,), (a,)), out_axes=(None, 1))(frame)


def _rows(manifold: Manifold, condition: NodeCondition, q: Ambient, costate: Ambient) -> Float[Array, " n"]:
    node, mask = condition.node(q), condition.mask()
    frame = jax.lax.stop_gradient(manifold.basis(node))
    return mask * vec.components(frame, vec.subtract(q, node)) + (1 - mask) * vec.components(frame, costate)


def _violations(condition: NodeCondition, z: Pair, rows: Array) -> Iterator[tuple[str, Array]]:
    reached, wanted = jax.tree.leaves(z[0]), jax.tree.leaves(condition.point)
    leaf = row = 0
    for part in condition.parts:
        here = slice(leaf, leaf + part.leaves)
        missed = [vec.size(a - b) / (1 + vec.size(b)) for a, b in zip(reached[here], wanted[here], strict=True)]
        costate = vec.size(rows[row : row + part.dimension]) / (1 + vec.size(z[1]))
        yield part_name(part), vec.largest(jnp.stack(missed)) if part.fixed and missed else costate
        leaf, row = leaf + part.leaves, row + part.dimension


def part_name(part: Part) -> str:
    """A condition in words: ``start, factor 1: state``."""
    return f"{part.name}: {'state' if part.fixed else 'costate'}"


class Node(NamedTuple):
    """A point of ``T*Q`` that meets the conditions of one end, and the values of the equations of ``P_f`` there."""

    z: Pair
    values: Float[Array, " codimension"]


def points_at_ends(c: Classification, conditions: EndConditions, move: Retraction) -> tuple[Pair, Pair]:
    """A point of ``P_f`` that meets the conditions at the start, and one for the end.

    Raises ``InvalidInputError`` where the boundary data contradict the equations of ``P_f``.
    """
    starts = jax.tree.map(lambda leaf: jnp.asarray(leaf[: MOST_STARTS - 1]), c.stratum.states[1])
    if not c.zero_costate_excluded:
        starts = jax.tree.map(lambda leaf: jnp.concatenate([jnp.zeros_like(leaf[:1]), leaf]), starts)
    found = []
    for condition, terminal in ((conditions.start, 0.0), (conditions.end, 1.0)):
        data = condition.point, condition.mask(), jnp.asarray(terminal)
        nodes = jax.device_get(_nearest(c.problem, c.equations, move, starts, *data))
        found.append(_chosen(c, condition, nodes))
    return found[0], found[1]


@compiled
def _nearest(
    problem: OptimalControlProblem,
    equations: FinalEquations,
    move: Retraction,
    covectors: Ambient,
    given: Ambient,
    mask: Float[Array, " n"],
    terminal: Float[Array, ""],
) -> Node:
    """From each covector: free states, and costates along the others, for which the equations of ``P_f`` are least violated.

    Costates along the free coordinates are ``-terminal dPhi``.
    """
    manifold = problem.manifold
    frame = manifold.basis(jax.tree.map(jnp.asarray, given))

    def point(c: Array) -> Pair:
        q = move(given, vec.combine(frame, (1 - mask) * c))
        tangent = manifold.basis(q)
        slope = terminal * vec.components(tangent, vec.gradient(problem.final_cost, q))
        return q, vec.combine(tangent, mask * c - (1 - mask) * slope)

    def one(covector: Ambient) -> Node:
        c, values = least_squares(lambda c: equations(point(c)), mask * vec.components(frame, covector))
        return Node(point(c), values)

    return jax.vmap(one)(covectors)


def _chosen(c: Classification, condition: NodeCondition, nodes: Node) -> Pair:
    """The first of the points that lies on ``P_f``; raises if there is none."""
    worst = np.nan_to_num(np.max(np.abs(nodes.values), axis=1, initial=0.0), nan=np.inf)
    met = np.flatnonzero(worst <= CONTRADICTED)
    best = int(met[0]) if met.size else int(np.argmin(worst))
    z = jax.tree.map(lambda leaf: jnp.asarray(leaf[best]), nodes.z)
    if met.size:
        return z
    values = zip(c.equations.names, nodes.values[best], strict=True)
    broken = ", ".join(f"{name} equation = {value:.3g}" for name, value in values if not abs(value) <= CONTRADICTED)
    end = condition.parts[0].name.split(",")[0]
    given = [part.name for part in condition.parts if part.fixed]
    piece = "the first piece of P_f" if c.stratified else "P_f"
    raise InvalidInputError(
        f"the boundary data admit no extremal: no point of {piece} found that meets the conditions at the {end} "
        f"({', '.join(given) + ' prescribed' if given else 'all of it free'}); equations of P_f that they contradict: {broken} "
        f"(relative) whatever the {'free states and ' if len(given) < len(condition.parts) else ''}costates, at q = {z[0]}; "
        "free the components that these equations restrict, or prescribe values on P_f (classification.manifold.nearby)"
    )
