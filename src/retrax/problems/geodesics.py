"""Curves of least energy: geodesics, cubics on groups, sub-Riemannian geodesics, and regulators with a formula."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.spatial.transform import Rotation

from ..integrators import OptimalControlProblem
from ..manifolds import SE, SO, SU, Euclidean, Sphere, hat
from ..retractions import Cayley, Gauss
from .record import KnownProblem, register

AGRACHEV = "A. Agrachev, D. Barilari, U. Boscain, A Comprehensive Introduction to Sub-Riemannian Geometry, 2019"
IDENTITY = np.eye(3)
AXIS = np.array([2.0, -1.0, 2.0]) / 3


def energy(_: Any, u: Array) -> Array:
    """``|u|^2 / 2``."""
    return u @ u / 2


def time(_: Any, __: Array) -> float:
    """The running cost 1: least time."""
    return 1.0


def circling(turns: float, size: float) -> Any:
    """Controls that turn ``turns`` times: on a guess at rest a system without drift can be steered nowhere new."""

    def controls(s: np.ndarray) -> np.ndarray:
        angle = 2 * np.pi * turns * s
        return size * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    return controls


@register
def kinematic_slew() -> KnownProblem:
    """A rotation with its angular velocity as control."""
    angle = 2.5
    return KnownProblem(
        name="kinematic-slew",
        title="a turn by 2.5 rad, its angular velocity as control",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert w\rvert^2\,dt",
            r"\dot R = R\,\hat w, \quad R \in SO(3)",
        ),
        problem=OptimalControlProblem(SO(3), lambda q, u: q @ hat(u), energy, 3),
        start=IDENTITY,
        end=Rotation.from_rotvec(angle * AXIS).as_matrix(),
        horizon=1.0,
        method=Gauss(3, Cayley(SO(3))),
        states={"R": "attitude, body to inertial frame"},
        controls={"w": "angular velocity, body frame"},
        source="geodesics of a bi-invariant metric, J. Milnor, Curvatures of left invariant metrics, 1976",
        optimum=angle**2 / 2,
        digits=12,
        origin="closed form",
        formula=r"\frac{a^2}{2T}",
    )


@register
def sphere_geodesic() -> KnownProblem:
    """Part of a great circle."""
    angle, sphere = 2.0, Sphere(2)
    return KnownProblem(
        name="sphere-geodesic",
        title="a great circle, 2 rad of it",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot q = (I - q q^{\mathsf T})\,u, \quad q \in S^2",
        ),
        problem=OptimalControlProblem(sphere, lambda q, u: sphere.projection(q, u), energy, 3),
        start=np.array([0.0, 0.0, 1.0]),
        end=np.array([np.sin(angle) * 0.6, np.sin(angle) * 0.8, np.cos(angle)]),
        horizon=1.0,
        states={"q": "point of S^2"},
        controls={"u": "velocity, its normal part costs and does nothing"},
        source="M. do Carmo, Riemannian Geometry, 1992, chapter 3",
        optimum=angle**2 / 2,
        digits=12,
        origin="closed form",
        formula=r"\frac{a^2}{2T}",
    )


@register
def rotation_geodesic() -> KnownProblem:
    """A rotation of 4-space in two planes at once."""
    group, (a, b) = SO(4), (1.2, 0.5)
    turn = np.zeros((4, 4))
    turn[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    turn[2:, 2:] = [[np.cos(b), -np.sin(b)], [np.sin(b), np.cos(b)]]
    return KnownProblem(
        name="rotation-geodesic",
        title="a rotation of R^4 by 1.2 and 0.5 rad in two planes",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert w\rvert^2\,dt",
            r"\dot R = R\,\hat w, \quad R \in SO(4), \quad w \in \mathbb R^6",
        ),
        problem=OptimalControlProblem(group, lambda q, u: q @ group.hat(u), energy, 6),
        start=np.eye(4),
        end=turn,
        horizon=1.0,
        method=Gauss(3, Cayley(group)),
        states={"R": "rotation"},
        controls={"w": "coordinates of R^T R' in so(4)"},
        source="J. Milnor, Curvatures of left invariant metrics, 1976",
        optimum=(a**2 + b**2) / 2,
        digits=12,
        origin="closed form",
        formula=r"\frac{\lVert\log R\rVert_F^2}{4T}",
    )


@register
def half_plane_geodesic() -> KnownProblem:
    """A geodesic of the hyperbolic plane, in the coordinates of the upper half-plane."""
    (x0, y0), (x1, y1) = (0.0, 1.0), (2.0, 0.5)
    distance = np.arccosh(1 + ((x1 - x0) ** 2 + (y1 - y0) ** 2) / (2 * y0 * y1))
    return KnownProblem(
        name="half-plane-geodesic",
        title="a geodesic of Poincare's half-plane",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot x = y\,u_1, \quad \dot y = y\,u_2",
        ),
        problem=OptimalControlProblem(Euclidean(2), lambda q, u: q[1] * u, energy, 2),
        start=np.array([x0, y0]),
        end=np.array([x1, y1]),
        horizon=1.0,
        states={"x": "along the edge", "y": "above the edge"},
        controls={"u1": "velocity along x over y", "u2": "velocity along y over y"},
        source="M. do Carmo, Riemannian Geometry, 1992, chapter 8",
        optimum=float(distance**2 / 2),
        digits=12,
        origin="closed form",
        formula=r"\frac{1}{2T}\,\operatorname{arcosh}^2\Bigl(1 + \frac{\lvert q_1 - q_0\rvert^2}{2 y_0 y_1}\Bigr)",
    )


@register
def rotation_cubic() -> KnownProblem:
    """From rest to rest with the angular acceleration as control."""
    angle, space = 2.0, SO(3) * Euclidean(3)
    return KnownProblem(
        name="rotation-cubic",
        title="a turn by 2 rad from rest to rest, its angular acceleration as control",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot R = R\,\hat w, \quad \dot w = u, \quad R \in SO(3)",
        ),
        problem=OptimalControlProblem(space, lambda q, u: (q[0] @ hat(q[1]), u), energy, 3),
        start=(IDENTITY, np.zeros(3)),
        end=(Rotation.from_rotvec(angle * AXIS).as_matrix(), np.zeros(3)),
        horizon=1.0,
        method=Gauss(3, Cayley(space)),
        states={"R": "attitude, body to inertial frame", "w": "angular velocity, body frame"},
        controls={"u": "angular acceleration, body frame"},
        source="L. Noakes, G. Heinzinger, B. Paden, Cubic splines on curved spaces, IMA J. Math. Control Inform. 6, "
        "1989, 465-473",
        optimum=6 * angle**2,
        digits=12,
        origin="closed form: about the fixed axis the angle is a cubic",
        formula=r"\frac{6 a^2}{T^3}",
    )


@register
def sub_riemannian_rotations() -> KnownProblem:
    """A turn about the third axis with angular velocities about the first two."""
    turn = 1.0
    controls = circling(1.0 - turn / (2 * np.pi), np.sqrt(turn * (4 * np.pi - turn)))

    def path(s: np.ndarray) -> tuple[Any, Any]:
        return Rotation.from_rotvec(np.outer(turn * s, [0, 0, 1])).as_matrix(), controls(s)

    return KnownProblem(
        name="sub-riemannian-rotations",
        title="a turn by 1 rad about the axis that has no control",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T w_1^2 + w_2^2\,dt",
            r"\dot R = R\,\widehat{(w_1, w_2, 0)}, \quad R \in SO(3)",
        ),
        problem=OptimalControlProblem(SO(3), lambda q, u: q @ hat(jnp.stack([u[0], u[1], 0 * u[0]])), energy, 2),
        start=IDENTITY,
        end=Rotation.from_rotvec([0, 0, turn]).as_matrix(),
        horizon=1.0,
        method=Gauss(3, Cayley(SO(3))),
        path=path,
        states={"R": "attitude, body to inertial frame"},
        controls={"w1": "angular velocity about body axis 1", "w2": "about body axis 2"},
        source="U. Boscain, F. Rossi, Invariant Carnot-Caratheodory metrics on S^3, SO(3), SL(2), and lens spaces, "
        "SIAM J. Control Optim. 47, 2008, 1851-1878",
        optimum=turn * (4 * np.pi - turn) / 2,
        digits=12,
        origin="closed form",
        formula=r"\frac{\varphi\,(4\pi - \varphi)}{2T}",
    )


@register
def heisenberg() -> KnownProblem:
    """Brockett's integrator: the isoperimetric problem."""
    space = Euclidean(3)

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([u[0], u[1], (q[0] * u[1] - q[1] * u[0]) / 2])

    return KnownProblem(
        name="heisenberg",
        title="Brockett's integrator: a closed plane curve around the area 1",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot x = u_1, \quad \dot y = u_2, \quad \dot z = \tfrac12 (x u_2 - y u_1)",
        ),
        problem=OptimalControlProblem(space, dynamics, energy, 2),
        start=np.zeros(3),
        end=np.array([0.0, 0.0, 1.0]),
        horizon=1.0,
        states={"x": "in the plane", "y": "in the plane", "z": "area"},
        controls={"u1": "velocity along x", "u2": "velocity along y"},
        source="R. W. Brockett, Control theory and singular Riemannian geometry, New Directions in Applied "
        "Mathematics, 1982, 11-27",
        optimum=2 * np.pi,
        digits=12,
        origin=r"closed form: a circle of length $2 \sqrt{\pi z}$",
        formula=r"\frac{2\pi z}{T}",
    )


