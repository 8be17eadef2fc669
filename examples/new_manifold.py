"""A manifold of one's own, all the way to a solved control problem: an ellipsoid from one function.

    minimise  int |u|^2 / 2 + q_3^2 dt,    q' = P_q u    on   q_1^2 + 2 q_2^2 + 3 q_3^2 = 1

The class below has one method. Tangent spaces, the retraction by projection, the discretization map, its cotangent lift, the
integrator and the solver follow. The script checks each link of that chain with a number, then draws the extremal.

    python examples/new_manifold.py [--steps 100] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, SymplecticIntegrator, integrate, solve
from retrax.manifolds import LevelSet
from retrax.retractions import CotangentLift, Midpoint, Projection

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt


class Ellipsoid(LevelSet):
    """``{x : sum_i a_i x_i^2 = 1}``."""

    weights: jax.Array

    def constraint(self, x):
        """Zero on the ellipsoid."""
        return x @ (self.weights * x) - 1.0


M = Ellipsoid(shape=(3,), weights=jnp.array([1.0, 2.0, 3.0]))
START = np.array([1.0, 0.0, 0.0])
END = np.array([-0.5, 0.5, 0.5]) / np.sqrt(0.25 * 6)


def free_particle(q, p):
    """Hamiltonian whose trajectories are the geodesics of the ellipsoid."""
    return p @ p / 2


PROBLEM = OptimalControlProblem(
    M,
    dynamics=lambda q, u: M.projection(q, u),
    running_cost=lambda q, u: u @ u / 2 + q[2] ** 2,
    controls=3,
)


def plot(solution, geodesic, path):
    """The extremal and a geodesic on the ellipsoid."""
    figure = plt.figure(figsize=(7, 7), layout="constrained")
    axis = figure.add_subplot(projection="3d")
    polar, azimuth = np.mgrid[0 : np.pi : 25j, 0 : 2 * np.pi : 49j]
    ball = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    axis.plot_wireframe(*(ball / np.sqrt(np.asarray(M.weights))[:, None, None]), color="0.85", linewidth=0.5)
    axis.plot(*geodesic.T, color="0.5", linewidth=0.8, label="a geodesic")
    axis.plot(*solution.states.T, color="C3", linewidth=2, label="the extremal")
    axis.scatter(*np.stack([START, END]).T, color="C3", s=25)
    axis.set_box_aspect(1 / np.sqrt(np.asarray(M.weights)), zoom=1.4)
    axis.set_axis_off()
    axis.legend(loc="upper left")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Check, integrate, solve, compare, plot; returns the solution and the largest mismatch of its costates."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    print(M.contains(START).reason)
    print(M.contains(1.01 * START).reason)
    lift = CotangentLift(Midpoint(Projection(M)))
    geodesic = integrate(free_particle, SymplecticIntegrator(lift), (START, np.array([0.0, 1.0, 0.4])), 0.02, 2000)
    energies = jax.vmap(free_particle)(geodesic.q, geodesic.p)
    print(f"geodesic: energy error {np.max(np.abs(energies - energies[0])):.1e} over 2000 steps")

    solution = solve(PROBLEM, lift.discretization, START, END, horizon=1.0, steps=options.steps)
    solution.report()
    # The costates of the solution are those of the integrator: started from the first, it runs through all nodes.
    start = (solution.states[0], solution.costates[0])
    again = integrate(PROBLEM, PresymplecticIntegrator(lift), start, 1.0 / options.steps, options.steps)
    mismatch = max(np.max(np.abs(again.q - solution.states)), np.max(np.abs(again.p - solution.costates)))
    print(f"the presymplectic integrator reproduces the extremal to {mismatch:.1e}")

    path = options.output / "new_manifold.png"
    plot(solution, np.asarray(geodesic.q), path)
    print(f"written: {path}")
    return solution, float(mismatch)


if __name__ == "__main__":
    main()
