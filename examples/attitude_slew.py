r"""Rest-to-rest slew

Rest-to-rest slew of a spacecraft: 150 degrees about (1, 2, -2)/3 in 60 seconds with least torque.

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = u, \qquad \text{minimise } \tfrac12 \int \lvert u\rvert^2\,dt

on :math:`SO(3) \times \mathbb R^3`. Inertia :math:`J = \mathrm{diag}(5621, 4547, 2364)\ \mathrm{kg\,m^2}`: the
spacecraft of the minimum-time reorientation problem in J. T. Betts, "Practical Methods for Optimal Control and
Estimation Using Nonlinear Programming", SIAM 2010, section 6.8. The reference optimum is the limit of the discrete
ones as the steps shrink, 2504.24655710 N^2 m^2 s.

Run it to solve, print the report, compare with the reference, and write two figures and the solution:

    python examples/attitude_slew.py [--steps 50] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax import plotting
from retrax.integrators import OptimalControlProblem, Solution, discretization_error, load_solution, solve
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Cayley, Gauss
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

INERTIA = jnp.array([5621.0, 4547.0, 2364.0])  # kg m^2, principal axes
AXIS = np.array([1.0, 2.0, -2.0]) / 3
ANGLE = np.deg2rad(150)
HORIZON = 60.0  # s
REFERENCE_COST = 2504.24655710  # N^2 m^2 s

Q = SO(3) * Euclidean(3)  # attitude R (body to inertial frame), body rate w in rad/s


def dynamics(q, u):
    """Velocity of the attitude and of the body rate under a torque u in the body frame, N m."""
    attitude, rate = q
    return attitude @ hat(rate), (u - jnp.cross(rate, INERTIA * rate)) / INERTIA


def torque_effort(q, u):
    """Running cost |u|^2 / 2."""
    return u @ u / 2


PROBLEM = OptimalControlProblem(
    Q,
    dynamics,
    torque_effort,
    controls=3,
    labels={"states": ("attitude", "body rate"), "controls": "torque"},
    units={"states": ("", "rad/s"), "controls": "N m", "time": "s", "cost": "N^2 m^2 s"},
)
METHOD = Gauss(4, Cayley(Q))  # of order 8


def slew(steps):
    """The optimal slew with a number of equal steps."""
    start = (np.eye(3), np.zeros(3))
    end = (Rotation.from_rotvec(ANGLE * AXIS).as_matrix(), np.zeros(3))
    return solve(PROBLEM, start, end, horizon=HORIZON, method=METHOD, steps=steps)


def plot_histories(solution: Solution, path):
    """Attitude as a rotation vector, body rate, torque, and the errors of what the continuous flow conserves."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 7), sharex=True, layout="constrained")
    plotting.histories(solution, ax=axes.flat[:3])
    plotting.conserved(solution, ax=axes[1, 1])
    figure.suptitle(f"Slew of {np.rad2deg(ANGLE):.0f} deg in {HORIZON:.0f} s, cost {solution.cost:.4f} N$^2$ m$^2$ s")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def plot_paths(solution: Solution, path):
    """The three body axes as paths on the sphere of directions."""
    axis = plotting.body_axes(solution)
    axis.set_title("Body axes in the inertial frame, from the open to the full dot")
    axis.figure.savefig(path, dpi=150)
    plt.close(axis.figure)


def main(arguments=None):
    """Solve, print, compare, plot, save; returns the solution."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--steps", type=int, default=50, help="number of steps")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    solution = slew(options.steps)
    solution.report()
    error = abs(solution.cost - REFERENCE_COST) / REFERENCE_COST
    print(f"\nreference optimum {REFERENCE_COST:.8f} N^2 m^2 s, relative difference {error:.1e}")
    attitude, rate = discretization_error(PROBLEM, METHOD.retraction, solution).largest.values()
    print(f"error of the discrete solution, by propagation of its torque: {attitude:.1e} rad, {rate:.1e} rad/s")

    stem = options.output / "attitude_slew"
    plot_histories(solution, f"{stem}_histories.png")
    plot_paths(solution, f"{stem}_paths.png")
    solution.save(f"{stem}.npz")
    unchanged = np.array_equal(load_solution(f"{stem}.npz").controls, solution.controls)
    print(f"written: {stem}_histories.png, {stem}_paths.png, {stem}.npz (loads back unchanged: {unchanged})")
    return solution


if __name__ == "__main__":
    main()
