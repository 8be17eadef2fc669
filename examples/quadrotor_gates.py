r"""
Quadrotor through gates
=======================

A quadrotor flies through three narrow gates, which are tilted by 45, -60 and 40
degrees. First a plan leads through the pose of each gate. Then a receding
horizon controller follows the plan at 50 Hz, from noisy measurements, in a wind
that it does not know, with a quadrotor that is heavier than it believes. With
the thrusts :math:`u`, their sum :math:`f`, their torques :math:`M u`, the body
rate :math:`w`, the velocity :math:`v` and the force :math:`d` of the wind:

.. math::

    \dot R = R\,\hat w, \quad J\dot w + w \times J w = M u, \quad
    \dot x = v, \quad m \dot v = f R e_3 - m g e_3 + d, \quad
    0 \le u_i \le 2.2\ \mathrm N

The model is that of Lee, Leok and McClamroch, *Geometric tracking control of a
quadrotor UAV on SE(3)* (2010), with the inertia of a vehicle of 0.5 kg.
"""

# %%
# The plan
# --------
# A gate is a pose: its axis x points through the gate, its axis y along the
# longer side. The argument ``through`` prescribes the pose at a time. The body
# rate and the velocity there are free.
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
Q = SE3 * rx.Euclidean(3) * rx.Euclidean(3)  # pose, body rate, velocity


def move(q, u, mass, wind):
    pose, w, v = q
    R = pose[:3, :3]
    twist = jnp.concatenate([w, R.T @ v])  # in the body frame
    turning = (M @ u - jnp.cross(w, J * w)) / J
    pull = R[:, 2] * u.sum() + wind
    return pose @ SE3.hat(twist), turning, pull / mass - gravity * np.eye(3)[2]


