"""Problems with scaled data, so that one compiled kernel serves all scales, and their classifications."""

from functools import lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array
from retrax.integrators import Classification, OptimalControlProblem, classify
from retrax.manifolds import Euclidean
from retrax.manifolds.numerics import ambient as vec
from retrax.problems import SINGULAR, KnownClassification

ONE = (1.0, 1.0, 1.0)


class Scaled(eqx.Module):
    """``factor * function(q, control * u)`` with numbers that are data, not code."""

    function: Any
    factor: Array
    control: Array

    def __call__(self, q: Any, u: Any) -> Any:
        return vec.scale(self.factor, self.function(q, vec.scale(self.control, u)))


@lru_cache
def known(name: str) -> KnownClassification:
    return SINGULAR[name]()


def scaled(problem: OptimalControlProblem, factors: tuple[float, float, float]) -> OptimalControlProblem:
    """The problem whose dynamics, cost and controls are multiplied by three factors."""
    dynamics, cost, control = (jnp.asarray(factor) for factor in factors)
    return OptimalControlProblem(
        problem.manifold,
        Scaled(problem.dynamics, dynamics, control),
        Scaled(problem.running_cost, cost, control),
        problem.controls,
        problem.terminal_cost,
    )


class Martinet(eqx.Module):
    """``u1 X1 + u2 X2`` of the Martinet distribution, in a flat metric or in a bent one."""

    bend: Array

    def __call__(self, q: Array, u: Array) -> Array:
        along = u[1] / (1 + self.bend * q[0])
        return jnp.stack([u[0], along, along * q[0] ** 2 / 2])


def martinet(bend: float) -> OptimalControlProblem:
    """Its abnormal extremals: curves at rest, lines along d/dy in x = 0, and both at once where these pieces cross."""
    return OptimalControlProblem(Euclidean(3), Martinet(jnp.asarray(bend)), lambda q, u: u @ u / 2, 2, abnormal=True)


@lru_cache
def classified(name: str, factors: tuple[float, float, float] = ONE, seed: int = 0) -> Classification:
    """The classification of a known problem multiplied by three factors."""
    return classify(scaled(known(name).problem, factors), seed=seed)
