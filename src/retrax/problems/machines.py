"""Machines with inertia: pendulums, a cart, a quadrotor, a spacecraft that docks, a robot arm."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.spatial.transform import Rotation

from ..integrators import Free, OptimalControlProblem
from ..manifolds import SE, Euclidean, Sphere, TangentBundle
from .attitude import INERTIA as SATELLITE
from .attitude import cayley
from .geodesics import energy
from .record import KnownProblem, register

RIGID = SE(3) * Euclidean(6)
UP = np.array([0.0, 0.0, 1.0])
MOTION = {
    "g": "pose, body to inertial frame, m",
    "w": "angular velocity, rad/s, body frame",
    "v": "velocity, m/s, body frame",
}


def rigid_motion(mass: float, inertia: np.ndarray, q: Any, force: Any, torque: Any) -> Any:
    """Time derivatives of the pose and the twist of a rigid body, in the body frame.

    ``g' = g hat(w, v)``, ``J w' + w x J w = torque``, ``m (v' + w x v) = force``.
    """
    pose, twist = q
    w, v = twist[:3], twist[3:]
    turning = (torque - jnp.cross(w, inertia * w)) / inertia
    return pose @ SE(3).hat(twist), jnp.concatenate([turning, force / mass - jnp.cross(w, v)])


def pose(vector: Any, position: Any) -> np.ndarray:
    """The pose of a rotation vector and a position."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), position
    return out


@register
def spherical_pendulum() -> KnownProblem:
    """A spherical pendulum swings up with least force."""
    sphere = Sphere(2)

    def dynamics(z: Any, u: Array) -> Any:
        q, v = z
        return v, sphere.projection(q, u - UP) - (v @ v) * q

    return KnownProblem(
        name="spherical-pendulum",
        title="a spherical pendulum swings up in time 3 with least force, TS^2",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot q = v, \quad \dot v = (I - q q^{\mathsf T})(u - e_3) - \lvert v\rvert^2 q, \quad (q, v) \in TS^2",
        ),
        problem=OptimalControlProblem(TangentBundle(sphere), dynamics, energy, 3),
        start=(np.array([np.sin(0.5), 0.0, -np.cos(0.5)]), np.array([0.0, 0.5, 0.0])),
        end=(UP, np.zeros(3)),
        horizon=3.0,
        states={"q": "direction of the rod", "v": "its velocity"},
        controls={"u": "force over weight; its part along the rod costs and does nothing"},
        source="unit mass, length and gravity; T. Lee, M. Leok, N. H. McClamroch, Global Formulations of Lagrangian "
        "and Hamiltonian "
        "Dynamics on Manifolds, Springer 2018, section 4.1",
        optimum=2.1226524395,
        digits=10,
        origin="limit of the discrete optima as the steps shrink; the least of the extremals that are known",
    )


@register
def pendulum() -> KnownProblem:
    """A pendulum on the circle swings up with least torque."""

    def dynamics(z: Any, u: Array) -> Any:
        (c, s), w = z
        return w[0] * jnp.stack([-s, c]), u - s

    return KnownProblem(
        name="pendulum",
        title="a pendulum swings up in time 5 with least torque, S^1 x R",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u^2\,dt",
            r"\dot c = -w s, \quad \dot s = w c, \quad \dot w = u - s, \quad c^2 + s^2 = 1",
        ),
        problem=OptimalControlProblem(Sphere(1) * Euclidean(1), dynamics, energy, 1),
        start=(np.array([1.0, 0.0]), np.zeros(1)),
        end=(np.array([-1.0, 0.0]), np.zeros(1)),
        horizon=5.0,
        states={"c, s": "cosine and sine of the angle from hanging", "w": "its rate"},
        controls={"u": "torque over m g l"},
        time="sqrt(l/g)",
        source="K. J. Astrom, K. Furuta, Swinging up a pendulum by energy control, Automatica 36, 2000, 287-295",
        optimum=1.212590596,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
        accuracy=1e-9,
    )