problem = rx.OptimalControlProblem(
    Q,
    lambda q, u: move(q, u, mass, np.zeros(3)),
    lambda q, u: (u - hover) @ (u - hover),
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


def gate(position, heading, roll):
    turn = Rotation.from_euler("ZYX", [heading, 0, roll], degrees=True)
    return np.asarray(SE3.pose(turn.as_matrix(), np.array(position)))


def still(*position):
    return gate(position, 0, 0), np.zeros(3), np.zeros(3)


gates = {
    1.0: gate([2.0, 0.3, 1.0], 0, 45),
    1.8: gate([3.6, 1.2, 1.5], 20, -60),
    2.8: gate([5.5, 0.5, 1.2], -20, 40),
}
method, DURATION = rx.Gauss(2, rx.Cayley(Q)), 4.0  # s
plan = rx.solve(
    problem,
    still(0, 0, 1),
    still(7.5, 0, 1),
    DURATION,
    method=method,
    steps=80,
    through={t: (pose, None, None) for t, pose in gates.items()},
)
print(f"plan: {plan.statistics.iterations} iterations, {plan.status}")

# %%
# The controller
# --------------
# The cost penalizes the deviation from the plan over the next half second. The
# weights belong to the rotation, the position, the body rate and the velocity.
SAMPLE = 0.02  # s
follow = rx.tracking(
    problem,
    plan,
    weights=np.repeat([100.0, 2000.0, 0.3, 20.0], 3),
    control_weights=2.0,
    outside="constant",
)
controller = rx.RecedingHorizon(
    rx.Solver(follow, method, steps=10),
    end=None,
    horizon=0.5,
    max_iterations=20,
    hold=SAMPLE,
)

# %%
# The flight
# ----------
# The quadrotor has 5 percent more mass than in the plan. The wind pushes with
# 0.25 N and gusts. The pose is measured to 5 mm and 0.3 degrees. The simulation
# waits for each solve, which takes longer than 20 ms in Python.
plant = rx.OptimalControlProblem(
    Q,
    lambda q, u, wind: move(q, u, 1.05 * mass, wind),
    lambda q, u: u @ u / 2,
    controls=4,
    control_bounds=(0.0, most),
    labels=problem.quantities,
)


def wind(t, rng):
    return np.array([0.15, -0.2, 0.0]) + 0.1 * rng.normal(size=3)


def measure(q, t, rng):
    pose, w, v = q
    turn = Rotation.from_rotvec(0.3 * rng.normal(size=3), degrees=True)
    R = pose[:3, :3] @ turn.as_matrix()
    x = pose[:3, 3] + 0.005 * rng.normal(size=3)
    noise = 0.02 * rng.normal(size=(2, 3))
    return SE3.pose(R, x), w + noise[0], v + noise[1]


loop = rx.simulate(
    plant,
    controller,
    still(0, 0, 1),
    horizon=DURATION,
    sample_time=SAMPLE,
    parameters=wind,
    measure=measure,
)
print(loop.solves)

# %%
# The gates are 70 cm wide and 40 cm high, and the centres of the rotors 34 cm
# apart. Picture: the plan, and the quadrotor every 0.1 s with the direction of
# its thrust.
WIDTH, HEIGHT = 0.70, 0.40  # m
rotors = 0.12 * np.array([[1, -1, 0], [-1, 1, 0], [-1, -1, 0], [1, 1, 0]])
corners = np.array([[0, y, z] for y, z in ((1, 1), (-1, 1), (-1, -1), (1, -1))])
corners = corners * [0, WIDTH / 2, HEIGHT / 2]
figure = plt.figure(figsize=(9, 4.5))
axis = figure.add_axes([-0.06, -0.45, 1.04, 1.9], projection="3d")
axis.plot(*plan.q[0][:, :3, 3].T, color="C0", linewidth=1)
for pose in loop.q[0][::5]:
    R, x = pose[:3, :3], pose[:3, 3]
    arms = x + rotors @ R.T
    axis.plot(*arms[:2].T, color="0.3", linewidth=2)
    axis.plot(*arms[2:].T, color="0.3", linewidth=2)
    axis.quiver(*x, *(0.25 * R[:, 2]), color="C3")
for pose in gates.values():
    frame = pose[:3, 3] + corners[[0, 1, 2, 3, 0]] @ pose[:3, :3].T
    axis.plot(*frame.T, color="C2", linewidth=3)
axis.set_aspect("equal")
axis.set(xlabel="x [m]", ylabel="y [m]", yticks=[0, 1], zticks=[1, 1.5])
axis.view_init(25, -50)

# %%
# The thrusts, with their bounds, and the distance from the plan:
figure, axes = plt.subplots(2, figsize=(8, 6), layout="constrained")
x = loop.q[0][:, :3, 3]
apart = np.linalg.norm(x - plan(loop.t).states[0][:, :3, 3], axis=1)
rx.plotting.controls(loop, ax=axes[0])
axes[0].set_ylabel("thrust [N]")
axes[1].plot(loop.t, 100 * apart)
axes[1].set(xlabel="time [s]", ylabel="distance from the plan [cm]")
for t in gates:
    axes[1].axvline(t, color="C2", linestyle="--")

# %%
# The numbers
# -----------
# Each rotor passes the plane of a gate within its opening.


def margins(pose):
    """Least distance of the rotors from the sides of a gate, in m."""
    R, centre = pose[:3, :3], pose[:3, 3]
    at = np.einsum("kij,rj->kri", loop.q[0][:, :3, :3], rotors) + x[:, None]
    X, Y, Z = np.moveaxis((at - centre) @ R, -1, 0)
    k, rotor = np.nonzero((X[:-1] < 0) & (X[1:] >= 0))
    part = X[k, rotor] / (X[k, rotor] - X[k + 1, rotor])
    y, z = (
        a[k, rotor] + part * (a[k + 1, rotor] - a[k, rotor]) for a in (Y, Z)
    )
    assert len(set(rotor)) == len(rotors)
    return min(np.min(WIDTH / 2 - abs(y)), np.min(HEIGHT / 2 - abs(z)))


left = [margins(pose) for pose in gates.values()]
print("distance of the rotors from the sides:", np.round(left, 3), "m")
print(f"at most {100 * apart.max():.1f} cm from the plan")
assert plan.checks.strict_minimum
assert min(left) > 0
assert apart.max() <= 0.12
assert loop.u.min() >= 0
assert loop.u.max() <= most
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
