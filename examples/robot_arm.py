r"""
Robot arm in minimum time
=========================

A horizontal arm with two links moves a load from rest to rest in minimum time.
Each link is a uniform rod of 1 m and 1 kg, the load is 1 kg, and each motor
gives at most 1 N m. The joints turn on circles, so the configuration of the arm
is a point of a torus. With the directions :math:`A, B \in SO(2)` of the links,
their rates :math:`w` and the angle :math:`\varphi` of the elbow:

.. math::

    \text{minimise } T, \qquad
    \begin{pmatrix} 7/3 & \tfrac32 \cos\varphi \\
    \tfrac32 \cos\varphi & 4/3 \end{pmatrix} \dot w =
    \begin{pmatrix} u_1 - u_2 + \tfrac32 \sin\varphi\, w_2^2 \\
    u_2 - \tfrac32 \sin\varphi\, w_1^2 \end{pmatrix},
    \qquad \lvert u_i\rvert \le 1

The problem is from section 12.4.2 of R. Luus, *Iterative Dynamic Programming*,
2000.
"""

# %%
# The problem
# -----------
# The shoulder motor turns the upper arm with the torque :math:`u_1`. The elbow
# motor turns the forearm with :math:`u_2`, and its housing is on the upper arm.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import switching_structure
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

circle = rx.SO(2)
Q = circle * circle * rx.Euclidean(2)


def acceleration(cos, sin, w, u):
    mass = jnp.array([[7 / 3, 1.5 * cos], [1.5 * cos, 4 / 3]])
    turning = 1.5 * sin * jnp.array([w[1] ** 2, -(w[0] ** 2)])
    return jnp.linalg.solve(mass, jnp.array([u[0] - u[1], u[1]]) + turning)


def dynamics(q, u):
    A, B, w = q
    cos, sin = (A.T @ B)[:, 0]  # of the elbow
    turns = A @ circle.hat(w[:1]), B @ circle.hat(w[1:])
    return *turns, acceleration(cos, sin, w, u)


problem = rx.OptimalControlProblem(
    Q,
    dynamics,
    running_cost=lambda q, u: 1.0,
    controls=2,
    control_bounds=(-1.0, 1.0),
    labels={
        "states": ("upper arm", "forearm", ("upper arm rate", "forearm rate")),
        "controls": ("shoulder", "elbow"),
    },
    units={"states": ("", "", "rad/s"), "controls": "N m", "time": "s"},
)


def at_rest(shoulder, elbow):
    vectors = np.outer([shoulder, shoulder + elbow], [0, 0, 1])
    A, B = Rotation.from_rotvec(vectors).as_matrix()[:, :2, :2]
    return A, B, np.zeros(2)


# %%
# The published motion
# --------------------
# The arm turns by 0.522 rad. With an ``accuracy`` the switching times of the
# torques are nodes of the mesh.
horizon = rx.Free(3.0, lower=0.1)
short = rx.solve(
    problem, at_rest(0, 0.5), at_rest(0.522, 0.5), horizon, accuracy=1e-9
)
arcs = switching_structure(problem, short)
print(f"minimum time {short.horizon:.10f} s, torques of shoulder and elbow:")
print(arcs)

# %%
# The short way around
# --------------------
# The arm turns from -149 to 149 degrees, through 180 degrees, where an angle
# would jump. The directions of the links do not jump: the arm turns by 62
# degrees instead of 298. The picture shows the arm at equal intervals of time.
long = rx.solve(
    problem, at_rest(-2.6, 0.5), at_rest(2.6, 0.5), horizon, accuracy=1e-9
)


def elbow_and_load(times):
    A, B, _ = long(times).states
    return A[:, :, 0], A[:, :, 0] + B[:, :, 0]


figure, axis = plt.subplots(figsize=(6, 5.5), layout="constrained")
times = np.linspace(0, long.horizon, 13)
colours = plt.cm.ScalarMappable(plt.Normalize(0, long.horizon), "viridis_r")
for t, elbow, load in zip(times, *elbow_and_load(times), strict=True):
    arm = np.array([[0, 0], elbow, load])
    axis.plot(*arm.T, "o-", color=colours.to_rgba(t), linewidth=3)
loads = elbow_and_load(np.linspace(0, long.horizon, 200))[1]
axis.plot(*loads.T, color="C1", label="path of the load")
axis.plot(0, 0, "ks", markersize=12, label="base")
axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axis.legend(loc="lower right")
figure.colorbar(colours, ax=axis, label="time [s]")

# %%
# The directions of the links, their rates and the torques within their bounds:
figure, axes = plt.subplots(2, 2, figsize=(10, 6), layout="constrained")
rx.plotting.histories(long, ax=axes.flat, degrees=True)
axes[1, 0].set_ylabel("rates [deg/s]")
axes[1, 1].set_ylabel("torques [N m]")


# %%
# The numbers
# -----------
# SciPy integrates the angles of the arm under full torques with these switching
# times, and reaches the ends of both motions.
def end_error(solution, angles):
    def rates(t, x, u):
        elbow = x[1] - x[0]
        return *x[2:], *acceleration(np.cos(elbow), np.sin(elbow), x[2:], u)

    x, arcs = [*angles, 0, 0], switching_structure(problem, solution)
    for k, u in enumerate(arcs.sides):
        run = solve_ivp(
            rates, arcs.times[k : k + 2], x, args=(u,), rtol=1e-9, atol=1e-9
        )
        x = run.y[:, -1]
    A, B, w = (entry[-1] for entry in solution.states)
    turns = np.array([A[:, 0], B[:, 0]]) - np.c_[np.cos(x[:2]), np.sin(x[:2])]
    return max(np.max(np.abs(turns)), np.max(np.abs(x[2:] - w)))


errors = end_error(short, (0, 0.5)), end_error(long, (-2.6, -2.1))
print(f"times {short.horizon:.6f} s and {long.horizon:.6f} s")
print(f"errors at the ends {errors[0]:.0e} and {errors[1]:.0e}")
assert short.checks.strict_minimum
assert long.checks.strict_minimum
assert max(errors) <= 1e-6
assert abs(short.horizon - 2.98228) <= 5e-6

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
