"""Singular optimal control problems, and a few that are not, with the known outcome of the integrability algorithm.

``SINGULAR`` names functions that make them: ``SINGULAR["aly-chan"]()``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array

from ..integrators import OptimalControlProblem
from ..manifolds import SO, Euclidean, Sphere, hat

PAPER = (
    "M. Barbero-Linan, D. Martin de Diego, Presymplectic integrators for optimal control problems via retraction maps, "
    "section 5.1"
)
ALY_CHAN = (
    "G. M. Aly, W. C. Chan, Application of a modified quasilinearization technique to totally singular optimal control "
    "problems, International Journal of Control 17(4), 1973, 809-815"
)
DELGADO_IBORT = (
    "in the manner of the examples of arbitrary index in M. Delgado-Tellez, A. Ibort, A numerical algorithm for "
    "singular optimal LQ control systems, Numerical Algorithms 51, 2009, 477-500, arXiv:1203.2194"
)
KRAUS = "after M. Kraus, Projected variational integrators for degenerate Lagrangian systems, 2017, arXiv:1708.07356"
BROWN = (
    "after J. D. Brown, Singular Lagrangians, constrained Hamiltonian systems and gauge invariance: an example of the "
    "Dirac-Bergmann algorithm, Universe 8(3), 2022, 171, arXiv:2201.06558"
)
OWN = "this library"


@dataclass(frozen=True)
class KnownClassification:
    """A problem with its source and the known facts about its final manifold ``P_f``.

    Attributes
    ----------
    problem : OptimalControlProblem
        The problem.
    source : str
        The publication.
    levels : tuple of int
        The levels at which ``S`` and ``P`` stop changing.
    dimension, rank, gauge : int
        The dimension of ``P_f``, the rank of its form, the number of gauge controls; zero if it is empty.
    empty_at : int or None
        The level that shows that ``P_f`` is empty.
    regular_equations : bool
        Whether the differentials of the equations are independent on their zero set.
    """

    problem: OptimalControlProblem
    source: str
    levels: tuple[int, int] = (0, 0)
    dimension: int = 0
    rank: int = 0
    gauge: int = 0
    empty_at: int | None = None
    regular_equations: bool = True


def academic() -> KnownClassification:
    """``x' = sin x + u1``, ``y' = y``, cost ``(x^2 + y^2 + u1^2)/2 + x u1 + y u2``: ``P_f = {y = 0}``, ``u1 = p_x - "
    "x``."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([jnp.sin(q[0]) + u[0], q[1]])

    problem = OptimalControlProblem(Euclidean(2), dynamics, lambda q, u: q @ q / 2 + q @ u + u[0] ** 2 / 2, 2)
    return KnownClassification(problem, PAPER, (0, 0), dimension=3, rank=2, gauge=1)


def integrator_chain(n: int) -> KnownClassification:
    """``x1' = x2, ..., xn' = u``, cost ``x1^2/2``: ``P_f = {0}`` after ``2n`` levels."""
    problem = OptimalControlProblem(
        Euclidean(n), lambda q, u: jnp.concatenate([q[1:], u]), lambda q, u: q[0] ** 2 / 2, 1
    )
    return KnownClassification(problem, DELGADO_IBORT, (2 * n, 2 * n - 1))


def aly_chan() -> KnownClassification:
    """``x1' = x2``, ``x2' = u``, cost ``(x2^2 - x1^2)/2``: ``P_f = {p2 = 0, p1 = x2}``, symplectic, ``u = -x1``."""
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: (q[1] ** 2 - q[0] ** 2) / 2, 1
    )
    return KnownClassification(problem, ALY_CHAN, (2, 1), dimension=2, rank=2)


def aly_chan_mayer() -> KnownClassification:
    """``aly_chan`` with ``x3' = (x2^2 - x1^2)/2`` and the terminal cost ``x3``: Pontryagin's principle excludes ``p =
    0``."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([q[1], u[0], (q[1] ** 2 - q[0] ** 2) / 2])

    problem = OptimalControlProblem(Euclidean(3), dynamics, lambda q, u: jnp.zeros(()), 1, terminal_cost=lambda q: q[2])
    return KnownClassification(problem, ALY_CHAN, (2, 1), dimension=4, rank=4)


def linear_cost() -> KnownClassification:
    """``x' = u``, cost ``x``: ``p = 0`` and ``p' = 1`` contradict each other."""
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: q[0], 1)
    return KnownClassification(problem, OWN, empty_at=1)


def unpaid_control() -> KnownClassification:
    """``x' = x``, cost ``(1 + x^2) u``: the control is in the cost alone, and ``dH/du`` vanishes nowhere."""
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: q, lambda q, u: (1 + q[0] ** 2) * u[0], 1)
    return KnownClassification(problem, OWN, empty_at=0)


def gauge() -> KnownClassification:
    """``H = p1 x2 + p2 u``: ``P_f = {p = 0}`` with zero form, two first-class equations and one gauge control.

    Both the primary and the secondary equation generate gauge transformations, as Dirac conjectured of all systems.
    """
    problem = OptimalControlProblem(Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: jnp.zeros(()), 1)
    return KnownClassification(problem, OWN, (1, 1), 2, 0, 1)