@register
def cart_pole() -> KnownProblem:
    """A pole on a cart swings up with least force."""
    cart, bob, length, gravity = 1.0, 0.3, 0.5, 9.81

    def dynamics(z: Array, u: Array) -> Array:
        s, c, w = jnp.sin(z[1]), jnp.cos(z[1]), z[3]
        inertia = cart + bob * s * s
        pull = bob * length * w * w * s
        acceleration = (u[0] + pull + bob * gravity * s * c) / inertia
        turning = -(u[0] * c + pull * c + (cart + bob) * gravity * s) / (length * inertia)
        return jnp.stack([z[2], w, acceleration, turning])

    return KnownProblem(
        name="cart-pole",
        title="a pole on a cart swings up in 2 s and 1 m aside with least force",
        equations=(
            r"\text{minimise } \int_0^T u^2\,dt",
            r"\dot x = v, \quad \dot v = \frac{u + m l w^2 \sin a + m g \sin a \cos a}{M + m \sin^2 a}",
            r"\dot a = w,",
            r"\dot w = -\frac{u \cos a + m l w^2 \sin a \cos a + (M + m) g \sin a}{l\,(M + m \sin^2 a)}",
            r"\lvert u\rvert \le 20, \quad M = 1\ \mathrm{kg}, \quad m = 0.3\ \mathrm{kg},",
            r"l = 0.5\ \mathrm{m}, \quad g = 9.81\ \mathrm{m/s^2}",
        ),
        problem=OptimalControlProblem(Euclidean(4), dynamics, lambda z, u: u @ u, 1, control_bounds=(-20.0, 20.0)),
        start=np.zeros(4),
        end=np.array([1.0, np.pi, 0.0, 0.0]),
        horizon=2.0,
        steps=60,
        states={"x": "cart, m", "a": "angle from hanging, rad", "v": "cart, m/s", "w": "pole, rad/s"},
        controls={"u": "force on the cart, N"},
        time="s",
        cost="N^2 s",
        source="M. Kelly, An introduction to trajectory optimization: how to do your own direct collocation, SIAM "
        "Review 59, 2017, "
        "849-904, section 6 and appendix E",
        optimum=58.80766746,
        digits=10,
        origin="collocation of order 8 with IPOPT, 40 and 80 steps, from several guesses",
        accuracy=1e-9,
    )


@register
def quadrotor() -> KnownProblem:
    """A quadrotor flies from hover to hover and turns on the way."""
    mass, inertia, gravity = 4.34, np.array([0.0820, 0.0845, 0.1377]), 9.81

    def dynamics(q: Any, u: Array) -> Any:
        force = u[0] * UP - mass * gravity * q[0][2, :3]
        return rigid_motion(mass, inertia, q, force, u[1:])

    def cost(_: Any, u: Array) -> Array:
        return ((u[0] - mass * gravity) ** 2 / 100 + u[1:] @ u[1:]) / 2

    return KnownProblem(
        name="quadrotor",
        title="a quadrotor from hover to hover, 3 m aside and 1 m up, turned by 90 degrees, in 2 s, SE(3)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \tfrac1{100} (f - m\gamma)^2 + \lvert M\rvert^2\,dt",
            r"\dot g = g\,\widehat{(w, v)}, \quad g = (R, x) \in SE(3)",
            r"J\dot w + w \times Jw = M, \quad m(\dot v + w \times v) = f e_3 - m\gamma R^{\mathsf T} e_3",
            r"m = 4.34\ \mathrm{kg}, \quad \gamma = 9.81\ \mathrm{m/s^2},",
            r"J = \mathrm{diag}(0.0820, 0.0845, 0.1377)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(RIGID, dynamics, cost, 4),
        start=(np.eye(4), np.zeros(6)),
        end=(pose([0, 0, np.pi / 2], [3.0, 0.0, 1.0]), np.zeros(6)),
        horizon=2.0,
        method=cayley(RIGID),
        states=MOTION,
        controls={"f": "thrust along body axis 3, N", "M": "moment, N m, body frame"},
        time="s",
        source="vehicle of T. Lee, M. Leok, N. H. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), "
        "CDC 2010, "
        "5420-5425, with body axis 3 upward",
        optimum=0.486022835,
        digits=9,
        origin="limit of the discrete optima here as the steps shrink",
        accuracy=1e-9,
    )


@register
def docking() -> KnownProblem:
    """A spacecraft moves by 10 m and turns by 90 degrees from rest to rest: both motions at once, as if each were "
    "alone."""
    mass, horizon, shift = 500.0, 60.0, np.array([8.0, 6.0, 0.0])
    problem = OptimalControlProblem(
        RIGID,
        lambda q, u: rigid_motion(mass, SATELLITE, q, u[:3], u[3:]),
        lambda q, u: (u[:3] @ u[:3] + u[3:] @ u[3:]) / 2,
        6,
    )
    return KnownProblem(
        name="docking",
        title="a spacecraft moves by 10 m and turns by 90 degrees in 60 s, SE(3)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert f\rvert^2 + \lvert M\rvert^2\,dt",
            r"\dot g = g\,\widehat{(w, v)}, \quad J\dot w + w \times Jw = M,",
            r"m(\dot v + w \times v) = f, \quad g \in SE(3)",
            r"m = 500\ \mathrm{kg}, \quad J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=problem,
        start=(np.eye(4), np.zeros(6)),
        end=(pose([0, 0, np.pi / 2], shift), np.zeros(6)),
        horizon=horizon,
        method=cayley(RIGID),
        states=MOTION,
        controls={"f": "force, N, body frame", "M": "torque, N m, body frame; forces cost as torques at 1 m"},
        time="s",
        cost="N^2 s",
        source="spacecraft of J. T. Betts, Practical Methods for Optimal Control, section 6.8, with 500 kg",
        optimum=float(6 * (mass**2 * (shift @ shift) + (SATELLITE[2] * np.pi / 2) ** 2) / horizon**3),
        digits=12,
        origin="closed form: the length of the force is the same in both frames, the turn is about a principal axis",
        formula=r"\frac{6\,(m^2 d^2 + J_3^2 a^2)}{T^3}",
    )


