r"""
Keep-out cone
=============

A spacecraft turns by 120 degrees in 60 seconds, from rest to rest. The direct
way would point its instrument, which looks along the first body axis, too close
to the Sun. The instrument keeps 25 degrees away from the direction :math:`s` of
the Sun, and each torque is at most 8 N m:

.. math::

    \text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt, \qquad
    \dot R = R\,\hat w, \quad J\dot w + w \times Jw = u

.. math::

    \langle s, R\,e_1\rangle \le \cos 25^\circ, \qquad
    \lvert u_i\rvert \le 8\ \mathrm{N\,m}
"""

# %%
# The problem
# -----------
# The first column of ``R`` is the direction of the instrument, in the inertial
# frame. A constraint is a function that is negative where the state is allowed.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

J = np.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
Q = rx.SO(3) * rx.Euclidean(3)  # attitude R, body rate w in rad/s
SUN = np.array([0.5, 0.866, 0.1]) / np.linalg.norm([0.5, 0.866, 0.1])
CONE = np.deg2rad(25)
LIMIT = 8.0  # N m


def dynamics(q, u):
    """Velocity of the attitude and of the body rate under the torque u."""
    R, w = q
    return R @ rx.hat(w), (u - jnp.cross(w, J * w)) / J


def slew(**limits):
    """The slew with least torque under some limits."""
    problem = rx.OptimalControlProblem(
        Q,
        dynamics,
        running_cost=lambda q, u: u @ u / 2,
        controls=3,
        labels={"states": ("attitude", "body rate"), "controls": "torque"},
        units={"states": ("", "rad/s"), "controls": "N m", "time": "s"},
        **limits,
    )
    start = np.eye(3), np.zeros(3)
    turn = Rotation.from_rotvec([0, 0, 120], degrees=True)
    end = turn.as_matrix(), np.zeros(3)
    method = rx.Gauss(3, rx.Cayley(Q))
    return rx.solve(
        problem, start, end, 60.0, method=method, steps=60, accuracy=1e-6
    )


direct = slew()
around = slew(
    constraints={"Sun": lambda q, u: SUN @ q[0][:, 0] - np.cos(CONE)},
    control_bounds=(-LIMIT, LIMIT),
)
print(around.result)

# %%
# The path of the instrument
# --------------------------
# The path of the first body axis touches the cone and goes on. The default
# guess is the direct way, which crosses the cone:
rx.plotting.body_axes(around, cones=[(SUN, CONE)]).view_init(25, 60)

# %%
# The torques, with their bounds:
rx.plotting.controls(around)

# %%
# The numbers
# -----------
# The reference is the cost that CasADi and IPOPT find with quaternions and 240
# steps of the classical Runge-Kutta method.
REFERENCE = 1876.5728  # N^2 m^2 s

for name, solution in {"direct": direct, "around": around}.items():
    angles = np.rad2deg(np.arccos(solution.states[0][:, :, 0] @ SUN))
    print(
        f"{name}: cost {solution.cost:.3f}, torque at most "
        f"{np.abs(solution.controls).max():.4f} N m, the instrument comes to "
        f"{angles.min():.3f} degrees from the Sun"
    )
assert around.checks.strict_minimum
assert abs(around.cost / REFERENCE - 1) <= 1e-4
assert angles.min() >= 25 - 1e-2
assert np.abs(around.controls).max() <= LIMIT * (1 + 1e-9)

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
