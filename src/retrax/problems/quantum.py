"""Gates and transfers of quantum systems with a drift."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..integrators import OptimalControlProblem
from ..manifolds import SU, Sphere
from ..retractions import Gauss, Restored
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
        source="J.-S. Li, N. Khaneja, Ensemble control of Bloch equations, IEEE Trans. Autom. Control 54, 2009, 528-536",
        optimum=1.833712717,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
    )


@known
def cnot_gate() -> KnownProblem:
    """CNOT on two coupled qubits, by fields along x and y on both."""
    group = SU(4)
    drift = np.pi / 2 * np.kron(Z, Z)
    fields = np.stack([np.kron(X, ONE), np.kron(Y, ONE), np.kron(ONE, X), np.kron(ONE, Y)]) / 2
    gate = np.exp(0.25j * np.pi) * np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]])

    def dynamics(q: Array, u: Array) -> Array:
        return -1j * (drift + sum(u[k] * fields[k] for k in range(4))) @ q

    return KnownProblem(
        name="cnot-gate",
        title="CNOT on two coupled qubits by local fields, SU(4)",
        problem=OptimalControlProblem(group, dynamics, energy, 4),
        start=np.eye(4, dtype=complex),
        end=gate,
        horizon=2.0,
        method=Gauss(3, Restored(group)),
        states={"U": "propagator"},
        controls={"u1, u2": "field on qubit 1 along x and y", "u3, u4": "on qubit 2"},
        time="1 / J",
        source="T. Schulte-Herbrueggen, A. Spoerl, N. Khaneja, S. J. Glaser, Optimal control-based efficient "
        "synthesis of building blocks "
        "of quantum algorithms, Phys. Rev. A 72, 2005, 042331",
        optimum=float("nan"),
        digits=0,
        origin="",
    )
