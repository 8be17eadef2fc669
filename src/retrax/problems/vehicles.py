"""Vehicles that roll, steer and bend: nonholonomic systems, elastica, shortest paths, winds and obstacles."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import root_scalar
from scipy.spatial.transform import Rotation

from ..integrators import Free, OptimalControlProblem
from ..manifolds import SE, SO, Euclidean, Sphere, hat
from .attitude import cayley
from .geodesics import energy
from .record import KnownProblem, register

PLANE = SE(2)
POSE = {"g": "pose, body to plane: heading and position, unit of length"}


def planar(x: float, y: float, heading: float) -> np.ndarray:
    """A pose in the plane."""
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def steer(q: Array, u: Array) -> Array:
    """Unit speed along the first body axis, turning at the rate ``u``."""
    return q @ PLANE.hat(jnp.stack([u[0], 1 + 0 * u[0], 0 * u[0]]))


@register
def elastica() -> KnownProblem:
    """Euler's elastica: a rod of length 2 from (0, 0) along x to (1, 1) along y."""
    return KnownProblem(
        name="elastica",
        title="Euler's elastica of length 2 around a corner, SE(2)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T k^2\,dt",
            r"\dot g = g\,\widehat{(k, 1, 0)} \text{ in } SE(2):",
            r"\dot x = \cos a, \quad \dot y = \sin a, \quad \dot a = k",
        ),
        problem=OptimalControlProblem(PLANE, steer, energy, 1),
        start=np.eye(3),
        end=planar(1.0, 1.0, np.pi / 2),
        horizon=2.0,
        method=cayley(PLANE),
        states=POSE,
        controls={"k": "curvature"},
        source="Yu. L. Sachkov, Maxwell strata in the Euler elastic problem, J. Dyn. Control Syst. 14, 2008, 169-234",
        optimum=2.057638392,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
    )


@register
def rod() -> KnownProblem:
    """Kirchhoff's rod: bending and torsion of a rod of length 2 between two clamps in space."""
    group, stiffness = SE(3), np.array([1.0, 1.0, 0.5])
    end = np.eye(4)
    end[:3, :3] = Rotation.from_rotvec([0.4, np.pi / 2, 0.3]).as_matrix()
    end[:3, 3] = [1.0, 0.3, 1.0]

    def dynamics(q: Array, u: Array) -> Array:
        return q @ group.hat(jnp.concatenate([u, np.array([0.0, 0.0, 1.0])]))

    return KnownProblem(
        name="rod",
        title="Kirchhoff's elastic rod of length 2 between two clamps, SE(3)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T k_1^2 + k_2^2 + \tfrac12 t^2\,ds",
            r"g' = g\,\widehat{(k_1, k_2, t;\ 0, 0, 1)}, \quad g \in SE(3)",
        ),
        problem=OptimalControlProblem(group, dynamics, lambda q, u: u @ (stiffness * u) / 2, 3),
        start=np.eye(4),
        end=end,
        horizon=2.0,
        method=cayley(group),
        states={"g": "pose of the cross-section, body to space"},
        controls={"k1": "curvature about body axis 1", "k2": "about body axis 2", "t": "torsion"},
        source="J. Biggs, W. Holderbaum, V. Jurdjevic, Singularities of optimal control problems on some 6-D Lie "
        "groups, "
        "IEEE Trans. Autom. Control 52, 2007, 1027-1038",
        optimum=1.943693359,
        digits=9,
        origin="limit of the discrete optima here as the steps shrink",
        error=1e-8,
    )


