r"""Monte Carlo of slews

What a slew takes when neither the spacecraft nor the target is known for sure: 1000 optimal slews, and their
percentiles.

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = u, \qquad \text{minimise } \tfrac12 \int \lvert u\rvert^2\,dt

Each spacecraft has an inertia of its own, off by 3 % on each axis, and a target attitude off by 2 degrees about each
axis (standard deviations, normal), and is slewed in the way that is optimal for it: what torque must the wheels be
built for? A sweep solves them into a folder, from which it goes on when it is interrupted, here or in processes of
their own. Checked are that each slew is a strict local minimum, that a second call solves nothing again, and that the
standard deviation of the cost is the one to first order, by the derivatives of the nominal extremal.

    python examples/monte_carlo_slew.py [--samples 1000] [--workers 0] [--output examples/output]
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Cayley, Midpoint
from retrax.sweeps import Study, sweep
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

INERTIA = np.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
TARGET = Rotation.from_rotvec(np.deg2rad(150) * np.array([1.0, 2.0, -2.0]) / 3).as_matrix()
HORIZON, STEPS = 60.0, 30  # s
SPREAD = np.array([0.03] * 3 + [np.deg2rad(2)] * 3)  # of the relative inertia, and of the target about the body axes
PERCENT = (5, 50, 95, 99)
Q = SO(3) * Euclidean(3)  # attitude R (body to inertial frame), body rate w in rad/s
START = np.eye(3), np.zeros(3)


def dynamics(q, u, inertia):
    """Velocity of the attitude and of the body rate under a torque u in the body frame, N m."""
    attitude, rate = q
    return attitude @ hat(rate), (u - jnp.cross(rate, inertia * rate)) / inertia


def cases(members):
    """The slews with these numbers."""
    errors = SPREAD * np.stack([np.random.default_rng([0, member]).standard_normal(6) for member in members])
    ends = TARGET @ Rotation.from_rotvec(errors[:, 3:]).as_matrix(), np.zeros(3)
    return {"starts": START, "ends": ends, "horizons": HORIZON, "parameters": INERTIA * (1 + errors[:, :3])}


def keep(solutions):
    """The largest torque on an axis, N m, the largest rate, rad/s, and whether the slew is a strict local minimum."""
    return {
        "torque": np.max(np.abs(solutions.controls), axis=(1, 2)),
        "rate": np.max(np.linalg.norm(solutions.states[1], axis=2), axis=1),
        "minimum": [solution.checks.strict_minimum for solution in solutions],
    }


def study():
    """The solver, its cases and what is kept: made once in each worker."""
    problem = OptimalControlProblem(Q, dynamics, running_cost=lambda q, u, inertia: u @ u / 2, controls=3)
    return Study(Solver(problem, Midpoint(Cayley(Q)), STEPS), cases, keep)


def linear_deviation():
    """The standard deviation of the cost to first order in the errors, and the nominal cost, N^2 m^2 s."""
    solver = study().solver

    def cost(errors):
        end = TARGET @ Cayley(SO(3))(jnp.eye(3), hat(errors[3:])), jnp.zeros(3)
        return solver.extremal(START, end, HORIZON, parameters=INERTIA * (1 + errors[:3])).cost

    value, slope = jax.value_and_grad(cost)(jnp.zeros(6))
    return float(np.linalg.norm(slope * SPREAD)), float(value)


def plot(found, nominal, deviation, path):
    """Histograms of the cost, with what the first order says of it, and of the peak torque, with their percentiles."""
    figure, panels = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained")
    names = {"cost": "N$^2$ m$^2$ s", "largest torque on an axis": "N m"}
    for panel, values, (name, unit) in zip(panels, (found.cost, found.kept["torque"]), names.items(), strict=True):
        panel.hist(values, bins=40, density=True, alpha=0.6)
        for percent, value in zip(PERCENT, np.percentile(values, PERCENT), strict=True):
            panel.axvline(value, color="C3", linewidth=1)
            panel.annotate(f"{percent} %", (value, 1.01), xycoords=("data", "axes fraction"), ha="center", fontsize=8)
        panel.set_xlabel(f"{name} [{unit}]")
        panel.set_ylabel(f"density [1/({unit})]")
    costs = np.linspace(*panels[0].get_xlim(), 200)
    normal = np.exp(-(((costs - nominal) / deviation) ** 2) / 2) / (deviation * np.sqrt(2 * np.pi))
    panels[0].plot(costs, normal, color="black", linewidth=1, label="to first order")
    panels[0].legend(loc="upper left", framealpha=1)
    figure.suptitle(f"{len(found)} optimal slews with dispersed inertia and target")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def run(samples, folder, workers):
    """The sweep: here, or in processes of their own."""
    if not workers:
        return sweep(study, samples, folder, verbose=True)
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        return sweep(study, samples, folder, pool, verbose=True)


def main(arguments=None):
    """Solve, or go on, summarise, compare, plot; returns the sweep, the deviation of its costs, and that to first
    order."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=0, help="processes; 0: this one, with threads")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    folder = options.output / f"monte_carlo_slew_{options.samples}"

    found = run(options.samples, folder, options.workers)
    written = {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")}
    again = run(options.samples, folder, 0)
    print(found)
    print("nothing was solved again:", all(path.stat().st_mtime_ns == before for path, before in written.items()))
    print("all are strict minima:", bool(again.kept["minimum"].all()))
    units = {
        "cost [N^2 m^2 s]": found.cost,
        "peak torque [N m]": found.kept["torque"],
        "peak rate [rad/s]": found.kept["rate"],
    }
    print("percent".ljust(20), *(f"{percent:>10}" for percent in PERCENT))
    for name, values in units.items():
        print(name.ljust(20), *(f"{value:10.4g}" for value in np.percentile(values, PERCENT)))
    linear, nominal = linear_deviation()
    deviation = float(np.std(found.cost, ddof=1))
    print(f"deviation of the cost: {deviation:.1f}, to first order {linear:.1f}; nominal cost {nominal:.1f} N^2 m^2 s")

    plot(found, nominal, linear, options.output / "monte_carlo_slew.png")
    print(f"written: {options.output / 'monte_carlo_slew.png'}")
    return found, deviation, linear


if __name__ == "__main__":
    main()
