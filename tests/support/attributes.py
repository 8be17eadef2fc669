"""Abstract attributes as class attributes, fields with and without a default, and properties: each kind in its own
class.

Type checkers read this file as they would a user's; ``tests/test_attributes.py`` makes the objects.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from retrax.integrators import Integrator, LiftedIntegrator
from retrax.manifolds import Manifold, MatrixLieGroup, Metric, Sphere
from retrax.retractions import CotangentLift, DiscretizationMap, Midpoint, Projection, Retraction

SPHERE = Sphere(2)
RETRACTION = Projection(SPHERE)
PLANE = jax.ShapeDtypeStruct((2,), float)
NILPOTENT = np.array([[[0.0, 1.0], [0.0, 0.0]]])


class Plane(Manifold):
    """All but the attributes."""

    def projection(self, x: Array, a: Array) -> Array:
        return a

    def basis(self, x: Array) -> Array:
        return jnp.eye(2)

    def restore(self, x: Array) -> Array:
        return x

    def violations(self, x: Array) -> dict[str, Array]:
        return {"none": jnp.zeros(())}

    def random_point(self, key: Array) -> Array:
        return jax.random.normal(key, (2,))


class PlaneByAttributes(Plane):
    dimension = 2
    ambient = PLANE


class PlaneByFields(Plane):
    dimension: int = eqx.field(static=True)
    ambient: jax.ShapeDtypeStruct = eqx.field(static=True)


class PlaneByDefaults(Plane):
    dimension: int = 2
    ambient: Any = PLANE


class PlaneByProperties(Plane):
    size: int

    @property
    def dimension(self) -> int:
        return self.size

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((self.size,), float)


class LineByAttribute(MatrixLieGroup):
    algebra = NILPOTENT


class LineByProperty(MatrixLieGroup):
    @property
    def algebra(self) -> np.ndarray:
        return NILPOTENT


class Step(Retraction):
    """All but the manifold."""

    def retract(self, x: Array, v: Array) -> Array:
        return self.manifold.restore(x + v)


class StepByAttribute(Step):
    manifold = SPHERE


class StepByField(Step):
    manifold: Sphere


class StepByDefault(Step):
    manifold: Sphere = SPHERE


class StepByProperty(Step):
    kind: type[Sphere]

    @property
    def manifold(self) -> Sphere:
        return self.kind(2)


class Ends(DiscretizationMap):
    """All but where its base point sits and its retraction."""

    def __call__(self, x: Array, v: Array) -> tuple[Array, Array]:
        return self.retraction(x, -self.theta * v), self.retraction(x, (1 - self.theta) * v)


class EndsByAttributes(Ends):
    theta = 0.5
    retraction = RETRACTION


class EndsByFields(Ends):
    retraction: Retraction
    theta: float = 0.5


class EndsByProperties(Ends):
    @property
    def theta(self) -> float:
        return 0.5

    @property
    def retraction(self) -> Retraction:
        return RETRACTION


class Round(Metric):
    """All but the manifold."""

    def inner_product(self, x: Array, v: Array, w: Array) -> Array:
        return v @ w

    def kinetic_energy(self, x: Array, p: Array) -> Array:
        return p @ p / 2


class RoundByField(Round):
    manifold: Sphere


class RoundByProperty(Round):
    @property
    def manifold(self) -> Sphere:
        return SPHERE


class Rest(Integrator):
    """All but the attributes: nothing moves."""

    def check(self, system: Any, q: Array, p: Array) -> None:
        return None

    def begin(self, system: Any, q: Array, p: Array) -> None:
        return None

    def step(self, system: Any, h: Any, q: Array, p: Array, previous: None) -> Any:
        return q, p, None, jnp.array(True)

    def control(self, unknowns: None) -> None:
        return None


class RestByFields(Rest):
    manifold: Sphere
    control_times: np.ndarray


class RestByAttributes(Rest):
    manifold = SPHERE
    control_times = np.array(0.5)


class RestOfLift(LiftedIntegrator, Rest):
    lift: CotangentLift


class WithoutManifold(Rest):
    control_times = np.array(0.5)


MADE = (
    PlaneByAttributes(),
    PlaneByFields(2, PLANE),
    PlaneByDefaults(),
    PlaneByProperties(2),
    LineByAttribute(),
    LineByProperty(),
    StepByAttribute(),
    StepByField(SPHERE),
    StepByDefault(),
    StepByProperty(Sphere),
    EndsByAttributes(),
    EndsByFields(RETRACTION),
    EndsByProperties(),
    RoundByField(SPHERE),
    RoundByProperty(),
    RestByFields(SPHERE, np.array(0.5)),
    RestByAttributes(),
    RestOfLift(CotangentLift(Midpoint(RETRACTION))),
)
dimensions: list[int] = [PlaneByFields(2, PLANE).dimension, PlaneByProperties(2).dimension]
held: Sphere = StepByField(SPHERE).manifold
