r"""
Small satellite, closed loop
============================

A small satellite points its camera with four reaction wheels. A receding
horizon controller solves the optimal control problem ten times a second, from
noisy measurements. The wheels have ripple, and the satellite has another
inertia than the controller believes. With the wheel axes in the columns of
:math:`A`, the wheel momenta :math:`h` and the wheel torques :math:`u`:

.. math::

    \dot R = R\,\hat w, \qquad J\dot w + w \times (Jw + Ah) = -Au, \qquad
    \dot h = u, \qquad \lvert u_i\rvert \le 2\ \mathrm{mN\,m}

The body rate stays below 2.5 degrees per second, and the camera at least 25
degrees away from the Sun.
"""

# %%
# The satellite
# -------------
# The problem has no prescribed end: the cost penalizes the distance from the
# target, so that a plan exists from every state.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

J = np.array([120.0, 100.0, 70.0])  # mN m s^2, principal axes
AXES = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [0.8, 0.8, 0.8, 0.8]])
AXES = AXES / np.linalg.norm(AXES, axis=0)
TORQUE, RATE, CONE = 2.0, np.deg2rad(2.5), np.deg2rad(25)  # mN m, rad/s, rad
camera = np.array([1.0, 0.0, 0.0])  # body frame
target = Rotation.from_rotvec([0, 0, 120], degrees=True)
goal = target.as_matrix()
sun = Rotation.from_rotvec([0, 0, 55], degrees=True).apply([1, 0, 0.15])
sun /= np.linalg.norm(sun)
Q = rx.SO(3) * rx.Euclidean(3) * rx.Euclidean(4)  # R, w in rad/s, h in mN m s


def move(q, u, inertia):
    R, w, h = q
    spin = jnp.cross(w, inertia * w + AXES @ h)
    return R @ rx.hat(w), (-AXES @ u - spin) / inertia, u


def off_target(q):
    return 3 - jnp.trace(goal.T @ q[0])  # about the squared angle


problem = rx.OptimalControlProblem(
    Q,
    lambda q, u: move(q, u, J),
    lambda q, u: 20 * off_target(q) + 300 * q[1] @ q[1] + u @ u / 10,
    controls=4,
    terminal_cost=lambda q: 200 * off_target(q) + 2000 * q[1] @ q[1],
    control_bounds=(-TORQUE, TORQUE),
    constraints={
        "rate": lambda q, u: q[1] @ q[1] / RATE**2 - 1,
        "sun": lambda q, u: q[0] @ camera @ sun - np.cos(CONE),
    },
    labels={
        "states": ("attitude", "body rate", "wheel momenta"),
        "controls": "wheel torques",
    },
    units={
        "states": ("", "rad/s", "mN m s"),
        "controls": "mN m",
        "time": "s",
    },
)

# %%
# The controller
# --------------
# The limits of the rate and of the camera are soft: noise may lead to a state
# that violates them. Short steps come first.
SAMPLE = 0.1  # s
solver = rx.Solver(
    problem, rx.Gauss(2, rx.Cayley(Q)), steps=np.geomspace(0.1, 2.0, 12)
)
controller = rx.RecedingHorizon(
    solver,
    end=None,
    horizon=12.0,
    max_iterations=8,
    soft={"rate": 50.0, "sun": 1000.0},
    hold=SAMPLE,
)

# %%
# The loop
# --------
# The plant has 10 percent more and less inertia, and a ripple in the wheels.
# A star tracker errs by 20 arc seconds, a gyroscope by 0.002 degrees per
# second.
plant = rx.OptimalControlProblem(
    Q,
    lambda q, u, ripple: move(q, u + ripple, J * np.array([1.1, 0.9, 1.05])),
    lambda q, u: u @ u / 2,
    controls=4,
    control_bounds=(-TORQUE, TORQUE),
    labels=problem.quantities,
)


def measure(q, t, rng):
    R, w, h = q
    turn = Rotation.from_rotvec(rng.normal(size=3) * 20 / 3600, degrees=True)
    return R @ turn.as_matrix(), w + np.deg2rad(2e-3) * rng.normal(size=3), h


start = np.eye(3), np.zeros(3), np.array([3.0, -2.0, 1.0, 4.0])
loop = rx.simulate(
    plant,
    controller,
    start,
    horizon=75.0,
    sample_time=SAMPLE,
    parameters=lambda t, rng: 0.02 * rng.normal(size=4),
    measure=measure,
)
print(loop.solves)
loop.plot(degrees=True)

# %%
# The camera and the Sun, and the angle to the target:
R, w, h = loop.q
cone = np.rad2deg(np.arccos(R @ camera @ sun))
error = np.rad2deg((target.inv() * Rotation.from_matrix(R)).magnitude())
figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
axis.semilogy(loop.t, error, label="attitude to its target")
axis.semilogy(loop.t, cone, label="camera to the Sun")
axis.axhline(np.rad2deg(CONE), color="k", linestyle="--", label="limit")
axis.set(xlabel="time [s]", ylabel="angle [deg]")
axis.legend()

# %%
# The numbers
# -----------
# The wheels are inside the satellite: whatever the controller does, the total
# momentum in the inertial frame is constant.
own = J * np.array([1.1, 0.9, 1.05])
total = np.einsum("kij,kj->ki", R, w * own + h @ AXES.T)
drift = np.abs(total - total[0]).max()
fastest = np.rad2deg(np.linalg.norm(w, axis=1).max())
settled = error[loop.t > 65.0].max()
print(f"total momentum changes by {drift:.1e} mN m s")
print(f"at most {fastest:.2f} deg/s, at least {cone.min():.2f} deg to the Sun")
print(f"after 65 s at most {settled:.4f} deg to the target")
assert drift <= 1e-9
assert np.abs(loop.u).max() <= TORQUE
assert fastest <= 1.03 * np.rad2deg(RATE)
assert cone.min() >= 24.5
assert settled <= 0.1
assert loop.solves.fallbacks == 0

# sphinx_gallery_start_ignore
if "__file__" in globals():  # python examples/NAME.py [--output FOLDER]
    import sys
    from pathlib import Path

    default = Path(__file__).parent / "output"
    output = Path(sys.argv[2]) if sys.argv[1:2] == ["--output"] else default
    output.mkdir(parents=True, exist_ok=True)
    for number in plt.get_fignums():
        path = output / f"{Path(__file__).stem}_{number}.png"
        plt.figure(number).savefig(path, dpi=150)
        print(f"written: {path}")
# sphinx_gallery_end_ignore
