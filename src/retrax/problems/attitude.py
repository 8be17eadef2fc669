"""Slews of a spacecraft on SO(3) x R^3: least effort, limits, failures, cones, wheels, and least time."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.spatial.transform import Rotation

from ..integrators import Free, OptimalControlProblem
from ..manifolds import SO, Euclidean, Manifold, hat
from ..retractions import Cayley, Gauss
from .geodesics import IDENTITY, energy
from .record import KnownProblem, register

BETTS = (
    "J. T. Betts, Practical Methods for Optimal Control and Estimation Using Nonlinear Programming, 2nd ed., SIAM 2010"
)
INERTIA = np.array([5621.0, 4547.0, 2364.0])  # kg m^2, of X-SAT in Betts 6.8
RIGID = SO(3) * Euclidean(3)
REST = np.zeros(3)
TARGET: np.ndarray = Rotation.from_rotvec(np.deg2rad(150) * np.array([1.0, 2.0, -2.0]) / 3).as_matrix()
POSE = {"R": "attitude, body to inertial frame", "w": "angular velocity, rad/s, body frame"}
TORQUE = {"u": "torque, N m, body frame"}


def rigid_body(inertia: np.ndarray, actuators: np.ndarray = IDENTITY) -> Callable[[Any, Array], Any]:
    """``R' = R hat(w)``, ``J w' + w x J w = B u``: the columns of B are the directions of the torques."""

    def dynamics(q: Any, u: Array) -> Any:
        attitude, rate = q
        return attitude @ hat(rate), (actuators @ u - jnp.cross(rate, inertia * rate)) / inertia

    return dynamics


def cayley(manifold: Manifold) -> Gauss:
    """Gauss's method of order 6 in the chart of the Cayley map."""
    return Gauss(3, Cayley(manifold))


@register
def rest_to_rest_slew() -> KnownProblem:
    """150 degrees about (1, 2, -2)/3 in 60 s."""
    return KnownProblem(
        name="rest-to-rest-slew",
        title="150 degrees about (1, 2, -2)/3 in 60 s with least torque",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot R = R\,\hat w, \quad J\dot w + w \times Jw = u, \quad R \in SO(3)",
            r"J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(RIGID, rigid_body(INERTIA), energy, 3),
        start=(IDENTITY, REST),
        end=(TARGET, REST),
        horizon=60.0,
        method=cayley(RIGID),
        states=POSE,
        controls=TORQUE,
        time="s",
        cost="N^2 m^2 s",
        source=f"spacecraft of {BETTS}, section 6.8",
        optimum=2504.24655710,
        digits=10,
        origin="limit of the discrete optima as the steps shrink",
    )


def three_turns(s: np.ndarray) -> tuple[Any, Any]:
    """Turns about axes 1, 2 and 1 in turn, from rest to rest, which the remaining torques can produce."""
    angles, horizon = Rotation.from_matrix(TARGET).as_euler("XYX"), 120.0
    done = np.clip(3 * s[:, None] - np.arange(3), 0, 1)
    speeds = 6 * done * (1 - done) * 3 * angles / horizon
    turns = Rotation.from_euler("XYX", done**2 * (3 - 2 * done) * angles).as_matrix()
    rates = np.stack([speeds[:, 0] + speeds[:, 2], speeds[:, 1], 0 * s], axis=1)
    return (turns, rates), np.zeros((len(s), 2))


@register
def failed_actuator() -> KnownProblem:
    """The slew of Betts' spacecraft in 120 s without torque about the third axis."""
    return KnownProblem(
        name="failed-actuator",
        title="150 degrees about (1, 2, -2)/3 in 120 s without torque about the third axis",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T u_1^2 + u_2^2\,dt",
            r"\dot R = R\,\hat w, \quad J\dot w + w \times Jw = (u_1, u_2, 0), \quad R \in SO(3)",
            r"J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(RIGID, rigid_body(INERTIA, IDENTITY[:, :2]), energy, 2),
        start=(IDENTITY, REST),
        end=(TARGET, REST),
        horizon=120.0,
        steps=40,
        method=cayley(RIGID),
        states=POSE,
        controls={"u1": "torque about body axis 1, N m", "u2": "about body axis 2, N m"},
        time="s",
        cost="N^2 m^2 s",
        source=f"spacecraft of {BETTS}, section 6.8; H. Krishnan, M. Reyhanoglu, N. H. McClamroch, Attitude "
        "stabilization of a rigid "
        "spacecraft using two control torques, Automatica 30, 1994, 1023-1027",
        optimum=3641.92438,
        digits=9,
        origin="limit of the discrete optima here as the steps shrink",
        error=1e-8,
        path=three_turns,
    )


