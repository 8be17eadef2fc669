r"""
Robot arm from URDF
===================

A robot arm of seven joints reaches from one pose to another in 0.9 s, from rest
to rest, with little torque. The library `frax <https://pypi.org/project/frax>`_
reads the arm from its URDF file and has its dynamics as JAX functions. With the
joint angles :math:`\theta`, the rates :math:`w`, the mass matrix :math:`M` and
the bias :math:`b`, which holds gravity and the Coriolis terms:

.. math::

    \text{minimise } \int_0^T \sum_i (\tau_i / \tau_i^{\max})^2
    + 10^{-3} u_i^2\,dt, \qquad
    \dot\theta = w, \quad \dot w = u, \qquad
    \tau = M(\theta)\, u + b(\theta, w)

The controls :math:`u` are the accelerations of the joints. The torques follow
from them by inverse dynamics. This is the same problem as with the torques as
controls, and its functions are shorter.
"""

# %%
# The problem
# -----------
# ``pip install "retrax[bodies]"`` installs frax, which includes the URDF file
# of the Franka Emika Panda. The motors may use 70 percent of their largest
# torques. A small part of the cost keeps the accelerations low. ``jax.jit``
# makes JAX trace the function of frax once, not at each call.
import warnings

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx

warnings.filterwarnings("ignore", r"\[frax\]")  # advice on settings of JAX
from frax.assets import FRANKA_ASSETS_DIR
from frax.core.robot import Robot

jax.config.update("jax_enable_x64", True)

robot = Robot(FRANKA_ASSETS_DIR / "panda.urdf")
most = robot.actuated_joint_max_forces  # N m
fastest = robot.actuated_joint_max_velocities  # rad/s
names = tuple(f"joint {k}" for k in range(1, 8))
weight = jnp.array([0, 0, 9.81, 0, 0, 0])  # m/s^2, spatial
Q = rx.Euclidean(7) * rx.Euclidean(7)


@jax.jit
def torque(angles, rates, accelerations):
    return robot.rnea(angles, rates, accelerations, weight, None)


def load(q, u):
    return torque(*q, u) / most


def cost(q, u):
    share = load(q, u)
    return share @ share + 1e-3 * u @ u


def within(share, limit):
    return jnp.concatenate([share - limit, -limit - share])


problem = rx.OptimalControlProblem(
    Q,
    lambda q, u: (q[1], u),
    running_cost=cost,
    controls=7,
    constraints={
        "torque": lambda q, u: within(load(q, u), 0.7),
        "rate": lambda q, u: within(q[1] / fastest, 1.0),
    },
    labels={"states": (names, tuple(f"rate {k}" for k in range(1, 8)))},
    units={
        "states": ("rad", "rad/s"),
        "controls": "rad/s^2",
        "time": "s",
        "cost": "s",
    },
)

# %%
# The motion
# ----------
# The arm turns by 80 degrees about its vertical axis and stretches out.
T = 0.9  # s
start = np.array([0, -np.pi / 6, 0, -3 * np.pi / 4, 0, 5 * np.pi / 9, 0])
end = np.array([1.4, 0.9, 0, -1, 0, 1.9, 0.8])
still = np.zeros(7)
solver = rx.Solver(problem, rx.Gauss(2, rx.Cayley(Q)), 30)
motion = solver.solve((start, still), (end, still), T)
motion.report()

# %%
# The arm every 0.1 s, from its base to its hand:
figure = plt.figure(figsize=(7, 6), layout="constrained")
axis = figure.add_subplot(projection="3d")
colours = plt.cm.ScalarMappable(plt.Normalize(0, T), "viridis_r")
places = jax.jit(jax.vmap(robot.joint_to_world_transforms))
times = np.linspace(0, T, 10)
for t, poses in zip(times, places(motion(times).states[0]), strict=True):
    hand = poses[-1, :3, 3] + 0.21 * poses[-1, :3, 2]
    arm = np.vstack([np.zeros(3), poses[:, :3, 3], hand])
    axis.plot(*arm.T, "o-", color=colours.to_rgba(t), linewidth=3)
axis.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", aspect="equal")
axis.view_init(20, -110)
figure.colorbar(colours, ax=axis, label="time [s]")

# %%
# Torques and rates relative to what the motors give. The second joint carries
# the arm and reaches its limit.
times = np.linspace(0, T, 181)
(angles, rates), accelerations = motion(times)[1:3]
torques = np.array(jax.vmap(torque)(angles, rates, accelerations))
figure, axes = plt.subplots(
    2, figsize=(8, 6), sharex=True, layout="constrained"
)
axes[0].plot(times, torques / most, label=names)
axes[1].plot(times, rates / fastest)
axes[0].set_ylabel("torque / largest torque")
axes[1].set(ylabel="rate / largest rate", xlabel="time [s]")
figure.legend(ncols=4, loc="outside upper center")  # beside the curves


# %%
# The numbers
# -----------
# Two other formulas judge the torques. The forward dynamics of frax solve with
# the mass matrix, and return the accelerations. The work of the motors is the
# change of the potential energy.
(angles, rates), u = motion.stage_states, motion.controls
torques = np.array(jax.vmap(torque)(angles, rates, u))
forward = jax.vmap(lambda *x: robot.forward_dynamics(*x, None))
error = np.abs(forward(angles, rates, torques) - u).max()
work = np.sum(rates * torques) * T / len(u)  # stages have equal weights
centres = [robot.link_com_positions(x)[:, 2] for x in (start, end)]
lift = 9.81 * robot.link_masses @ np.array(centres[1] - centres[0])
share = np.abs(torques / most).max()
print(f"torque at most {share:.4f} of the largest, cost {motion.cost:.5f} s")
print(f"accelerations to {error:.0e} rad/s^2")
print(f"work {work:.3f} J, potential energy {lift:.3f} J")
assert motion.success
assert share <= 0.7 + 1e-7
assert error <= 1e-8
assert abs(work - lift) <= 3e-3

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
