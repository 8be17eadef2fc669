r"""
Monte Carlo of slews
====================

Neither the spacecraft nor the target of a slew is known exactly. The moments of
inertia differ from the nominal ones by 3 %, and the target attitudes by 2
degrees about each axis (standard deviations, normal). A sweep solves 1000
optimal slews, and their percentiles say for which torque to build the wheels:

.. math::

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = u, \qquad
    \text{minimise } \tfrac12 \int \lvert u\rvert^2\,dt
"""

# %%
# The study
# ---------
# A ``Study`` has a solver, a function that returns the problems with given
# numbers, and a function that returns the results to keep.
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import retrax as rx
from retrax.sweeps import Study, sweep
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

J = np.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
TURN = Rotation.from_rotvec([50, 100, -100], degrees=True).as_matrix()
SPREAD = np.array([0.03] * 3 + [np.deg2rad(2)] * 3)  # relative inertia, rad
Q = rx.SO(3) * rx.Euclidean(3)  # attitude R, body rate w in rad/s
START = np.eye(3), np.zeros(3)


def dynamics(q, u, inertia):
    """Velocity of the attitude and of the body rate under the torque u."""
    R, w = q
    return R @ rx.hat(w), (u - jnp.cross(w, inertia * w)) / inertia


def cases(members):
    """The slews with these numbers."""
    generators = [np.random.default_rng([0, member]) for member in members]
    errors = SPREAD * np.stack([g.standard_normal(6) for g in generators])
    turns = TURN @ Rotation.from_rotvec(errors[:, 3:]).as_matrix()
    return {
        "starts": START,
        "ends": (turns, np.zeros(3)),
        "horizons": 60.0,
        "parameters": J * (1 + errors[:, :3]),
    }


def keep(solutions):
    """Largest torque in N m and rate in rad/s, and the second-order test."""
    rates = np.linalg.norm(solutions.states[1], axis=2)
    return {
        "torque": np.max(np.abs(solutions.controls), axis=(1, 2)),
        "rate": np.max(rates, axis=1),
        "minimum": [s.checks.strict_minimum for s in solutions],
    }


problem = rx.OptimalControlProblem(
    Q, dynamics, lambda q, u, inertia: u @ u / 2, controls=3
)
solver = rx.Solver(problem, rx.Midpoint(rx.Cayley(Q)), steps=30)


def study():
    """The study; in other processes each worker makes its own."""
    return Study(solver, cases, keep)


# %%
# The sweep
# ---------
# The sweep writes its results to a folder. A second call, or a call after an
# interruption, solves the missing slews only.
folder = tempfile.TemporaryDirectory()
found = sweep(study, 1000, folder.name)
files = list(Path(folder.name).rglob("*.npz"))
written = [file.stat().st_mtime_ns for file in files]
again = sweep(study, 1000, folder.name)
assert written == [file.stat().st_mtime_ns for file in files]
print(found)
assert found.complete
assert found.converged == again.kept["minimum"].sum() == 1000

# %%
# The percentiles
# ---------------
percent = 5, 50, 95, 99
print("percent           ", *(f"{p:8}" for p in percent))
torque, rate = found.kept["torque"], found.kept["rate"]
for name, values in {
    "cost [N^2 m^2 s]  ": found.cost,
    "peak torque [N m] ": torque,
    "peak rate [rad/s] ": rate,
}.items():
    print(name, *(f"{v:8.4g}" for v in np.percentile(values, percent)))

figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
axis.hist(torque, bins=40, alpha=0.6)
for p, value in zip(percent, np.percentile(torque, percent), strict=True):
    axis.axvline(value, color="C3")
    place = value, 1.01
    axis.annotate(f"{p} %", place, xycoords=("data", "axes fraction"))
axis.set(xlabel="largest torque on an axis [N m]", ylabel="slews")

# %%
# The first order
# ---------------
# The derivatives of the nominal extremal predict the standard deviation of the
# cost.


def cost(errors):
    """The optimal cost as a function of the errors."""
    end = TURN @ rx.Cayley(rx.SO(3))(jnp.eye(3), rx.hat(errors[3:]))
    inertia = J * (1 + errors[:3])
    ends = START, (end, jnp.zeros(3))
    return solver.extremal(*ends, 60.0, parameters=inertia).cost


nominal, slope = jax.value_and_grad(cost)(jnp.zeros(6))
linear = float(np.linalg.norm(slope * SPREAD))
deviation = np.std(found.cost, ddof=1)
print(f"deviation of the cost {deviation:.1f}, to first order {linear:.1f}")

figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
axis.hist(found.cost, bins=40, density=True, alpha=0.6, label="1000 slews")
costs = np.linspace(*axis.get_xlim(), 200)
normal = np.exp(-(((costs - nominal) / linear) ** 2) / 2)
normal /= linear * np.sqrt(2 * np.pi)
axis.plot(costs, normal, "k", label="to first order")
axis.set(xlabel="cost [N$^2$ m$^2$ s]", ylabel="density")
axis.legend()
# The deviation of 1000 samples is known to 1 / sqrt(2000), 2 percent.
assert abs(deviation / linear - 1) <= 0.08

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