@register
def limited_slew() -> KnownProblem:
    """The rest-to-rest slew with torques of at most three quarters of the largest that it takes without limits."""
    limit = 10.0
    return KnownProblem(
        name="limited-slew",
        title="150 degrees about (1, 2, -2)/3 in 60 s with torques of at most 10 N m",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot R = R\,\hat w, \quad J\dot w + w \times Jw = u, \quad R \in SO(3)",
            r"\lvert u_i\rvert \le 10, \quad J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(RIGID, rigid_body(INERTIA), energy, 3, control_bounds=(-limit, limit)),
        start=(IDENTITY, REST),
        end=(TARGET, REST),
        horizon=60.0,
        steps=60,
        method=cayley(RIGID),
        states=POSE,
        controls=TORQUE,
        time="s",
        cost="N^2 m^2 s",
        source=f"spacecraft of {BETTS}, section 6.8",
        optimum=2548.437837,
        digits=10,
        origin="limit of the discrete optima here as the steps shrink",
        accuracy=1e-9,
    )


def below_the_sun(s: np.ndarray) -> tuple[Any, Any]:
    """A turn about the vertical that dips: one straight through the cone leads nowhere."""
    turns = Rotation.from_euler("ZY", np.stack([np.deg2rad(120) * s, 0.5 * np.sin(np.pi * s)], axis=1)).as_matrix()
    return (turns, np.zeros((len(s), 3))), np.zeros((len(s), 3))


@register
def keep_out_cone() -> KnownProblem:
    """A turn by 120 degrees about the vertical, on which the instrument keeps 25 degrees from the Sun."""
    sun, apart = np.array([np.cos(np.pi / 3), np.sin(np.pi / 3), 0.1]), np.cos(np.deg2rad(25))
    sun = sun / np.linalg.norm(sun)
    return KnownProblem(
        name="keep-out-cone",
        title="120 degrees in 60 s, the first body axis at least 25 degrees from the Sun",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot R = R\,\hat w, \quad J\dot w + w \times Jw = u, \quad R \in SO(3)",
            r"\langle s, R\,e_1\rangle \le \cos 25^\circ,",
            r"s \text{ along } (\cos 60^\circ, \sin 60^\circ, 0.1),",
            r"J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(
            RIGID, rigid_body(INERTIA), energy, 3, constraints={"Sun": lambda q, u: sun @ q[0][:, 0] - apart}
        ),
        start=(IDENTITY, REST),
        end=(Rotation.from_rotvec([0, 0, np.deg2rad(120)]).as_matrix(), REST),
        horizon=60.0,
        steps=120,
        method=cayley(RIGID),
        states=POSE,
        controls=TORQUE,
        time="s",
        cost="N^2 m^2 s",
        source=f"spacecraft of {BETTS}, section 6.8; U. Lee, M. Mesbahi, Feedback control for spacecraft "
        "reorientation under attitude "
        "constraints via convex potentials, IEEE Trans. Aerosp. Electron. Syst. 50, 2014, 2578-2592",
        optimum=1856.956,
        digits=7,
        origin="limit of the discrete optima here as the steps shrink",
        error=5e-5,
        path=below_the_sun,
    )


@register
def reaction_wheels() -> KnownProblem:
    """A slew by three wheels, whose momentum is limited, of a spacecraft with total angular momentum."""
    total, limit = np.array([20.0, -10.0, 5.0]), 150.0

    def rate(q: Any) -> Array:
        attitude, wheels = q
        return (total @ attitude - wheels) / INERTIA

    def momentum(q: Any, _: Array) -> Array:
        return jnp.concatenate([q[1] - limit, -limit - q[1]]) / limit

    return KnownProblem(
        name="reaction-wheels",
        title="the slew by three wheels of at most 150 N m s, with a total momentum of 23 N m s",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"\dot R = R\,\hat w, \quad \dot h = -u, \quad w = J^{-1}(R^{\mathsf T} k - h), \quad R \in SO(3)",
            r"\lvert h_i\rvert \le 150, \quad k = (20, -10, 5),",
            r"J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(
            RIGID, lambda q, u: (q[0] @ hat(rate(q)), -u), energy, 3, constraints={"wheel momentum": momentum}
        ),
        start=(IDENTITY, total),
        end=(TARGET, total @ TARGET),
        horizon=60.0,
        steps=60,
        method=cayley(RIGID),
        states={"R": "attitude, body to inertial frame", "h": "momentum of the wheels, N m s, body frame"},
        controls={"u": "torque of the wheels on the body, N m, body frame"},
        time="s",
        cost="N^2 m^2 s",
        source=f"spacecraft of {BETTS}, section 6.8; F. L. Markley, J. L. Crassidis, Fundamentals of Spacecraft "
        "Attitude Determination "
        "and Control, Springer 2014, section 3.3.5",
        optimum=2690.916536,
        digits=10,
        origin="limit of the discrete optima here as the steps shrink",
        accuracy=1e-9,
    )