@register
def dubins() -> KnownProblem:
    """Dubins's car: turn, straight, turn."""
    return KnownProblem(
        name="dubins",
        title="Dubins's car to (4, 1), turned by 180 degrees",
        equations=(
            r"\text{minimise } T",
            r"\dot g = g\,\widehat{(k, 1, 0)} \text{ in } SE(2):",
            r"\dot x = \cos a, \quad \dot y = \sin a, \quad \dot a = k",
            r"\lvert k\rvert \le 1",
        ),
        problem=OptimalControlProblem(PLANE, steer, lambda q, u: 1.0, 1, control_bounds=(-1.0, 1.0)),
        start=np.eye(3),
        end=planar(4.0, 1.0, np.pi * 0.9),
        horizon=Free(7.0, lower=1.0),
        steps=60,
        method=cayley(PLANE),
        states=POSE,
        controls={"k": "curvature"},
        source="L. E. Dubins, On curves of minimal length with a constraint on average curvature, Amer. J. Math. 79, "
        "1957, 497-516",
        optimum=6.644912355371826,
        digits=12,
        origin="closed form: the shortest of Dubins's six words, RSL",
        error=1e-6,
    )


@register
def rolling_ball() -> KnownProblem:
    """The plate-ball problem: a ball rolls without slipping to another place and the same attitude."""
    space = Euclidean(2) * SO(3)

    def dynamics(q: Any, u: Array) -> Any:
        return u, hat(jnp.stack([-u[1], u[0], 0 * u[0]])) @ q[1]

    def path(s: np.ndarray) -> tuple[Any, Any]:
        states = np.outer(s, [1.0, 0.0]), np.tile(np.eye(3), (len(s), 1, 1))
        return states, np.stack([np.cos(2 * np.pi * s), np.sin(2 * np.pi * s)], axis=1) * 4

    return KnownProblem(
        name="rolling-ball",
        title="a ball rolls by its radius and is turned as before, R^2 x SO(3)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot x = u, \quad \dot R = \widehat{(-u_2, u_1, 0)}\,R, \quad x \in \mathbb R^2, \quad R \in SO(3)",
        ),
        problem=OptimalControlProblem(space, dynamics, energy, 2),
        start=(np.zeros(2), np.eye(3)),
        end=(np.array([1.0, 0.0]), np.eye(3)),
        horizon=1.0,
        steps=40,
        method=cayley(space),
        path=path,
        states={"x": "centre over the radius", "R": "attitude, body to space"},
        controls={"u": "velocity of the centre over the radius"},
        source="V. Jurdjevic, The geometry of the plate-ball problem, Arch. Rational Mech. Anal. 124, 1993, 305-328",
        optimum=18.7959493,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
        accuracy=1e-9,
    )


@register
def zermelo() -> KnownProblem:
    """Zermelo's problem in a linear current."""

    def path(s: np.ndarray) -> tuple[Any, Any]:
        return np.outer(1 - s, [3.66, -1.86]), np.deg2rad(105 + 135 * s)[:, None]

    return KnownProblem(
        name="zermelo",
        title="Zermelo's ship in a linear current, least time",
        equations=(
            r"\text{minimise } T",
            r"\dot x = \cos a - y, \quad \dot y = \sin a",
        ),
        problem=OptimalControlProblem(
            Euclidean(2), lambda q, u: jnp.stack([jnp.cos(u[0]) - q[1], jnp.sin(u[0])]), lambda q, u: 1.0, 1
        ),
        start=np.array([3.66, -1.86]),
        end=np.zeros(2),
        horizon=Free(5.0, lower=0.1),
        path=path,
        states={"x": "along the current, unit h", "y": "across the current, unit h"},
        controls={"a": "heading from the current, rad"},
        time="h/V",
        cost="h/V",
        source="A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, section 2.7, problem 1",
        optimum=5.45786526356,
        digits=12,
        origin=r"shooting with the closed form of the heading, $\tan a = \tan a_0 + t$; published as 5.46",
    )


