r"""
Rest-to-rest slew
=================

A spacecraft turns by 150 degrees about :math:`(1, 2, -2)/3` in 60 seconds, from
rest to rest, with least torque. The attitude :math:`R` is a rotation matrix,
from the body frame to the inertial frame. The body rate :math:`w` and the
torque :math:`u` are in the body frame:

.. math::

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = u, \qquad
    \text{minimise } \tfrac12 \int_0^T \lvert u\rvert^2\,dt
    \qquad \text{on } SO(3) \times \mathbb R^3

The moments of inertia :math:`J` are those of the spacecraft in J. T. Betts,
*Practical Methods for Optimal Control and Estimation Using Nonlinear
Programming*, SIAM 2010, section 6.8.
"""

# %%
# The problem
# -----------
# Write the dynamics and the cost with ``jax.numpy``. The report and the figures
# use the labels and units.
import tempfile

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import discretization_error
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

J = jnp.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
Q = rx.SO(3) * rx.Euclidean(3)  # attitude R, body rate w in rad/s


def dynamics(q, u):
    """Velocity of the attitude and of the body rate under the torque u."""
    R, w = q
    return R @ rx.hat(w), (u - jnp.cross(w, J * w)) / J


problem = rx.OptimalControlProblem(
    Q,
    dynamics,
    running_cost=lambda q, u: u @ u / 2,
    controls=3,
    labels={"states": ("attitude", "body rate"), "controls": "torque"},
    units={
        "states": ("", "rad/s"),
        "controls": "N m",
        "time": "s",
        "cost": "N^2 m^2 s",
    },
)
turn = Rotation.from_rotvec([50, 100, -100], degrees=True)
start = np.eye(3), np.zeros(3)
end = turn.as_matrix(), np.zeros(3)

# %%
# The solution
# ------------
# A Gauss method with four stages has order 8, so 50 steps are plenty. The
# report states whether the trajectory is a local minimum.
method = rx.Gauss(4, rx.Cayley(Q))
solution = rx.solve(problem, start, end, horizon=60.0, method=method, steps=50)
solution.report()

# %%
# The figure shows the paths of the body axes on the sphere of directions, in
# the inertial frame:
rx.plotting.body_axes(solution)

# %%
# The attitude as a rotation vector, the body rate and the torque. The last
# panel shows the errors of the quantities that the continuous flow conserves:
figure, axes = plt.subplots(
    2, 2, figsize=(10, 7), sharex=True, layout="constrained"
)
rx.plotting.histories(solution, ax=axes.flat[:3])
rx.plotting.conserved(solution, ax=axes[1, 1])

# %%
# The error
# ---------
# The reference is the limit of the optimal costs as the steps shrink.
# ``discretization_error`` propagates the torque with an independent integrator.
REFERENCE = 2504.24655710  # N^2 m^2 s

difference = abs(solution.cost / REFERENCE - 1)
errors = discretization_error(problem, method.retraction, solution).largest
attitude, rate = errors.values()
print(f"relative difference of the cost: {difference:.1e}")
print(f"error of the attitude {attitude:.1e} rad, of the rate {rate:.1e} rad/s")
assert solution.checks.strict_minimum
assert solution.checks.manifold_violation <= 1e-13
assert difference <= 1e-11

# %%
# A file keeps the solution unchanged:
with tempfile.TemporaryDirectory() as folder:
    solution.save(f"{folder}/slew.npz")
    loaded = rx.load(f"{folder}/slew.npz")
assert np.array_equal(loaded.controls, solution.controls)

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
