r"""
Attitude and gyroscope bias
===========================

A star tracker measures the attitude of a satellite every two seconds, and a
gyroscope its rate, with a bias :math:`b` that nobody knows. The estimate is
the most likely trajectory: the least sum of a cost at the nodes for the errors
of the measurements, and a running cost for the disturbing torques. With the
spectral density :math:`S` of the angular acceleration :math:`u`:

.. math::

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = Ju, \qquad
    \min \int \frac{\lvert u\rvert^2}{2S}\,dt + \sum_k
    \frac{\lVert R_k - Y_k\rVert^2}{4\sigma_R^2}
    + \frac{\lvert w_k + b - y_k\rvert^2}{2\sigma_w^2}

The solver also returns the covariance of the estimate. A Monte Carlo of 300
runs shows that it is right.
"""

# %%
# The problem
# -----------
# The node cost takes the state, the index of the node, and the parameters,
# which hold the measurements. The bias is a free parameter.
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

jax.config.update("jax_enable_x64", True)

J = np.array([120.0, 100.0, 70.0])  # kg m^2, principal axes
TRACKER, GYRO = 1e-4, np.deg2rad(0.01)  # rad, rad/s, standard deviations
DENSITY = 1e-11  # S, rad^2/s^3
BIAS = np.deg2rad([0.05, -0.03, 0.02])  # rad/s
STEPS, HORIZON, RUNS = 30, 60.0, 300
Q = rx.SO(3) * rx.Euclidean(3)  # attitude R, body rate w in rad/s


def dynamics(q, u, given):
    R, w = q
    return R @ rx.hat(w), u - jnp.cross(w, J * w) / J


def running_cost(q, u, given):
    return u @ u / (2 * DENSITY)


def node_cost(q, k, given):
    R, w = q
    turn = R - given["tracker"][k]  # its norm is sqrt(2) times the angle
    rate = w + given["bias"] - given["gyro"][k]
    return jnp.sum(turn**2) / (4 * TRACKER**2) + rate @ rate / (2 * GYRO**2)


problem = rx.OptimalControlProblem(
    Q,
    dynamics,
    running_cost,
    controls=3,
    node_cost=node_cost,
    labels={"states": ("attitude", "body rate"), "controls": "disturbance"},
    units={"states": ("", "rad/s"), "controls": "rad/s^2", "time": "s"},
)
solver = rx.Solver(problem, rx.Gauss(2, rx.Cayley(Q)), steps=STEPS)
print(problem)

# %%
# The runs
# --------
# Each run has its own disturbance, which is constant over a fifth of a second,
# and its own errors of the measurements.
rng = np.random.default_rng(0)
PARTS = 10  # of a step
h = HORIZON / STEPS / PARTS
R = np.broadcast_to(np.eye(3), (RUNS, 3, 3))
w = np.broadcast_to(np.deg2rad([1.0, 0.4, -0.6]), (RUNS, 3))


def acceleration(w, u):
    return u - np.cross(w, J * w) / J


attitudes, rates = [R], [w]
for _ in range(STEPS):
    for _ in range(PARTS):
        u = np.sqrt(DENSITY / h) * rng.normal(size=(RUNS, 3))
        middle = w + h / 2 * acceleration(w, u)
        turn = Rotation.from_rotvec(h * middle).as_matrix()
        R, w = R @ turn, w + h * acceleration(middle, u)
    attitudes.append(R)
    rates.append(w)
attitudes, rates = np.stack(attitudes, axis=1), np.stack(rates, axis=1)
errors = rng.normal(size=(2, RUNS, STEPS + 1, 3))
turns = Rotation.from_rotvec(TRACKER * errors[0].reshape(-1, 3)).as_matrix()
tracker = attitudes @ turns.reshape(attitudes.shape)
gyro = rates + BIAS + GYRO * errors[1]

# %%
# One estimate
# ------------
# The start is free, and the guess turns through the measured attitudes.
found = solver.solve(
    (rx.Free(tracker[0, 0]), rx.Free(gyro[0, 0])),
    None,
    HORIZON,
    parameters={
        "tracker": tracker[0],
        "gyro": gyro[0],
        "bias": rx.Free(np.zeros(3)),
    },
)
covariance = solver.covariance(found)
sigma = np.sqrt(np.diag(covariance.parameters))
print(found.status, "in", found.statistics.iterations, "iterations")
print("bias [deg/s]      ", np.rad2deg(found.parameters["bias"]).round(5))
print("standard deviation", np.rad2deg(sigma).round(5))

# %%
# The Monte Carlo
# ---------------
# ``solve_many`` estimates all runs side by side.
many = solver.solve_many(
    (rx.Free(tracker[:, 0]), rx.Free(gyro[:, 0])),
    None,
    HORIZON,
    parameters={
        "tracker": tracker,
        "gyro": gyro,
        "bias": rx.Free(np.zeros((RUNS, 3))),
    },
)
assert np.all(many.success)
print(f"{many.success.sum()} of {RUNS} estimates converged")

# %%
# The errors of the bias, beside the covariance of the first run: it hardly
# depends on the data.
biases = np.stack([run.parameters["bias"] for run in many]) - BIAS
ratio = biases.std(axis=0, ddof=1) / sigma
print("errors / standard deviation", ratio.round(3))
# The deviation of 300 samples is known to 1 / sqrt(600), 4 percent.
assert np.all(np.abs(ratio - 1) <= 4 / np.sqrt(2 * RUNS))

# %%
# All errors together
# -------------------
# The errors of the attitude, the rate and the bias at a node, in the frame of
# the manifold there. Their sum of squares over the covariance is distributed
# like chi-squared with nine degrees of freedom. In the frame of SO(3) a
# rotation vector of the body has coordinates that are sqrt(2) times its own.
normalized = []
for node in (0, STEPS // 2, STEPS):
    R, w = (part[:, node] for part in many.states)
    apart = Rotation.from_matrix(R.mT @ attitudes[:, node]).as_rotvec()
    error = np.hstack([np.sqrt(2) * apart, rates[:, node] - w, -biases])
    cross = covariance.cross[node]
    whole = np.block(
        [[covariance.states[node], cross], [cross.T, covariance.parameters]]
    )
    squares = np.sum(error * np.linalg.solve(whole, error.T).T, axis=1)
    print(
        f"node {node:2}: mean {squares.mean():.2f}, expected {error.shape[1]}"
    )
    # The mean of 300 samples has the standard deviation sqrt(2 * 9 / 300).
    assert abs(squares.mean() - 9) <= 4 * np.sqrt(2 * 9 / RUNS)
    normalized.append(squares)

figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
squares = np.concatenate(normalized)
axes[0].hist(squares, bins=40, density=True, alpha=0.6, label="estimates")
values = np.linspace(0.0, 30.0, 200)
axes[0].plot(values, chi2(9).pdf(values), "k", label="chi-squared")
axes[0].set(xlabel="squares of errors over covariance", ylabel="density")
axes[0].legend()
turn = Rotation.from_matrix(many.states[0][0].mT @ attitudes[0]).as_rotvec()
axes[1].plot(found.t, np.rad2deg(turn) * 3600, label=["x", "y", "z"])
band = np.sqrt(np.diagonal(covariance.states[:, :3, :3], axis1=1, axis2=2) / 2)
largest = 3 * np.rad2deg(band.max(axis=1)) * 3600
shade = {"color": "k", "alpha": 0.15, "label": "3 sigma"}
axes[1].fill_between(found.t, -largest, largest, **shade)
axes[1].set(xlabel="time [s]", ylabel="attitude error [arcsec]")
axes[1].legend(ncols=4, loc="upper center")

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
