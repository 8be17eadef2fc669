"""Quantities computed from a discrete extremal: stage costates, Hamiltonians, momenta, errors."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...manifolds import Manifold, MatrixLieGroup
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.product import homogeneous_factors
from ..stages import ControlStage


class Diagnostics(NamedTuple):
    """Derived quantities: along stages (N), along nodes (N + 1), and one number."""

    stage_costates: Ambient
    hamiltonians: Array
    momenta: dict[str, Array]
    body: dict[str, Array]
    spatial: dict[str, Array]
    violations: dict[str, Array]  # of the manifold's equations, largest over the nodes
    normal: Array  # normal part of the dynamics, relative to 1 + its size, largest over the stages


def diagnose(stage: ControlStage, unknowns: Any, nodes: Ambient, costates: Ambient) -> Diagnostics:
    """Diagnostics of a trajectory from the stages' unknowns and the states and costates at the nodes."""

    def at_stage(y: Any, p0: Ambient, p1: Ambient) -> tuple[Ambient, Array, Array]:
        x, u = y
        _, v = stage.tangent(y)
        _, pull = vec.pullback(lambda w: stage.discretization(x, w), v)
        covector = stage.manifold.projection(x, pull((vec.scale(-1.0, p0), p1))[0])
        normal, size = stage.problem.normal_size(x, u)
        return covector, stage.problem.hamiltonian(x, covector, u), normal / (1 + size)

    before, after = (jax.tree.map(lambda leaf, s=s: leaf[s], costates) for s in (slice(None, -1), slice(1, None)))
    stage_costates, hamiltonians, normal = jax.vmap(at_stage)(unknowns, before, after)
    frames = jax.vmap(lambda q, p: _group_frames(stage.manifold, q, p))(nodes, costates)
    violations = jax.tree.map(jnp.max, jax.vmap(stage.manifold.violations)(nodes))
    return Diagnostics(stage_costates, hamiltonians, *frames, violations, jnp.max(normal))


def _group_frames(manifold: Manifold, q: Ambient, p: Ambient) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Momenta of every factor on which a group acts; body and spatial covectors of the matrix groups among them."""
    momenta, body, spatial = {}, {}, {}
    points, covectors = homogeneous_factors(manifold, q), homogeneous_factors(manifold, p)
    for (name, factor, x), (_, _, covector) in zip(points, covectors, strict=True):
        momenta[name] = factor.momentum(x, covector)
        if isinstance(factor, MatrixLieGroup):
            body[name], spatial[name] = factor.body(x, covector), factor.spatial(x, covector)
    return momenta, body, spatial
