r"""
Minimum-time reorientation
==========================

A rigid body with three equal moments of inertia turns by 180 degrees in minimum
time, from rest to rest, with at most a unit torque about each axis. The turn
about the third axis alone takes :math:`2\sqrt\pi = 3.545` units of time. The
optimal motion leaves this axis and takes 3.243:

.. math::

    \text{minimise } T, \qquad \dot R = R\,\hat w, \quad \dot w = u, \qquad
    \lvert u_i\rvert \le 1 \qquad \text{on } SO(3) \times \mathbb R^3

The problem is by K. D. Bilimoria and B. Wie, *Time-optimal three-axis
reorientation of a rigid spacecraft*, J. Guidance Control Dynam. 16, 1993.
"""

# %%
# The problem
# -----------
# With the running cost 1 the cost is the time. ``rx.Free(4.0)`` frees the
# final time, with the guess 4. With an ``accuracy``, retrax makes the switching
# times nodes of the mesh.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.integrators import switching_structure

jax.config.update("jax_enable_x64", True)

Q = rx.SO(3) * rx.Euclidean(3)  # attitude R, body rate w
problem = rx.OptimalControlProblem(
    Q,
    lambda q, u: (q[0] @ rx.hat(q[1]), u),
    running_cost=lambda q, u: 1.0,
    controls=3,
    control_bounds=(-1.0, 1.0),
    labels={"states": ("attitude", "body rate"), "controls": "torque"},
)
start = np.eye(3), np.zeros(3)
end = np.diag([-1.0, -1.0, 1.0]), np.zeros(3)
horizon = rx.Free(4.0, lower=0.1)
method = rx.Gauss(2, rx.Cayley(Q))
solution = rx.solve(
    problem, start, end, horizon, method=method, steps=60, accuracy=1e-9
)
print(solution.result)
print(f"minimum time {solution.horizon:.10f}")

# %%
# The torque
# ----------
# Each torque is at one of its bounds at all times. Together the three torques
# switch five times:
print(switching_structure(problem, solution))
rx.plotting.controls(solution)

# %%
# The third body axis leaves its place, although the turn is about this axis:
rx.plotting.body_axes(solution)

# %%
# The turn about one axis
# -----------------------
# With a torque about the third axis only, the state is the angle and the rate.
# The body accelerates for half of the time and brakes for the other half, so
# the angle is :math:`T^2/4` and the time :math:`2\sqrt\pi`:
one_axis = rx.OptimalControlProblem(
    rx.Euclidean(2),
    lambda q, u: jnp.stack([q[1], u[0]]),
    running_cost=lambda q, u: 1.0,
    controls=1,
    control_bounds=(-1.0, 1.0),
)
half_turn = np.zeros(2), np.array([np.pi, 0.0])
eigenaxis = rx.solve(one_axis, *half_turn, horizon, accuracy=1e-9)
print(f"about one axis {eigenaxis.horizon:.10f}")
print(f"saved {1 - solution.horizon / eigenaxis.horizon:.1%} of the time")
assert solution.checks.strict_minimum
assert abs(solution.horizon - 3.2431) <= 5e-5, "as published"
assert abs(eigenaxis.horizon - 2 * np.sqrt(np.pi)) <= 1e-8, "closed form"
assert switching_structure(problem, solution).arcs == 6

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
