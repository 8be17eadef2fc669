r"""
Quadrotor flip
==============

A quadrotor of 0.5 kg flies 3 m forward, 1 m aside and 1 m up in 1.4 s, from
hover to hover, and makes a flip on the way. Each of the four rotors pushes with
0 to 2.2 N. The pose is a point of :math:`SE(3)`, so no attitude is singular,
not even upside down. With the thrusts :math:`u`, their sum :math:`f`, their
torques :math:`M u`, the body rate :math:`w` and the velocity :math:`v`:

.. math::

    \text{minimise } \int_0^T \lvert u - \bar u\rvert^2\,dt, \qquad
    \dot R = R\,\hat w, \quad J\dot w + w \times J w = M u, \qquad
    \dot x = v, \quad m \dot v = f R e_3 - m g e_3

At hover each rotor pushes with :math:`\bar u = m g / 4 = 1.226` N.
"""

# %%
# The problem
# -----------
# The rotors are 17 cm from the centre, at 45 degrees to the body axes x and y.
# Opposite rotors turn in the same sense and neighbours in opposite senses, so
# differences of the thrusts turn the body about the axis z too.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

mass, gravity = 0.5, 9.81  # kg, m/s^2
J = jnp.array([0.0023, 0.0023, 0.004])  # kg m^2
signs = [[-1, -1, 1, 1], [-1, 1, 1, -1], [1, -1, 1, -1]]
M = np.array([[0.12], [0.12], [0.016]]) * signs  # torques of 1 N, N m
hover, most = mass * gravity / 4, 2.2  # N

SE3 = rx.SE(3)
Q = SE3 * rx.Euclidean(3) * rx.Euclidean(3)


def dynamics(q, u):
    pose, w, v = q
    R = pose[:3, :3]
    twist = jnp.concatenate([w, R.T @ v])  # in the body frame
    turning = (M @ u - jnp.cross(w, J * w)) / J
    falling = jnp.array([0, 0, -gravity])
    return pose @ SE3.hat(twist), turning, R[:, 2] * u.sum() / mass + falling


problem = rx.OptimalControlProblem(
    Q,
    dynamics,
    running_cost=lambda q, u: (u - hover) @ (u - hover),
    controls=4,
    control_bounds=(0.0, most),
    labels={
        "states": ("pose", "body rate", "velocity"),
        "controls": ("front right", "back right", "back left", "front left"),
    },
    units={
        "states": ("m", "rad/s", "m/s"),
        "controls": "N",
        "time": "s",
        "cost": "N^2 s",
    },
)

# %%
# The flip
# --------
# Without a guess the quadrotor flies without a flip. A guess through two more
# poses, nose down by 120 and by 240 degrees, leads to the flip. The attitude
# returns to where it was: the turn of 360 degrees is in the path alone.
target = np.array([3.0, 1.0, 1.0])


def still(share, degrees=0):
    turn = Rotation.from_rotvec([0, np.deg2rad(degrees), 0]).as_matrix()
    return SE3.pose(turn, share * target), np.zeros(3), np.zeros(3)


solver = rx.Solver(problem, rx.Gauss(3, rx.Cayley(Q)), 80)
plain = solver.solve(still(0), still(1), 1.4)
way = still(0), still(1 / 3, 120), still(2 / 3, 240), still(1)
guess = rx.Guess.from_waypoints(problem, solver.method, way, 80)
flip = solver.solve(still(0), still(1), 1.4, guess=guess)
flip.report()

# %%
# The quadrotor every 0.1 s, twice as large as it is, with the direction of its
# thrust:
figure = plt.figure(figsize=(9, 4.5))
axis = figure.add_axes([-0.05, -0.58, 1.08, 2.16], projection="3d")
rx.plotting.path(flip, frames=1, ax=axis)
corners = 0.24 * np.array([[1, -1, 0], [-1, 1, 0], [-1, -1, 0], [1, 1, 0]])
for pose in flip(np.arange(0, 1.41, 0.1)).states[0]:
    R, x = pose[:3, :3], pose[:3, 3]
    arms = x + corners @ R.T
    axis.plot(*arms[:2].T, color="0.3", linewidth=2)
    axis.plot(*arms[2:].T, color="0.3", linewidth=2)
    axis.quiver(*x, *(0.4 * R[:, 2]), color="C3")
axis.view_init(15, -75)

# %%
# The body rate and the thrusts, which stay within their bounds:
figure, axes = plt.subplots(2, figsize=(8, 6), layout="constrained")
rx.plotting.state(flip, array=1, ax=axes[0], degrees=True)
rx.plotting.controls(flip, ax=axes[1]).set_ylabel("thrust [N]")

# %%
# The numbers
# -----------
# IPOPT solves the flip with unit quaternions instead of rotation matrices, by
# Gauss collocation of the same order with 120 steps, and finds the same cost.
IPOPT = 2.177494  # N^2 s
fastest = np.rad2deg(np.abs(flip.q[1]).max())
print(f"cost {flip.cost:.6f} N^2 s, without the flip {plain.cost:.6f} N^2 s")
print(f"largest body rate {fastest:.0f} deg/s")
assert flip.checks.strict_minimum
assert flip.controls.min() >= 0
assert flip.controls.max() <= most
assert abs(flip.cost / IPOPT - 1) <= 1e-6

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
