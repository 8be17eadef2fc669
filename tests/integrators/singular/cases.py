"""Problems with scaled data, so that one compiled kernel serves all scales, and their classifications."""

from functools import lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array
from retrax.integrators import Classification, OptimalControlProblem, classify
from retrax.manifolds.numerics import ambient as vec
from retrax.problems import SINGULAR, KnownClassification

ONE = (1.0, 1.0)


class Scaled(eqx.Module):
    """A function of ``(q, u)`` times a number that is data, not code."""

    function: Any
    factor: Array

    def __call__(self, q: Any, u: Any) -> Any:
        return vec.scale(self.factor, self.function(q, u))


@lru_cache
def known(name: str) -> KnownClassification:
    return SINGULAR[name]()


@lru_cache
def classified(name: str, factors: tuple[float, float] = ONE, seed: int = 0) -> Classification:
    """The classification of a problem whose dynamics and cost are multiplied by two factors."""
    problem = known(name).problem
    dynamics, cost = (jnp.asarray(factor) for factor in factors)
    scaled = OptimalControlProblem(
        problem.manifold,
        Scaled(problem.dynamics, dynamics),
        Scaled(problem.running_cost, cost),
        problem.controls,
        problem.terminal_cost,
    )
    return classify(scaled, seed=seed)
