"""Rockets, landers and transfers between orbits."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.linalg import expm, solve
from scipy.optimize import root_scalar

from ..integrators import Free, OptimalControlProblem
from ..manifolds import Euclidean
from .attitude import BETTS
from .flat import BRYSON, COPS
from .geodesics import energy, time
from .record import KnownProblem, register

LINE, PLANE = Euclidean(1), Euclidean(2)


def vertical_ascent(q: Any, u: Array) -> Any:
    """The dynamics of Goddard's rocket, whose exhaust leaves at a velocity of one half."""
    (h, v), m = q
    drag = 310 * v**2 * jnp.exp(-500 * (h - 1))
    return jnp.stack([v, (u[0] - drag) / m[0] - 1 / h**2]), -u / 0.5


@register
def goddard() -> KnownProblem:
    """Goddard's rocket: full thrust, a singular arc, no thrust."""
    return KnownProblem(
        name="goddard",
        title="Goddard's rocket to the largest height",
        equations=(
            r"\text{minimise } -h(t_f)",
            r"\dot h = v, \quad \dot v = \frac{T - D}{m} - \frac{1}{h^2}, \quad \dot m = -2T,",
            r"D = 310\,v^2 e^{-500 (h - 1)}",
            r"0 \le T \le 3.5",
        ),
        problem=OptimalControlProblem(
            PLANE * LINE,
            vertical_ascent,
            lambda q, u: 0.0 * u[0],
            1,
            terminal_cost=lambda q: -q[0][0],
            control_bounds=(0.0, 3.5),
        ),
        start=(np.array([1.0, 0.0]), np.ones(1)),
        end=(None, np.array([0.6])),
        horizon=Free(0.2, lower=0.05, upper=0.5),
        steps=60,
        path=lambda s: (
            (np.stack([1 + 0.01 * s, 0.1 * s * (1 - s)], axis=1), 1 - 0.4 * s[:, None]),
            np.full((len(s), 1), 1.0),
        ),
        states={
            "h": "distance from the centre of the Earth over its radius",
            "v": "velocity",
            "m": "mass over that at the start",
        },
        controls={"T": "thrust over weight at the start"},
        source=f"{COPS}, 10; R. H. Goddard, A Method of Reaching Extreme Altitudes, 1919",
        optimum=-1.0128369183,
        digits=11,
        origin="arcs whose ends are found, on several meshes and at orders 6 and 8; published as 1.01283",
        accuracy=1e-9,
    )


@register
def moon_landing() -> KnownProblem:
    """A soft landing on the Moon with least fuel: free fall, then full thrust."""
    return KnownProblem(
        name="moon-landing",
        title="a soft landing on the Moon with least fuel",
        equations=(
            r"\text{minimise } \int_0^T u\,dt",
            r"\dot h = v, \quad \dot v = u - 1.5",
            r"0 \le u \le 3",
        ),
        problem=OptimalControlProblem(
            PLANE, lambda q, u: jnp.stack([q[1], u[0] - 1.5]), lambda q, u: u[0], 1, control_bounds=(0.0, 3.0)
        ),
        start=np.array([10.0, -2.0]),
        end=np.zeros(2),
        horizon=Free(4.0, lower=0.1),
        steps=60,
        states={"h": "height", "v": "velocity"},
        controls={"u": "thrust over mass"},
        source="J. S. Meditch, On the problem of optimal thrust programming for a lunar soft landing, IEEE Trans. "
        "Autom. Control 9, "
        "1964, 477-484; data of GPOPS-II",
        optimum=float(np.sqrt(68.0)),
        digits=12,
        origin=r"closed form: free fall until $t = (\sqrt{68} - 4) / 3$",
        formula=r"\sqrt{68}",
        accuracy=1e-9,
    )


