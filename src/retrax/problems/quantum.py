"""Gates and transfers of quantum systems with a drift."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..integrators import OptimalControlProblem
from ..manifolds import SU, Sphere
from .geodesics import energy
from .record import KnownProblem, known

X, Y, Z = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
ONE = np.eye(2)


@known
def hadamard_gate() -> KnownProblem:
    """Hadamard's gate of a qubit that precesses about z, by a field along x."""
    group = SU(2)

    def dynamics(q: Array, u: Array) -> Array:
        return -0.5j * (Z + u[0] * X) @ q

    return KnownProblem(
        name="hadamard-gate",
        title="Hadamard's gate of a precessing qubit by one field, SU(2)",
        problem=OptimalControlProblem(group, dynamics, energy, 1),
        start=np.eye(2, dtype=complex),
        end=-1j * (X + Z) / np.sqrt(2),
        horizon=4.0,
        states={"U": "propagator"},
        controls={"u": "field along x over the one along z"},
        time="Larmor period / 2 pi",
        source="D. D'Alessandro, M. Dahleh, Optimal control of two-level quantum systems, IEEE Trans. Autom. Control "
        "46, 2001, 866-876",
        optimum=1.593691546,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
    )


@known
def two_spins() -> KnownProblem:
    """Two spins of different frequency are inverted by one pulse."""
    offset, sphere = 1.0, Sphere(2)

    def turned(q: Array, u: Array, detuning: float) -> Array:
        return jnp.cross(jnp.stack([u[0], u[1], detuning + 0 * u[0]]), q)

    def dynamics(q: tuple[Array, Array], u: Array) -> tuple[Array, Array]:
        return turned(q[0], u, 0.0), turned(q[1], u, offset)

    up = np.array([0.0, 0.0, 1.0])
    return KnownProblem(
        name="two-spins",
        title="two spins of different frequency are inverted by one pulse, S^2 x S^2",
        problem=OptimalControlProblem(sphere * sphere, dynamics, energy, 2),
        start=(up, up),
        end=(-up, -up),
        horizon=6.0,
        steps=30,
        states={"m1": "magnetisation on resonance", "m2": "magnetisation off resonance"},
        controls={"u": "field in the rotating frame over the offset"},
        time="1 / offset",
        source="J.-S. Li, N. Khaneja, Ensemble control of Bloch equations, IEEE Trans. Autom. Control 54, 2009, "
        "528-536",
        optimum=1.833712717,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
    )
