r"""
Receding horizon
================

A controller measures the state of a spacecraft every 3 seconds, solves the
optimal control problem from there, and applies the first 3 seconds of the plan.
The last plan starts the next solve. An unknown torque :math:`d` disturbs the
body, and torque and rate are limited:

.. math::

    \text{minimise } \tfrac12 \int_t^{t+T} \lvert u\rvert^2\,d\tau, \qquad
    \dot R = R\,\hat w, \quad J\dot w + w \times Jw = u

.. math::

    \lvert u_i\rvert \le 8\ \mathrm{N\,m}, \qquad
    \lvert w\rvert \le 3^\circ/\mathrm s

The end of each plan is the target attitude at rest. The horizon :math:`T`
shrinks from 75 to 20 seconds, then it recedes.
"""

# %%
# The plan
# --------
# A ``Solver`` traces the problem once. The first plan needs more iterations
# than the plans that start from an earlier plan.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

J = np.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
TORQUE, RATE = 8.0, np.deg2rad(3.0)  # N m, rad/s
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
    control_bounds=(-TORQUE, TORQUE),
    constraints={"rate": lambda q, u: q[1] @ q[1] / RATE**2 - 1},
)
solver = rx.Solver(problem, rx.Gauss(2, rx.Cayley(Q)), steps=30)
start = np.eye(3), np.zeros(3)
target = Rotation.from_rotvec([50, 100, -100], degrees=True)
end = target.as_matrix(), np.zeros(3)
first = solver.solve(start, end, 75.0)
print(f"first plan: {first.statistics.iterations} iterations")

# %%
# The body
# --------
# SciPy simulates the body, with the disturbance, from quaternions. The
# actuators saturate at 8 N m.
DISTURBANCE = np.array([0.3, -0.2, 0.2])  # N m


def simulate(state, plan, begin, end):
    """The state after the torques of a plan between two of its times."""

    def velocity(t, x):
        q, w = x[:4], x[4:]
        u = np.clip(plan(t).controls, -TORQUE, TORQUE) + DISTURBANCE
        spin = np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w) / 2
        return np.append(spin, (u - np.cross(w, J * w)) / J)

    x = np.append(Rotation.from_matrix(state[0]).as_quat(), state[1])
    x = solve_ivp(velocity, (begin, end), x, rtol=1e-8, atol=1e-10).y[:, -1]
    return Rotation.from_quat(x[:4]).as_matrix(), x[4:]


def error(state):
    """Angle to the target in degrees."""
    away = target.inv() * Rotation.from_matrix(state[0])
    return np.rad2deg(away.magnitude())


# %%
# The loop
# --------
# ``plan.guess(after=3.0)`` is the rest of the last plan.
PERIOD = 3.0  # s
times = PERIOD * np.arange(1, 41)
state, plan, closed, iterations = start, first, [], []
for t in times:
    state = simulate(state, plan, 0.0, PERIOD)
    closed.append(state)
    horizon, guess = max(75.0 - t, 20.0), plan.guess(after=PERIOD)
    plan = solver.solve(state, end, horizon, guess=guess)
    iterations.append(plan.statistics.iterations)
print(f"median of the iterations with a warm start: {np.median(iterations):g}")

# %%
# The same disturbance without a controller: the torques of the first plan.
state, opened = start, []
for t in times[times <= 75.0]:
    state = simulate(state, first, t - PERIOD, t)
    opened.append(state)

figure, (left, right) = plt.subplots(
    1, 2, figsize=(10, 4), layout="constrained"
)
for name, states in {"receding horizon": closed, "first plan": opened}.items():
    rates = [np.rad2deg(np.linalg.norm(w)) for _, w in states]
    left.semilogy(times[: len(states)], [error(x) for x in states], label=name)
    right.plot(times[: len(states)], rates, label=name)
left.set(xlabel="time [s]", ylabel="angle to the target [deg]")
right.set(xlabel="time [s]", ylabel="rate [deg/s]")
right.axhline(np.rad2deg(RATE), color="k", linestyle="--", label="limit")
right.legend()

# %%
# The offset
# ----------
# The controller does not know the disturbance, so a small angle remains. Near
# the target each axis is a double integrator, whose plan is a cubic polynomial.
# One period takes the angle and rate :math:`z` of an axis to
# :math:`A z + (P^2/2, P)\,d/J`. The fixed point is the offset:
s, T = PERIOD / 20.0, 20.0
A = np.array(
    [
        [1 - 3 * s**2 + 2 * s**3, T * (s - 2 * s**2 + s**3)],
        [6 * (s**2 - s) / T, 1 - 4 * s + 3 * s**2],
    ]
)
offset = np.linalg.solve(np.eye(2) - A, [PERIOD**2 / 2, PERIOD])[0]
offset = np.rad2deg(offset * np.linalg.norm(DISTURBANCE / J))
fastest = max(np.linalg.norm(w) for _, w in closed)
print(f"angle to the target: {error(opened[-1]):.2f} degrees without feedback")
print(f"with feedback {error(closed[-1]):.4f}, linear theory {offset:.4f}")
print(f"largest measured rate: {np.rad2deg(fastest):.3f} deg/s")
assert np.median(iterations) <= 5 < first.statistics.iterations
assert abs(error(closed[-1]) / offset - 1) <= 0.01
assert fastest <= 1.01 * RATE

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