@register
def linear_tangent_steering() -> KnownProblem:
    """Least time to an orbit's height and velocity: the tangent of the angle of thrust is linear in time."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([q[2], 100 * jnp.cos(u[0]), 100 * jnp.sin(u[0])])

    def last(k: float) -> float:
        return 0.45 * k / np.arcsinh(k)

    def high(k: float) -> float:
        return 25 * last(k) ** 2 * (k * np.hypot(1, k) - np.arcsinh(k)) / k**2 - 5

    slope = root_scalar(high, bracket=(0.1, 10.0), xtol=1e-15).root

    def path(s: np.ndarray) -> tuple[Any, Any]:
        return np.stack([5 * s, 45 * s, 20 * s * (1 - s)], axis=1), (0.8 - 1.6 * s)[:, None]

    return KnownProblem(
        name="linear-tangent-steering",
        title="least time to height 5 and horizontal velocity 45 under constant thrust",
        equations=(
            r"\text{minimise } T",
            r"\dot y = v_y, \quad \dot v_x = 100 \cos a, \quad \dot v_y = 100 \sin a",
        ),
        problem=OptimalControlProblem(Euclidean(3), dynamics, time, 1),
        start=np.zeros(3),
        end=np.array([5.0, 45.0, 0.0]),
        horizon=Free(0.6, lower=0.1),
        path=path,
        states={"y": "height", "vx": "horizontal velocity", "vy": "vertical velocity"},
        controls={"a": "angle of the thrust, rad"},
        source=f"{BRYSON}, section 2.4; {COPS}, 9",
        optimum=float(last(slope)),
        digits=12,
        origin="closed form; published as 0.554571",
        formula=r"T = \frac{9 k}{20 \operatorname{arsinh} k}, \quad k = \tan a_0",
        error=1e-8,
    )


def orbit_under_thrust(q: Any, u: Array) -> Any:
    """The dynamics of ``orbit_raising``: of the radius, of both velocities and of the time."""
    r, (v, w) = q[0][0], q[1]
    thrust = 0.1405 / (1 - 0.0749 * q[2][0])
    radial = (w**2 - 1) / r**2 + thrust * jnp.sin(u[0])
    around = -w * v / (2 * r) + jnp.sqrt(r) * thrust * jnp.cos(u[0])
    return v[None], jnp.stack([radial, around]), jnp.ones(1)


@register
def orbit_raising() -> KnownProblem:
    """The largest circular orbit within a given time under a small thrust. ``w = v sqrt(r)`` is 1 on a circular
    orbit."""

    def path(s: np.ndarray) -> tuple[Any, Any]:
        states = 1 + 0.5 * s[:, None], np.stack([0.2 * s * (1 - s), np.ones(len(s))], axis=1), 3.32 * s[:, None]
        return states, np.where(s < 0.5, 0.8, -0.8)[:, None]

    return KnownProblem(
        name="orbit-raising",
        title="the largest circular orbit in 193 days under a small thrust",
        equations=(
            r"\text{minimise } -r(T)",
            r"\dot r = v, \quad \dot v = \frac{w^2 - 1}{r^2} + A \sin a,",
            r"\dot w = -\frac{w v}{2 r} + \sqrt r\,A \cos a, \quad A = \frac{0.1405}{1 - 0.0749\,t}",
        ),
        problem=OptimalControlProblem(
            LINE * PLANE * LINE, orbit_under_thrust, lambda q, u: 0.0 * u[0], 1, terminal_cost=lambda q: -q[0][0]
        ),
        start=(np.ones(1), np.array([0.0, 1.0]), np.zeros(1)),
        end=(None, np.array([0.0, 1.0]), None),
        horizon=3.32,
        steps=60,
        path=path,
        states={
            "r": "radius over that of the Earth's orbit",
            "v": "radial velocity",
            "w": "angular momentum over sqrt(r)",
            "t": "time",
        },
        controls={"a": "angle of the thrust from the horizontal, rad"},
        time="58.13 days",
        source=f"{BRYSON}, section 2.5",
        optimum=-1.525277701,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses; published as 1.5253",
    )


@register
def rendezvous() -> KnownProblem:
    """Rendezvous near a circular orbit in the linear equations of Clohessy and Wiltshire."""
    a = np.zeros((6, 6))
    a[:3, 3:] = np.eye(3)
    a[3, 0], a[3, 4], a[4, 3], a[5, 2] = 3.0, 2.0, -2.0, -1.0
    b, horizon = np.eye(6)[:, 3:], 4.0
    start = np.array([1.0, -2.0, 0.5, 0.0, 0.3, -0.2])

    def least() -> float:
        block = expm(horizon * np.block([[-a, b @ b.T], [np.zeros((6, 6)), a.T]]))
        flow = block[6:, 6:].T
        drift = flow @ start
        return float(drift @ solve(flow @ block[:6, 6:], drift, assume_a="sym") / 2)

    return KnownProblem(
        name="rendezvous",
        title="rendezvous near a circular orbit with least effort",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot x = v, \quad \dot v_1 = 3 x_1 + 2 v_2 + u_1,",
            r"\dot v_2 = -2 v_1 + u_2, \quad \dot v_3 = -x_3 + u_3",
        ),
        problem=OptimalControlProblem(Euclidean(6), lambda q, u: a @ q + b @ u, energy, 3),
        start=start,
        end=np.zeros(6),
        horizon=horizon,
        steps=20,
        states={"x": "position: radial, along, across", "v": "velocity"},
        controls={"u": "acceleration"},
        time="period / 2 pi",
        source="W. H. Clohessy, R. S. Wiltshire, Terminal guidance system for satellite rendezvous, J. Aerospace Sci. "
        "27, 1960, 653-658",
        optimum=least(),
        digits=10,
        origin="closed form, by the Gramian $W$ of controllability",
        formula=r"\tfrac12\,d^{\mathsf T} W^{-1} d",
    )


@register
def low_thrust_transfer() -> KnownProblem:
    """From a circular orbit to a wider and inclined one with least energy of the thrust."""
    tilt, radius, place = np.deg2rad(15), 1.5, 1.5 * np.pi
    forward = np.array([-np.sin(place), np.cos(place) * np.cos(tilt), np.cos(place) * np.sin(tilt)])
    outward = np.array([np.cos(place), np.sin(place) * np.cos(tilt), np.sin(place) * np.sin(tilt)])

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.concatenate([q[3:], u - q[:3] / (q[:3] @ q[:3]) ** 1.5])

    def path(s: np.ndarray) -> tuple[Any, Any]:
        angle, r = place * s, 1 + (radius - 1) * s
        plane = r[:, None] * np.stack([np.cos(angle), np.sin(angle), 0 * s], axis=1)
        speed = np.stack([-np.sin(angle), np.cos(angle), 0 * s], axis=1) / np.sqrt(r)[:, None]
        return np.concatenate([plane, speed], axis=1), np.zeros((len(s), 3))

    return KnownProblem(
        name="low-thrust-transfer",
        title="from a circular orbit to a wider one, inclined by 15 degrees, with least energy of the thrust",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot x = v, \quad \dot v = u - \frac{x}{\lvert x\rvert^3}, \quad x \in \mathbb R^3",
        ),
        problem=OptimalControlProblem(Euclidean(6), dynamics, energy, 3),
        start=np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
        end=np.concatenate([radius * outward, forward / np.sqrt(radius)]),
        horizon=6.5,
        steps=40,
        path=path,
        states={"x": "position over the first radius", "v": "velocity"},
        controls={"u": "acceleration"},
        time="period / 2 pi",
        source="B. A. Conway (ed.), Spacecraft Trajectory Optimization, Cambridge 2010, chapter 3",
        optimum=0.0115468073,
        digits=9,
        origin="collocation of order 8 with IPOPT, from several guesses",
    )


@register
def free_flying_robot() -> KnownProblem:
    """A robot in space with two thrusters that push and pull, on least fuel: coasts between full thrusts."""

    def dynamics(q: Array, u: Array) -> Array:
        left, right = u[0] - u[1], u[2] - u[3]
        thrust = left + right
        return jnp.stack([q[3], q[4], q[5], thrust * jnp.cos(q[2]), thrust * jnp.sin(q[2]), 0.2 * (left - right)])

    return KnownProblem(
        name="free-flying-robot",
        title="a free-flying robot on least fuel",
        equations=(
            r"\text{minimise } \int_0^T u_1 + u_2 + u_3 + u_4\,dt",
            r"\ddot x = (F_1 + F_2) \cos a, \quad \ddot y = (F_1 + F_2) \sin a, \quad \ddot a = 0.2\,(F_1 - F_2)",
            r"F_1 = u_1 - u_2, \quad F_2 = u_3 - u_4, \quad 0 \le u_i \le 1, \quad u_1 + u_2 \le 1,",
            r"u_3 + u_4 \le 1",
        ),
        problem=OptimalControlProblem(
            Euclidean(6),
            dynamics,
            lambda q, u: jnp.sum(u),
            4,
            control_bounds=(0.0, 1.0),
            constraints={"thrusters": lambda q, u: jnp.stack([u[0] + u[1] - 1, u[2] + u[3] - 1])},
        ),
        start=np.array([-10.0, -10.0, np.pi / 2, 0.0, 0.0, 0.0]),
        end=np.zeros(6),
        horizon=12.0,
        steps=60,
        states={"x, y": "position", "a": "heading, rad", "x', y', a'": "their rates"},
        controls={"u1, u2": "thruster 1, forward and back", "u3, u4": "thruster 2"},
        source="Y. Sakawa, Trajectory planning of a free-flying robot by using the optimal control, Optim. Control "
        "Appl. Meth. "
        f"20, 1999, 235-248; {BETTS}, example 6.13",
        optimum=7.910154646,
        digits=8,
        origin="published as 7.910154646",
        error=2e-5,
    )