@register
def grushin() -> KnownProblem:
    """Along the line on which one of the two controls does nothing."""
    return KnownProblem(
        name="grushin",
        title="along the singular line of Grushin's plane",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot x = u_1, \quad \dot y = x\,u_2",
        ),
        problem=OptimalControlProblem(Euclidean(2), lambda q, u: jnp.stack([u[0], q[0] * u[1]]), energy, 2),
        start=np.zeros(2),
        end=np.array([0.0, 1.0]),
        horizon=1.0,
        path=lambda s: (np.stack([np.sin(np.pi * s) / 2, s], axis=1), np.ones((len(s), 2))),
        states={"x": "1", "y": "1"},
        controls={"u1": "velocity along x", "u2": "velocity along y over x"},
        source=f"{AGRACHEV}, section 9.4.1",
        optimum=np.pi,
        digits=12,
        origin=r"closed form: $x = \sqrt{2y / \pi}\,\sin \pi t$",
        formula=r"\frac{\pi y}{T}",
    )


@register
def three_levels() -> KnownProblem:
    """Population of the third level from the first by way of the second, which two laser fields join to both."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([-u[0] * q[1], u[0] * q[0] - u[1] * q[2], u[1] * q[1]])

    return KnownProblem(
        name="three-levels",
        title="transfer between the outer levels of three, real amplitudes on S^2",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot c_1 = -u_1 c_2, \quad \dot c_2 = u_1 c_1 - u_2 c_3, \quad \dot c_3 = u_2 c_2, \quad c \in S^2",
        ),
        problem=OptimalControlProblem(Sphere(2), dynamics, energy, 2),
        start=np.array([1.0, 0.0, 0.0]),
        end=np.array([0.0, 0.0, 1.0]),
        horizon=1.0,
        states={"c1, c2, c3": "amplitudes of the levels"},
        controls={"u1": "field between levels 1 and 2", "u2": "between 2 and 3"},
        source="U. Boscain, G. Charlot, J.-P. Gauthier, S. Guerin, H.-R. Jauslin, Optimal control in laser-induced "
        "population transfer "
        "for two- and three-level quantum systems, J. Math. Phys. 43, 2002, 2107-2132",
        optimum=3 * np.pi**2 / 8,
        digits=12,
        origin="closed form",
        formula=r"\frac{3\pi^2}{8T}",
    )


@register
def phase_gate() -> KnownProblem:
    """A phase gate of one qubit by fields along x and y."""
    group, phi = SU(2), np.pi / 2
    controls = circling(1.0 - phi / (2 * np.pi), np.sqrt(phi * (4 * np.pi - phi)))

    def rotation(s: np.ndarray) -> np.ndarray:
        states = np.zeros((len(s), 2, 2), complex)
        states[:, 0, 0], states[:, 1, 1] = np.exp(-0.5j * phi * s), np.exp(0.5j * phi * s)
        return states

    return KnownProblem(
        name="phase-gate",
        title="a phase gate of one qubit, SU(2), by fields along x and y",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot U = U\,\widehat{(u_1, u_2, 0)}, \quad U \in SU(2)",
        ),
        problem=OptimalControlProblem(group, lambda q, u: q @ group.hat(jnp.stack([u[0], u[1], 0 * u[0]])), energy, 2),
        start=np.eye(2, dtype=complex),
        end=rotation(np.ones(1))[0],
        horizon=1.0,
        path=lambda s: (rotation(s), controls(s)),
        states={"U": "propagator"},
        controls={"u1": "field along x", "u2": "field along y"},
        source="U. Boscain, F. Rossi, Invariant Carnot-Caratheodory metrics on S^3, SO(3), SL(2), and lens spaces, "
        "SIAM J. Control Optim. 47, 2008, 1851-1878",
        optimum=phi * (4 * np.pi - phi) / 2,
        digits=12,
        origin="closed form",
        formula=r"\frac{\varphi\,(4\pi - \varphi)}{2T}",
    )


@register
def unicycle() -> KnownProblem:
    """Sideways with a vehicle that rolls and turns: least energy on SE(2)."""
    group = SE(2)
    return KnownProblem(
        name="unicycle",
        title="one unit sideways by rolling and turning, SE(2)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot g = g\,\widehat{(u_2, u_1, 0)} \text{ in } SE(2):",
            r"\dot x = u_1 \cos a, \quad \dot y = u_1 \sin a, \quad \dot a = u_2",
        ),
        problem=OptimalControlProblem(group, lambda q, u: q @ group.hat(jnp.stack([u[1], u[0], 0 * u[0]])), energy, 2),
        start=np.eye(3),
        end=np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
        horizon=1.0,
        method=Gauss(3, Cayley(group)),
        states={"g": "pose, body to plane, unit of length"},
        controls={"u1": "speed", "u2": "turning rate, rad"},
        source="I. Moiseev, Yu. L. Sachkov, Maxwell strata in sub-Riemannian problem on the group of motions of a "
        "plane, "
        "ESAIM: COCV 16, 2010, 380-399",
        optimum=5.579079358,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
        error=1e-8,
    )
