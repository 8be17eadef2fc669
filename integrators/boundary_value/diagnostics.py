"""Quantities computed from a discrete extremal: stage costates, Hamiltonians, momenta, errors."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import Manifold, MatrixLieGroup
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.product import homogeneous_factors
from ..problem import OptimalControlProblem
from ..stages import ControlStage
from ..stages.stage import positive

ROUNDING = 100.0  # times the machine epsilon: what sums and products of a few terms lose


class Diagnostics(NamedTuple):
    """Derived quantities: along stages (N), along nodes (N + 1), and one number."""

    stage_costates: Ambient
    hamiltonians: Array
    hamiltonian_size: Array  # largest of the two parts <p, X> and F over the stages, no less than what is rounding in them
    momenta: dict[str, Array]
    body: dict[str, Array]
    spatial: dict[str, Array]
    violations: dict[str, Array]  # of the manifold's equations, largest over the nodes
    brackets: dict[str, Array]  # {J_i, H} of every momentum, relative to its parts: largest over three stages
    normal: Array  # normal part of the dynamics, relative to 1 + its size, largest over the stages


def diagnose(stage: ControlStage, unknowns: Any, nodes: Ambient, costates: Ambient) -> Diagnostics:
    """Diagnostics of a trajectory from the stages' unknowns and the states and costates at the nodes."""

    def at_stage(y: Any, p0: Ambient, p1: Ambient) -> tuple[Ambient, Array, Array, Array]:
        x, u = y
        _, v = stage.tangent(y)
        _, pull = vec.pullback(lambda w: stage.discretization(x, w), v)
        covector = stage.manifold.projection(x, pull((vec.scale(-1.0, p0), p1))[0])
        normal, speed = stage.problem.normal_size(x, u)
        power, rate = vec.pairing(covector, stage.problem.velocity(x, u)), stage.problem.cost_rate(x, u)
        size = jnp.maximum(jnp.abs(power), jnp.abs(rate))
        return covector, power - rate, size, normal / (1 + speed)

    before, after = (jax.tree.map(lambda leaf, s=s: leaf[s], costates) for s in (slice(None, -1), slice(1, None)))
    stage_costates, hamiltonians, sizes, normal = jax.vmap(at_stage)(unknowns, before, after)
    sample = np.array([0, len(hamiltonians) // 2, len(hamiltonians) - 1])
    looked_at = jax.tree.map(lambda leaf: leaf[sample], (unknowns, stage_costates))
    brackets = jax.tree.map(lambda b: jnp.max(b, axis=0), jax.vmap(lambda y, p: _brackets(stage.problem, y, p))(*looked_at))
    rounding = jax.vmap(lambda y, p: _rounding(stage, y, p))(*looked_at)
    frames = jax.vmap(lambda q, p: _group_frames(stage.manifold, q, p))(nodes, costates)
    violations = jax.tree.map(jnp.max, jax.vmap(stage.manifold.violations)(nodes))
    size = jnp.maximum(jnp.max(sizes), jnp.max(rounding))
    return Diagnostics(stage_costates, hamiltonians, size, *frames, violations, brackets, jnp.max(normal))


def _rounding(stage: ControlStage, y: Any, p: Ambient) -> Array:
    """Size below which ``<p, X>`` and ``F`` are rounding of the terms that they are sums of.

    The terms of ``F`` show in its derivatives, by coordinates in units of their size or of 1, whichever is larger: where
    ``F = (q + u)^2 / 2`` is zero, the second ones are not.
    """
    frame, sizes = stage.frame(y), stage.sizes(y)

    def rate(d: Array) -> Array:
        return stage.problem.cost_rate(*stage.move(y, frame, sizes * d))

    rest = jnp.zeros_like(sizes)
    terms = vec.pairing(*jax.tree.map(jnp.abs, (p, stage.problem.velocity(*y))))
    terms += sum(jnp.sum(jnp.abs(values)) for values in (rate(rest), jax.grad(rate)(rest), jax.hessian(rate)(rest)))
    return ROUNDING * jnp.finfo(sizes.dtype).eps * terms


def _brackets(problem: OptimalControlProblem, y: Any, p: Ambient) -> dict[str, Array]:
    """Poisson brackets ``{J_i, H} = <dH/dq, xi_i> - D_q J_i[X]`` of the momenta of every factor, relative to their parts.

    They vanish where the action leaves the Hamiltonian as it is: then the momentum is conserved.
    """
    x, u = y
    slope = vec.gradient(lambda q: problem.hamiltonian(q, p, u), x)
    parts = [homogeneous_factors(problem.manifold, part) for part in (x, p, slope, problem.velocity(x, u))]
    out = {}
    for (name, factor, q), (_, _, covector), (_, _, force), (_, _, v) in zip(*parts, strict=True):
        generators = factor.generators(q)
        turned = vec.components(generators, force)
        moved = jax.jvp(lambda z, f=factor, c=covector: f.momentum(z, c), (q,), (v,))[1]
        size = vec.components(*jax.tree.map(jnp.abs, (generators, force))) + jnp.abs(moved)
        out[name] = jnp.abs(turned - moved) / positive(jnp.max(size))
    return out


def _group_frames(manifold: Manifold, q: Ambient, p: Ambient) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Momenta of every factor on which a group acts; body and spatial covectors of the matrix groups among them."""
    momenta, body, spatial = {}, {}, {}
    points, covectors = homogeneous_factors(manifold, q), homogeneous_factors(manifold, p)
    for (name, factor, x), (_, _, covector) in zip(points, covectors, strict=True):
        momenta[name] = factor.momentum(x, covector)
        if isinstance(factor, MatrixLieGroup):
            body[name], spatial[name] = factor.body(x, covector), factor.spatial(x, covector)
    return momenta, body, spatial
