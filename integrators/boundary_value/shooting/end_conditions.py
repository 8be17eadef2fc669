"""Boundary conditions of an extremal on the final manifold ``P_f``, and whether each end alone can be met there."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ....compute.jit_cache import compile_function
from ....manifolds import InvalidInputError, Manifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient, Frame
from ....retractions import Retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from ...singular import Classification
from ...singular.integrability import FinalEquations
from ..inputs.boundary_data import EndPart, NodeCondition
from .least_squares import least_squares
from .segments import Pair

MOST_STARTS = 8  # points of P_f from which a point that meets the end conditions is searched
FINAL_ROUNDING = 1e-6  # of the equations of P_f, of order one: their rounding at a point of it
CONTRADICTED = 1e-9  # residual of the equations of P_f, over their terms
RANDOM = 5  # points at which a terminal cost is looked at


@final
class EndConditions(eqx.Module):
    """The ``2n`` conditions at both ends: ``q`` as prescribed, and for free parts ``p = 0`` at the start, ``p = -dPhi``
    at the end.

    Costates are measured in ``unit``, so that no condition depends on the unit of the cost.
    """

    problem: OptimalControlProblem
    start: NodeCondition
    end: NodeCondition
    unit: Array | float = 1.0

    def in_units_of(self, c: Classification) -> "EndConditions":
        """The conditions with their unit: the largest size of ``dPhi`` at the ends and random points, and of ``p`` on
        ``P_f``.

        The size of ``p`` says nothing where ``p = 0`` meets the equations: it is any number, or rounding.
        """
        s = c.stratum
        slopes, at_zero = jax.device_get(_scales(self.problem, c.equations, s.q, s.p, self.start.point, self.end.point))
        size = np.max(slopes)
        if not np.max(np.abs(at_zero), initial=0.0) <= FINAL_ROUNDING:
            leaves = jax.tree.leaves(s.states[1])
            size = max(size, *(np.median(np.max(np.abs(a.reshape(len(a), -1)), axis=1, initial=0.0)) for a in leaves))
        return replace(self, unit=jnp.asarray(size if size > 0 else 1.0))

    def costate_at_start(self, z: Pair) -> Ambient:
        """The covector that vanishes along the directions free at the start."""
        return z[1]

    def costate_at_end(self, z: Pair) -> Ambient:
        """The covector ``p + dPhi`` that vanishes along the directions free at the end."""
        return vec.add(z[1], vec.gradient(self.problem.final_cost, z[0]))

    def at_start(self, z: Pair) -> Float[Array, " n"]:
        """The conditions at the start, in coordinates of the tangent space of Q."""
        return _rows(self.problem.manifold, self.start, z[0], vec.scale(1 / self.unit, self.costate_at_start(z)))

    def at_end(self, z: Pair) -> Float[Array, " n"]:
        """The conditions at the end."""
        return _rows(self.problem.manifold, self.end, z[0], vec.scale(1 / self.unit, self.costate_at_end(z)))

    def at(self, first: Pair, frame: Frame, last: Pair, moves: Frame) -> "EndValues":
        """The conditions at both ends, and their derivatives along frames there."""
        start, by_first = _along(self.at_start, first, frame)
        end, by_last = _along(self.at_end, last, moves)
        missed = *_violations(self.start, first, start, self.unit), *_violations(self.end, last, end, self.unit)
        return EndValues(start, by_first, end, by_last, dict(missed))


class EndValues(NamedTuple):
    """The boundary conditions, shape (n,) each, with their derivatives, (n, vectors of a frame).

    ``violations``: for each part of both ends, in words, by how much it is missed in the ambient space, relative to 1 +
    size.
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


@compile_function
def _scales(
    problem: OptimalControlProblem, equations: FinalEquations, q: Ambient, p: Ambient, *ends: Ambient
) -> tuple[Array, Array]:
    """Largest entries of ``dPhi`` at both ends and, in the middle, at random points; the equations of ``P_f`` at ``(q,
    0)``."""
    drawn = [problem.manifold.random_point(key) for key in jax.random.split(jax.random.key(0), RANDOM)]
    sizes = [vec.size(problem.manifold.projection(x, vec.gradient(problem.final_cost, x))) for x in (*ends, *drawn)]
    return jnp.stack([*sizes[: len(ends)], jnp.median(jnp.stack(sizes[len(ends) :]))]), equations(
        (q, vec.scale(0.0, p))
    )


def _violations(condition: NodeCondition, z: Pair, rows: Array, unit: ArrayLike) -> Iterator[tuple[str, Array]]:
    reached, wanted = jax.tree.leaves(z[0]), jax.tree.leaves(condition.point)
    leaf = row = 0
    for part in condition.parts:
        here = slice(leaf, leaf + part.leaves)
        missed = [vec.size(a - b) / (1 + vec.size(b)) for a, b in zip(reached[here], wanted[here], strict=True)]
        costate = vec.size(rows[row : row + part.dimension]) / (1 + vec.size(z[1]) / unit)
        yield part_name(part), vec.largest(jnp.stack(missed)) if part.fixed and missed else costate
        leaf, row = leaf + part.leaves, row + part.dimension