def massless_particle() -> KnownClassification:
    """``q' = u`` in the plane, cost ``<A(q), u> - x^2/2 - y^2``: ``P_f = {p = A(q)}``, a charged particle without "
    "mass."""

    def potential(q: Array) -> Array:
        return (1 + q @ q) / 2 * jnp.stack([-q[1], q[0]])

    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: u, lambda q, u: potential(q) @ u - q[0] ** 2 / 2 - q[1] ** 2, 2
    )
    return KnownClassification(problem, KRAUS, (1, 0), dimension=2, rank=2)


def brown() -> KnownClassification:
    """``q' = v`` in R^4, cost a Lagrangian: two primary and two secondary equations, two first and two second class."""

    def lagrangian(q: Array, v: Array) -> Array:
        kinetic = (q[0] + v[1] + v[2]) ** 2 + (v[3] - v[1]) ** 2
        return (kinetic + (q[0] + 2 * q[1]) * (q[0] + 2 * q[3])) / 2

    problem = OptimalControlProblem(Euclidean(4), lambda q, v: v, lagrangian, 4)
    return KnownClassification(problem, BROWN, (2, 1), dimension=4, rank=2, gauge=1)


def curved_arc() -> KnownClassification:
    """A control-affine problem in R^3 whose ``P_f``, symplectic of dimension 4, is not an affine subspace."""

    def dynamics(q: Array, u: Array) -> Array:
        drift = jnp.stack([0.2 * q[1], -q[2] + 0.3 * q[0] ** 2, q[1] + 0.2 * q[0] * q[2]])
        return drift + u[0] * jnp.stack([jnp.ones(()), 0.6 * q[0], 0.4 * q[1]])

    def cost(q: Array, u: Array) -> Array:
        square = q[0] ** 2 / 2 + q[0] ** 4 / 8 + q[1] ** 2 / 2 + 0.4 * q[2] ** 2
        return square + 0.1 * q[0] * q[1] * q[2]

    return KnownClassification(OptimalControlProblem(Euclidean(3), dynamics, cost, 1), OWN, (2, 1), 4, 4)


def sphere() -> KnownClassification:
    """On S^2, ``q' = f0(q) + u e3 x q``: a symplectic ``P_f`` of dimension 2."""
    manifold = Sphere(2)

    def dynamics(q: Array, u: Array) -> Array:
        drift = manifold.projection(q, jnp.stack([0.1 * q[2], 0.15 * q[0] * q[1], q[1] + 0.1 * q[0]]))
        return drift + u[0] * jnp.stack([-q[1], q[0], jnp.zeros(())])

    def cost(q: Array, u: Array) -> Array:
        return 2 * q[0] - 2 * q[2] ** 2 + 0.2 * q[0] * q[2] + 0.1 * q[1]

    return KnownClassification(OptimalControlProblem(manifold, dynamics, cost, 1), OWN, (2, 1), 2, 2)


def free_actuator() -> KnownClassification:
    """A rigid body on SO(3) x R^3 with two torques that cost and one that does not: ``P_f`` symplectic of dimension "
    "10."""
    inertia = (1.0, 1.7, 2.3)

    def dynamics(q: tuple[Array, Array], u: Array) -> tuple[Array, Array]:
        attitude, rate = q
        j = jnp.array(inertia)
        return attitude @ hat(rate), (u - jnp.cross(rate, j * rate)) / j

    def cost(q: tuple[Array, Array], u: Array) -> Array:
        return u[:2] @ u[:2] / 2 + q[1] @ q[1]

    problem = OptimalControlProblem(SO(3) * Euclidean(3), dynamics, cost, 3)
    return KnownClassification(problem, OWN, (2, 1), dimension=10, rank=10)


def regular() -> KnownClassification:
    """Double integrator with cost ``u^2/2 + x1^2/2``: regular, ``P_f = T*Q``."""
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: u[0] ** 2 / 2 + q[0] ** 2 / 2, 1
    )
    return KnownClassification(problem, OWN, (0, 0), dimension=4, rank=4)


def dummy_control() -> KnownClassification:
    """``x' = u1``, cost ``u1^2/2``, and a second control that does nothing: not a Morse family."""
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: u[:1], lambda q, u: u[0] ** 2 / 2, 2)
    return KnownClassification(problem, OWN, (0, 0), dimension=2, rank=2, gauge=1)


def irregular() -> KnownClassification:
    """``x' = x``, cost ``x^2 u``: ``dH/du = -x^2`` vanishes with its differential, so no rank can be read from it."""
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: q, lambda q, u: q[0] ** 2 * u[0], 1)
    return KnownClassification(problem, OWN, (0, 0), dimension=1, rank=0, gauge=1, regular_equations=False)


# Functions that make singular problems with known answers, by name.
SINGULAR: dict[str, Callable[[], KnownClassification]] = {
    "academic": academic,
    "chain of 2": lambda: integrator_chain(2),
    "chain of 3": lambda: integrator_chain(3),
    "chain of 4": lambda: integrator_chain(4),
    "aly-chan": aly_chan,
    "aly-chan, Mayer": aly_chan_mayer,
    "linear cost": linear_cost,
    "unpaid control": unpaid_control,
    "gauge": gauge,
    "massless particle": massless_particle,
    "brown": brown,
    "curved arc": curved_arc,
    "sphere": sphere,
    "free actuator": free_actuator,
    "regular": regular,
    "dummy control": dummy_control,
    "irregular": irregular,
}