@register
def docking_corridor() -> KnownProblem:
    """The approach within a cone in front of the port, with limited forces."""
    mass, width = 500.0, np.tan(np.deg2rad(20))

    def corridor(q: Any, _: Array) -> Array:
        x, y, z = q[0][0, 3], q[0][1, 3], q[0][2, 3]
        return (y * y + z * z) - (width * (x + 0.1)) ** 2

    def dynamics(q: Any, u: Array) -> Any:
        return rigid_motion(mass, SATELLITE, q, u[:3], u[3:])

    return KnownProblem(
        name="docking-corridor",
        title="docking from the side, within 20 degrees of the axis of the port, SE(3)",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert f\rvert^2 + \lvert M\rvert^2\,dt",
            r"\dot g = g\,\widehat{(w, v)}, \quad J\dot w + w \times Jw = M,",
            r"m(\dot v + w \times v) = f, \quad g \in SE(3)",
            r"y^2 + z^2 \le \tan^2 20^\circ\,(x + 0.1)^2, \quad \lvert f_i\rvert, \lvert M_i\rvert \le 10",
            r"m = 500\ \mathrm{kg}, \quad J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(
            RIGID, dynamics, energy, 6, control_bounds=(-10.0, 10.0), constraints={"corridor": corridor}
        ),
        start=(pose([0, 0, -np.pi / 2], [10.0, 3.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.0, 0.1, 0.0])),
        end=(np.eye(4), np.zeros(6)),
        horizon=60.0,
        steps=40,
        method=cayley(RIGID),
        states=MOTION,
        controls={"f": "force, N, body frame", "M": "torque, N m, body frame"},
        time="s",
        cost="N^2 s",
        source="U. Lee, M. Mesbahi, Optimal power descent guidance with 6-DoF line of sight constraints via unit dual "
        "quaternions, "
        "AIAA 2015-0319",
        optimum=1642.832,
        digits=7,
        origin="limit of the discrete optima here as the steps shrink",
        error=1e-6,
    )


@register
def robot_arm() -> KnownProblem:
    """An arm that extends, turns and lifts, in least time."""

    def dynamics(z: Array, u: Array) -> Array:
        rho, phi = z[0], z[2]
        lift = ((5 - rho) ** 3 + rho**3) / 3
        return jnp.concatenate([z[3:], jnp.stack([u[0] / 5, u[1] / (lift * jnp.sin(phi) ** 2), u[2] / lift])])

    rest = np.zeros(3)
    return KnownProblem(
        name="robot-arm",
        title="a robot arm turns by 120 degrees in least time",
        equations=(
            r"\text{minimise } T",
            r"\ddot r = \frac{u_1}{5}, \quad \ddot a = \frac{u_2}{I \sin^2 b},",
            r"\ddot b = \frac{u_3}{I}, \quad I = \frac{(5 - r)^3 + r^3}{3}",
            r"\lvert u_i\rvert \le 1",
        ),
        problem=OptimalControlProblem(Euclidean(6), dynamics, lambda z, u: 1.0, 3, control_bounds=(-1.0, 1.0)),
        start=np.concatenate([[4.5, 0.0, np.pi / 4], rest]),
        end=np.concatenate([[4.5, 2 * np.pi / 3, np.pi / 4], rest]),
        horizon=Free(9.0, lower=1.0),
        steps=60,
        states={"r": "length", "a": "turn, rad", "b": "lift, rad", "r', a', b'": "their rates"},
        controls={"u": "forces and torques, scaled"},
        source="E. D. Dolan, J. J. More, T. S. Munson, Benchmarking optimization software with COPS 3.0, "
        "ANL/MCS-TM-273, 2004, 8",
        optimum=9.140911746,
        digits=10,
        origin="limit of the discrete optima here as the steps shrink; published as 9.14138, on a coarse mesh",
        accuracy=1e-9,
    )
