"""Systems that several tests integrate or solve, and the numerics that their facts are stated with."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from retrax.integrators import OptimalControlProblem
from retrax.manifolds import SO, CotangentBundle, EmbeddedMetric, Euclidean, Manifold, Sphere, form_matrix, hat
from retrax.manifolds.numerics import ambient as vec
from scipy.spatial.transform import Rotation

from tests.support.cases import Ellipsoid
from tests.support.numerics import flat

SPHERE, SO3, ELLIPSOID = Sphere(2), SO(3), Ellipsoid()
RIGID = SO3 * Euclidean(3)
MANIFOLDS: dict[str, Manifold] = {"S2": SPHERE, "SO3": SO3, "ellipsoid": ELLIPSOID, "SO3*R3": RIGID}

INERTIA = np.array([1.0, 1.7, 2.3])
SPACECRAFT = np.array([5621.0, 4547.0, 2364.0])  # kg m^2
IDENTITY, REST = np.eye(3), np.zeros(3)


def rotation(vector: ArrayLike) -> np.ndarray:
    """The rotation by a rotation vector."""
    return Rotation.from_rotvec(np.asarray(vector, float)).as_matrix()


SLEW_END = rotation(np.deg2rad(150.0) * np.array([1.0, 2.0, -2.0]) / 3.0)


def pendulum_energy(q: Array, p: Array) -> Array:
    """Unit mass and length, gravity along -z."""
    return p @ p / 2 + q[2]


def rigid_body_energy(q: Array, p: Array) -> Array:
    """Free rigid body: ``mu . J^-1 mu / 2`` with the body momentum ``mu``."""
    mu = SO3.body(q, p)
    return mu @ (mu / INERTIA) / 2


def top_energy(q: Array, p: Array) -> Array:
    """Rigid body in a potential without symmetry."""
    return rigid_body_energy(q, p) + q[2, 2] + 0.3 * q[0, 1]


def towed_body_energy(q: tuple, p: tuple) -> Array:
    """Rigid body and a particle, coupled, in a nonlinear potential."""
    return top_energy(q[0], p[0]) + p[1] @ p[1] / 2 + q[1] @ q[0][0] + (q[1] @ q[1]) ** 2 / 4


ENERGIES = {"S2": pendulum_energy, "SO3": top_energy, "ellipsoid": pendulum_energy, "SO3*R3": towed_body_energy}


def coupled_energy(manifold: Manifold) -> Callable:
    """Motion by the metric of the ambient space under a force without symmetry, coupled with the momentum."""
    kinetic = EmbeddedMetric(manifold).kinetic_energy

    def energy(q: Any, p: Any) -> jax.Array:
        x, y = flat(q), flat(manifold.projection(q, p))
        weights = jnp.cos(jnp.arange(x.size)) / jnp.sqrt(x.size)
        return kinetic(q, p) + jnp.sin(weights @ x) + 0.3 * jnp.sin(weights @ y) * jnp.cos(x[0])

    return energy


def hamiltonian_field(bundle: CotangentBundle, energy: Any, z: tuple) -> tuple:
    """The ``X`` tangent to ``T*Q`` with ``omega(X, w) = dH(w)`` for every tangent ``w``, by linear algebra."""
    frame = bundle.basis(z)
    slope = jax.vmap(lambda w: jax.jvp(lambda s: energy(*s), (z,), (w,))[1])(frame)
    return vec.combine(frame, jnp.linalg.solve(form_matrix(bundle.two_form, z, frame).T, slope))


def at(tree: Any, index: int) -> Any:
    """One node or stage of a trajectory."""
    return jax.tree.map(lambda leaf: leaf[index], tree)


def spacecraft(q: tuple, u: Array) -> tuple:
    """Attitude and body rate under a torque: ``R' = R hat(w)``, ``J w' = u - w x J w``."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], SPACECRAFT * q[1])) / SPACECRAFT


def half_square(_: Any, u: Array) -> Array:
    """``|u|^2 / 2``."""
    return u @ u / 2


PLANE = Euclidean(2)  # position and velocity on a line


def particle(q: Array, u: Array) -> Array:
    """``x'' = u``."""
    return jnp.stack([q[1], u[0]])


def below(ceiling: float, **more: Any) -> OptimalControlProblem:
    """Bryson, Denham: from ``x = 0`` upwards and back in one second, below a ceiling at the nodes."""
    return OptimalControlProblem(
        PLANE, particle, half_square, 1, node_constraints={"ceiling": lambda q: q[0] - ceiling}, **more
    )


KINEMATIC = OptimalControlProblem(SO3, lambda q, u: q @ hat(u), half_square, 3)
SLEW = OptimalControlProblem(RIGID, spacecraft, half_square, 3)