@register
def zermelo_sphere() -> KnownProblem:
    """Zermelo's problem on the sphere in a wind that turns about the poles: a great circle in the air that moves "
    "along."""
    sphere, wind = Sphere(2), 0.5
    start, end = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])

    def late(t: float) -> float:
        drifted = Rotation.from_rotvec([0.0, 0.0, wind * t]).apply(start)
        return float(t - np.arccos(drifted @ end))

    def dynamics(q: Array, u: Array) -> Array:
        return sphere.projection(q, u) + wind * jnp.stack([-q[1], q[0], 0 * q[0]])

    return KnownProblem(
        name="zermelo-sphere",
        title="least time on the sphere at unit airspeed, in a wind that turns about the poles",
        equations=(
            r"\text{minimise } \int_0^T 1 + \tfrac12 \langle q, u\rangle^2\,dt",
            r"\dot q = (I - q q^{\mathsf T})\,u + \tfrac12\,e_3 \times q, \quad q \in S^2",
            r"\lvert u\rvert^2 \le 1",
        ),
        problem=OptimalControlProblem(
            sphere, dynamics, lambda q, u: 1 + (q @ u) ** 2 / 2, 3, constraints={"airspeed": lambda q, u: u @ u - 1}
        ),
        start=start,
        end=end,
        horizon=Free(1.5, lower=0.1),
        states={"q": "position"},
        controls={"u": "velocity in the air; its normal part does nothing and costs"},
        source="E. Zermelo, Uber das Navigationsproblem bei ruhender oder veranderlicher Windverteilung, ZAMM 11, "
        "1931, 114-124; "
        "D. Bao, C. Robles, Z. Shen, Zermelo navigation on Riemannian manifolds, J. Differential Geom. 66, 2004, "
        "377-435",
        optimum=float(root_scalar(late, bracket=(0.0, 3.0), xtol=1e-15).root),
        digits=12,
        origin="closed form: a great circle in the air",
        formula=r"T = \arccos\,\langle e^{T \hat e_3/2}\,q_0, q_1\rangle",
        error=1e-8,
    )


def length_around_cap(start: np.ndarray, end: np.ndarray, centre: np.ndarray, radius: float) -> float:
    """The length of the shortest way around a cap of the sphere, between points that are as far from its centre."""
    away = np.arccos(start @ centre)
    tangent = np.arccos(np.cos(away) / np.cos(radius))
    seen = np.arccos(np.tan(radius) / np.tan(away))
    east, north = np.cross(centre, start), start - (start @ centre) * centre
    across = np.arccos((end - (end @ centre) * centre) @ north / (np.linalg.norm(east) * np.linalg.norm(north)))
    return float(2 * tangent + np.sin(radius) * (across - 2 * seen))


@register
def sphere_obstacle() -> KnownProblem:
    """Around a cap of the sphere: great circles that touch it, joined by a part of its edge."""
    sphere, angle, radius = Sphere(2), 2.0, 0.5
    centre = np.array([0.0, np.sin(0.1), np.cos(0.1)])
    start, end = (np.array([np.sin(a), 0.0, np.cos(a)]) for a in (-angle / 2, angle / 2))

    return KnownProblem(
        name="sphere-obstacle",
        title="around a cap of radius 0.5 on the sphere",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot q = (I - q q^{\mathsf T})\,u, \quad q \in S^2",
            r"\langle q, c\rangle \le \cos 0.5, \quad c = (0, \sin 0.1, \cos 0.1)",
        ),
        problem=OptimalControlProblem(
            sphere,
            lambda q, u: sphere.projection(q, u),
            energy,
            3,
            constraints={"cap": lambda q, u: q @ centre - np.cos(radius)},
        ),
        start=start,
        end=end,
        horizon=1.0,
        steps=60,
        states={"q": "point of S^2"},
        controls={"u": "velocity, its normal part costs and does nothing"},
        source="R. Bonalli, A. Bylard, A. Cauligi, T. Lew, M. Pavone, Trajectory optimization on manifolds: a "
        "theoretically-guaranteed "
        "embedded sequential convex programming approach, RSS 2019",
        optimum=length_around_cap(start, end, centre, radius) ** 2 / 2,
        digits=12,
        origin="closed form",
        formula=r"\frac{L^2}{2T}, \quad L \text{ the length of two tangents and the arc between}",
        error=1e-8,
    )