@register
def detumbling() -> KnownProblem:
    """A tumbling body is brought to rest: the torque is along the momentum."""
    inertia, rate, horizon = np.array([1.0, 1.7, 2.3]), np.array([1.0, -0.5, 0.8]), 2.0
    return KnownProblem(
        name="detumbling",
        title="a tumbling rigid body is brought to rest with least torque",
        equations=(
            r"\text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt",
            r"J\dot w + w \times Jw = u, \quad J = \mathrm{diag}(1, 1.7, 2.3)",
        ),
        problem=OptimalControlProblem(Euclidean(3), lambda w, u: (u - jnp.cross(w, inertia * w)) / inertia, energy, 3),
        start=rate,
        end=REST,
        horizon=horizon,
        states={"w": "angular velocity, body frame"},
        controls={"u": "torque, body frame"},
        source="M. Athans, P. L. Falb, Optimal Control, 1966, section 10-6, norm-invariant systems",
        optimum=float(np.sum((inertia * rate) ** 2) / (2 * horizon)),
        digits=12,
        origin=r"closed form: $u = -Jw / (T - t)$",
        formula=r"\frac{\lvert J w_0\rvert^2}{2T}",
    )


def eigenaxis_turn(s: np.ndarray) -> tuple[Any, Any]:
    """A turn about x, with torques that disturb it about the other axes: at rest there, it leads to slower
    extremals."""
    angle, guessed = np.deg2rad(150), 30.0
    turns, rates = (
        np.outer(angle * s**2 * (3 - 2 * s), [1, 0, 0]),
        np.outer(angle * 6 * s * (1 - s) / guessed, [1, 0, 0]),
    )
    torques = 30 * np.stack([np.cos(np.pi * s), np.cos(2 * np.pi * s), np.cos(2 * np.pi * s)], axis=1)
    return (Rotation.from_rotvec(turns).as_matrix(), rates), torques


@register
def betts() -> KnownProblem:
    """Minimum-time reorientation of an asymmetric body; the turn about the axis itself, 34.3112 s, is an extremal
    too."""
    return KnownProblem(
        name="betts",
        title="150 degrees about x in least time, torques of at most 50 N m",
        equations=(
            r"\text{minimise } T",
            r"\dot R = R\,\hat w, \quad J\dot w + w \times Jw = u, \quad R \in SO(3)",
            r"\lvert u_i\rvert \le 50, \quad J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}",
        ),
        problem=OptimalControlProblem(RIGID, rigid_body(INERTIA), lambda q, u: 1.0, 3, control_bounds=(-50.0, 50.0)),
        start=(IDENTITY, REST),
        end=(Rotation.from_rotvec([np.deg2rad(150), 0, 0]).as_matrix(), REST),
        horizon=Free(30.0, lower=1.0),
        steps=60,
        method=cayley(RIGID),
        states=POSE,
        controls=TORQUE,
        time="s",
        cost="s",
        source=f"{BETTS}, section 6.8",
        optimum=28.630406535,
        digits=11,
        origin="published as 28.6304077; bang-bang arcs with free switching times, on several meshes",
        accuracy=1e-9,
        error=1e-9,
        path=eigenaxis_turn,
    )


@register
def bilimoria_wie() -> KnownProblem:
    """Minimum-time reorientation of a sphere by half a turn; the eigenaxis takes 2 sqrt(pi) = 3.5449."""
    return KnownProblem(
        name="bilimoria-wie",
        title="half a turn of a sphere in least time, three independent torques",
        equations=(
            r"\text{minimise } T",
            r"\dot R = R\,\hat w, \quad \dot w = u, \quad R \in SO(3)",
            r"\lvert u_i\rvert \le 1",
        ),
        problem=OptimalControlProblem(
            RIGID, lambda q, u: (q[0] @ hat(q[1]), u), lambda q, u: 1.0, 3, control_bounds=(-1.0, 1.0)
        ),
        start=(IDENTITY, REST),
        end=(np.diag([-1.0, -1.0, 1.0]), REST),
        horizon=Free(4.0, lower=0.1),
        steps=60,
        method=cayley(RIGID),
        states={"R": "attitude, body to inertial frame", "w": "angular velocity, body frame"},
        controls={"u": "torque over inertia, body frame"},
        source="K. D. Bilimoria, B. Wie, Time-optimal three-axis reorientation of a rigid spacecraft, J. Guidance "
        "Control Dynam. 16, "
        "1993, 446-452",
        optimum=3.2430832774,
        digits=11,
        origin="bang-bang arcs with free switching times, on several meshes; published as 3.2431",
        accuracy=1e-9,
        error=1e-9,
    )