def part_name(part: EndPart) -> str:
    """A condition in words: ``start, factor 1: state``."""
    return f"{part.name}: {'state' if part.fixed else 'costate'}"


class Node(NamedTuple):
    """A point of ``T*Q`` that meets the conditions of one end, and the equations of ``P_f`` there, over their terms."""

    z: Pair
    values: Float[Array, " codimension"]


def points_at_ends(c: Classification, conditions: EndConditions, move: Retraction) -> tuple[Pair, Pair]:
    """A point of ``P_f`` that meets the conditions at the start, and one for the end.

    Raises ``InvalidInputError`` where the boundary data contradict the equations of ``P_f``.
    """
    starts = jax.tree.map(jnp.asarray, vec.taken(c.stratum.states[1], slice(MOST_STARTS - 1)))
    if not c.zero_costate_excluded:
        starts = jax.tree.map(lambda leaf: jnp.concatenate([jnp.zeros_like(leaf[:1]), leaf]), starts)
    found = []
    for condition, terminal in ((conditions.start, 0.0), (conditions.end, 1.0)):
        data = condition.point, condition.mask(), jnp.asarray(terminal)
        nodes = jax.device_get(_nearest(c.problem, c.equations, move, starts, jnp.asarray(conditions.unit), *data))
        found.append(_choose(c, condition, nodes))
    return found[0], found[1]


@compile_function
def _nearest(
    problem: OptimalControlProblem,
    equations: FinalEquations,
    move: Retraction,
    covectors: Ambient,
    unit: Array,
    given: Ambient,
    mask: Float[Array, " n"],
    terminal: Float[Array, ""],
) -> Node:
    """The free states, and costates along prescribed coordinates, that violate the equations of ``P_f`` least, from
    each covector.

    Costates along the free coordinates are ``-terminal dPhi``. Equations are measured by their terms, whatever the unit
    of the cost: derivatives by the state times 1 + its entries, and by the costate times its entries, or ``unit`` if
    that is larger.
    """
    manifold = problem.manifold
    frame = manifold.basis(jax.tree.map(jnp.asarray, given))

    def point(c: Array) -> Pair:
        q = move(given, vec.combine(frame, (1 - mask) * c))
        tangent = manifold.basis(q)
        slope = terminal * vec.components(tangent, vec.gradient(problem.final_cost, q))
        return q, vec.combine(tangent, mask * c - (1 - mask) * slope)

    def terms(z: Pair) -> Array:
        basis = manifold.basis(z[0])
        none = jax.tree.map(jnp.zeros_like, basis)
        by_state, by_costate = (jnp.abs(_along(equations, z, moves)[1]) for moves in ((basis, none), (none, basis)))
        lengths, sizes = (
            1 + jnp.abs(vec.components(basis, z[0])),
            jnp.maximum(jnp.abs(vec.components(basis, z[1])), unit),
        )
        total = by_state @ lengths + by_costate @ sizes
        return jnp.where(total > 0, total, 1.0)

    def one(covector: Ambient) -> Node:
        start = mask * vec.components(frame, covector)
        size = terms(point(start))
        c, values = least_squares(lambda c: equations(point(c)) / size, start)
        return Node(point(c), values / jnp.maximum(1.0, terms(point(c)) / size))

    return jax.vmap(one)(covectors)


def _choose(c: Classification, condition: NodeCondition, nodes: Node) -> Pair:
    """The first of the points that lies on ``P_f``; raises if there is none."""
    worst = np.nan_to_num(np.max(np.abs(nodes.values), axis=1, initial=0.0), nan=np.inf)
    met = np.flatnonzero(worst <= CONTRADICTED)
    best = int(met[0]) if met.size else int(np.argmin(worst))
    z = jax.tree.map(jnp.asarray, vec.taken(nodes.z, best))
    if met.size:
        return z
    values = zip(c.equations.names, nodes.values[best], strict=True)
    broken = ", ".join(f"{name} equation = {value:.3g}" for name, value in values if not abs(value) <= CONTRADICTED)
    end = condition.parts[0].name.split(",")[0]
    given = [part.name for part in condition.parts if part.fixed]
    piece = "the first piece of P_f" if c.stratified else "P_f"
    raise InvalidInputError(
        f"the boundary data admit no extremal: no point of {piece} found that meets the conditions at the {end} "
        f"({', '.join(given) + ' prescribed' if given else 'all of it free'}); equations of P_f that they contradict: "
        f"{broken} (relative) whatever the {'free states and ' if len(given) < len(condition.parts) else ''}costates, "
        f"at q = {z[0]}; free the components that these equations restrict, or prescribe values on P_f "
        "(classification.manifold.nearby)"
    )
