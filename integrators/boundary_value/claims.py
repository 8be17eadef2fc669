"""What a solution claims, in units of its own trajectory: ends meet, its cost is stationary, and both determine it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...manifolds.numerics import ambient as vec
from ..problem import OptimalControlProblem
from .assembly import Assembled, Iterate, shares
from .elimination import BlockSolution
from .scaling import SHARE, Units

VALUE = 1e-2  # of its value, which is rounded, an entry is measured by where it moves less than that


class Sizes(NamedTuple):
    """Extent of a trajectory: the spread of its nodes and the sizes of its controls."""

    values: Float[Array, " E"]  # largest value of each ambient entry of a node
    spreads: Float[Array, " E"]
    support: Float[Array, "n E"]  # largest entries of the frames at the nodes
    controls: Float[Array, " m"]

    @property
    def displacements(self) -> Float[Array, " n"]:
        """Spread of each coordinate of a node."""
        return jnp.max(self.support * self.spreads, axis=1, initial=0.0)


class Residuals(NamedTuple):
    """Largest distance between ends that should meet and derivative of the Lagrangian, relative to what they are made of."""

    gap: Array
    stationarity: Array

    @property
    def largest(self) -> Array:
        return jnp.maximum(self.gap, self.stationarity)


def own_sizes(problem: OptimalControlProblem, iterate: Iterate, assembled: Assembled) -> Sizes:
    """Sizes of the trajectory."""
    nodes = vec.flatten_frame(assembled.nodes)
    support = jnp.max(jnp.abs(jax.vmap(vec.flatten_frame)(assembled.frames)), axis=0)
    _, u = iterate.unknowns
    directions = jnp.max(jnp.abs(jax.vmap(lambda c: vec.flatten_frame(problem.controls.basis(c)))(u)), axis=0)
    controls = jnp.max(directions * jnp.max(jnp.abs(vec.flatten_frame(u)), axis=0), axis=1, initial=0.0)
    return Sizes(jnp.max(jnp.abs(nodes), axis=0), jnp.ptp(nodes, axis=0), support, controls)


def residuals(assembled: Assembled, sizes: Sizes, units: Units) -> Residuals:
    """How far the iterate is from satisfying the KKT conditions."""
    return Residuals(_gap(assembled, sizes, units), _stationarity(assembled, units))


def _gap(assembled: Assembled, sizes: Sizes, units: Units) -> Array:
    """Largest distance between ends that should meet, entry by entry of the ambient space.

    An entry is measured by the spread of the trajectory in it, by a share of its value, or, where it rests, of its unit.
    """
    own = jnp.maximum(sizes.spreads, VALUE * sizes.values)
    along = jnp.maximum(jnp.max(sizes.support * own, axis=1, initial=0.0), SHARE * units.nodes)
    entries = jnp.maximum(own, jnp.max(sizes.support * along[:, None], axis=0, initial=0.0))
    return vec.largest(assembled.gap / jnp.where(entries > 0, entries, 1.0))


def _stationarity(assembled: Assembled, units: Units) -> Array:
    """Largest entry of the Lagrangian's derivative relative to the parts that cancel in it, coordinate by coordinate.

    Where all parts vanish, as the costates do at an optimum of the cost itself, its curvature in any coordinate sets the scale.
    """
    blocks, d = assembled.blocks, units.unknowns
    starts, ends = shares(blocks, assembled.coordinates)
    parts = d * jnp.max(jnp.abs(assembled.gradient) + jnp.abs(starts) + jnp.abs(ends), axis=0)
    curvature = d * d * jnp.max(jnp.abs(jnp.diagonal(blocks.hessian, axis1=1, axis2=2)), axis=0)
    scale = jnp.maximum(parts, SHARE * jnp.maximum(jnp.max(parts), jnp.max(curvature)))
    return vec.largest(blocks.slope * d / jnp.where(scale > 0, scale, 1.0))


def growth(sizes: Sizes, units: Units) -> Array:
    """How far the trajectory goes, in the units that its data ask for: what a nearly singular system blows up."""
    return vec.largest(jnp.concatenate([sizes.displacements, sizes.controls]) / units.unknowns)


def correction(solution: BlockSolution, sizes: Sizes, units: Units) -> Array:
    """Largest step that the linearised conditions still ask for, relative to the trajectory: the error that remains.

    It is ``K^-1`` times the residual, rounding included. Where K is singular to rounding, it is as large as the trajectory.
    """
    own = jnp.concatenate([jnp.max(sizes.support * (sizes.spreads + sizes.values), axis=1, initial=0.0), sizes.controls])
    return vec.largest(solution.steps * units.unknowns / jnp.maximum(own, SHARE * units.unknowns))
