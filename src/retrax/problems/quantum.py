"""Gates and transfers of quantum systems with a drift."""

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array

from ..integrators import OptimalControlProblem
from ..manifolds import SU, Sphere
from ..retractions import Cayley, Gauss
from .geodesics import energy
from .record import KnownProblem, register

X, Y, Z = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
ONE = np.eye(2)


@register
def hadamard_gate() -> KnownProblem:
    """Hadamard's gate of a qubit that precesses about z, by a field along x."""
    group = SU(2)

    def dynamics(q: Array, u: Array) -> Array:
        return -0.5j * (Z + u[0] * X) @ q

    return KnownProblem(
        name="hadamard-gate",
        title="Hadamard's gate of a precessing qubit by one field, SU(2)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u^2\,dt",
            r"\dot U = -\tfrac{i}{2}\,(Z + u X)\,U, \quad U \in SU(2)",
        ),
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


@register
def two_spins() -> KnownProblem:
    """Two spins of different frequency are inverted by one pulse."""
    offset, sphere = 1.0, Sphere(2)

    def rotate(q: Array, u: Array, detuning: float) -> Array:
        return jnp.cross(jnp.stack([u[0], u[1], detuning + 0 * u[0]]), q)

    def dynamics(q: tuple[Array, Array], u: Array) -> tuple[Array, Array]:
        return rotate(q[0], u, 0.0), rotate(q[1], u, offset)

    up = np.array([0.0, 0.0, 1.0])
    return KnownProblem(
        name="two-spins",
        title="two spins of different frequency are inverted by one pulse, S^2 x S^2",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot m_1 = (u_1, u_2, 0) \times m_1, \quad \dot m_2 = (u_1, u_2, 1) \times m_2, \quad m_1, m_2 \in S^2",
        ),
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


@register
def two_qubit_gate() -> KnownProblem:
    """A gate of two qubits by the nine couplings of their spins, without fields on either, with least energy.

    The couplings ``p`` and the fields ``k`` are a Cartan decomposition of su(4): ``[p, p]`` and ``[k, k]`` are in
    ``k``, ``[k, p]`` in ``p``. The costate ``M``, with ``M' = [u, M]``, has ``u`` for its part in ``p``; so its part in
    ``k`` is a constant ``K``, and ``u = exp(-t K) P exp(t K)``. Extremals are ``U = exp(-t K) exp(t (K + P))``, with
    the cost ``|P|^2 / 2`` in the time 1, and the shortest curve is one of them, as ``p`` and its commutators span
    su(4). The gate is where the one with ``P = 3 XX + 2 YY + ZZ`` and ``K = Y1 + 2 Z1 + X2 - Z2`` ends, in units of
    ``-i/2``; the next extremal to it has the cost 9.675.
    """
    group = SU(4)
    couplings = -0.5j * np.array([np.kron(a, b) for a in (X, Y, Z) for b in (X, Y, Z)])
    shape = np.tensordot([3.0, 2.0, 1.0], couplings[::4], 1)
    fields = -0.5j * (np.kron(Y + 2 * Z, ONE) + np.kron(ONE, X - Z))
    return KnownProblem(
        name="two-qubit-gate",
        title="a gate of two qubits by all couplings of their spins, SU(4)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \sum_{ij} u_{ij}^2\,dt",
            r"\dot U = -\tfrac{i}{2} \sum_{ij} u_{ij}\,(\sigma_i \otimes \sigma_j)\,U, \quad U \in SU(4)",
        ),
        problem=OptimalControlProblem(group, lambda q, u: jnp.tensordot(u, couplings, 1) @ q, energy, 9),
        start=np.eye(4, dtype=complex),
        end=scipy.linalg.expm(-fields) @ scipy.linalg.expm(fields + shape),
        horizon=1.0,
        method=Gauss(3, Cayley(group)),
        states={"U": "propagator"},
        controls={
            "u_ij": "coupling of axis i of the first spin to axis j of the second, rad over the time of the gate"
        },
        time="time of the gate",
        source="N. Khaneja, R. Brockett, S. J. Glaser, Time optimal control in spin systems, Phys. Rev. A 63, 2001, "
        "032308; U. Boscain, T. Chambrion, J.-P. Gauthier, On the K+P problem for a three-level quantum system: "
        "optimality implies resonance, J. Dyn. Control Syst. 8, 2002, 547-572",
        optimum=7.0,
        digits=12,
        origin="closed form; the least of all extremals that least squares find from 600 starts",
        formula=r"\frac{\lvert P\rvert^2}{2T}",
    )
