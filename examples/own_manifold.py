r"""Three custom manifolds

Three manifolds of one's own, each checked by the conformance kit and used in a solved control problem.

1. a torus, from one function;
2. an ellipsoid, with a retraction and its inverse in closed form;
3. the Heisenberg group, from its Lie algebra.

Each problem is to minimise :math:`\tfrac12 \int \lvert u\rvert^2\,dt` over a unit time, and its optimum is known.
docs/own_manifold.md tells the story.

    python examples/own_manifold.py [--steps 50] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax import plotting
from retrax.integrators import Guess, OptimalControlProblem, solve
from retrax.manifolds import LevelSet, MatrixLieGroup
from retrax.retractions import Exponential, Midpoint, Projection, Retraction
from retrax.testing import check_lie_group, check_manifold, check_retraction
from scipy.special import ellipeinc

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt


class Torus(LevelSet):
    """Points at distance 1 from a circle of radius 2."""

    def constraint(self, x):
        """Zero on the torus."""
        return (jnp.sqrt(x[0] ** 2 + x[1] ** 2) - 2.0) ** 2 + x[2] ** 2 - 1.0


class Ellipsoid(LevelSet):
    """``{x : sum_i a_i x_i^2 = 1}``."""

    weights: jax.Array

    def constraint(self, x):
        """Zero on the ellipsoid."""
        return x @ (self.weights * x) - 1.0


class RadialRetraction(Retraction):
    """``R(x, v) = (x + v) / sqrt((x + v)' A (x + v))``; inverse ``y / (x' A y) - x`` where ``x' A y > 0``."""

    manifold: Ellipsoid

    def retract(self, x, v):
        moved = x + v
        return moved / jnp.sqrt(moved @ (self.manifold.weights * moved))

    def preimage(self, x, y):
        height = x @ (self.manifold.weights * y)
        return jnp.where(height > 0, y / height - x, jnp.nan)

    def domain(self, x, v):
        return jnp.all(jnp.isfinite(v))


class Heisenberg(MatrixLieGroup):
    """Upper triangular matrices with unit diagonal; coordinates ``(a, b, c)`` of the algebra fill the entries above
    it."""

    @property
    def algebra(self):
        a = np.zeros((3, 3, 3))
        a[0, 0, 1] = a[1, 1, 2] = a[2, 0, 2] = 1.0
        return a


def torus(steps):
    """Along the outer equator, by an angle of 1 on a circle of radius 3: the cost is 9/2."""
    m = Torus(shape=(3,))
    retraction = Projection(m)
    end = 3.0 * np.array([np.cos(1.0), np.sin(1.0), 0.0])
    problem = OptimalControlProblem(m, lambda q, u: m.projection(q, u), lambda q, u: u @ u / 2, 3)
    solution = solve(problem, np.array([3.0, 0.0, 0.0]), end, horizon=1.0, method=Midpoint(retraction), steps=steps)
    return retraction, solution, 4.5


def ellipsoid(steps):
    """Along the ellipse with half axes 1 and 1/sqrt(2), by a quarter: the cost is half its squared length."""
    m = Ellipsoid(shape=(3,), weights=jnp.array([1.0, 2.0, 3.0]))
    retraction = RadialRetraction(m)
    length = ellipeinc(np.pi / 2, 1 - 2.0) / np.sqrt(2.0)
    end = np.array([0.0, np.sqrt(0.5), 0.0])
    problem = OptimalControlProblem(m, lambda q, u: m.projection(q, u), lambda q, u: u @ u / 2, 3)
    solution = solve(problem, np.array([1.0, 0.0, 0.0]), end, horizon=1.0, method=Midpoint(retraction), steps=steps)
    return retraction, solution, length**2 / 2


def heisenberg(steps):
    """Two controls for three dimensions: a closed loop in the plane that encloses the area 1/2 costs ``2 pi`` times it.

    The entry above the corner collects ``int a db``, the area; of all loops the circle is the shortest.
    """
    m = Heisenberg()
    retraction = Exponential(m)
    problem = OptimalControlProblem(m, lambda x, u: x @ m.hat(jnp.append(u, 0.0)), lambda x, u: u @ u / 2, 2)
    end = np.eye(3)
    end[0, 2] = 0.5
    times = (np.arange(steps) + 0.5) / steps
    loop = np.stack([np.sin(2 * np.pi * times), 1 - np.cos(2 * np.pi * times)]) / (2 * np.pi)
    states = np.tile(np.eye(3), (steps, 1, 1))
    states[:, 0, 1], states[:, 1, 2], states[:, 0, 2] = loop[0], loop[1], times / 2
    guess = Guess(states, np.stack([np.cos(2 * np.pi * times), np.sin(2 * np.pi * times)], axis=1))
    solution = solve(problem, np.eye(3), end, horizon=1.0, method=Midpoint(retraction), steps=steps, guess=guess)
    return retraction, solution, np.pi


def surfaces():
    """Points of the torus and of the ellipsoid at two angles."""
    around, along = np.mgrid[0 : 2 * np.pi : 25j, 0 : 2 * np.pi : 49j]
    far = 2 + np.cos(around)
    torus = far * np.cos(along), far * np.sin(along), np.sin(around)
    polar, azimuth = np.mgrid[0 : np.pi : 19j, 0 : 2 * np.pi : 37j]
    sphere = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
    return {"torus": torus, "ellipsoid": [x / np.sqrt(weight) for x, weight in zip(sphere, (1, 2, 3), strict=True)]}


def plot(solutions, path):
    """Two geodesics on their surfaces, and the loop of the Heisenberg group in its plane."""
    figure = plt.figure(figsize=(12, 4.2), layout="constrained")
    parts = figure.subfigures(1, 3)
    for part, (name, wires) in zip(parts, surfaces().items(), strict=False):
        axis = part.add_subplot(projection="3d", computed_zorder=False, elev=45)  # wires lie behind the curve
        axis.plot_wireframe(*wires, color="0.8", linewidth=0.4, zorder=0)
        axis.set_prop_cycle(color=["tab:red"])
        plotting.path(solutions[name], ax=axis)
        axis.set_box_aspect([np.ptp(x) for x in wires], zoom=1.3)
        axis.set_axis_off()
        part.suptitle(f"geodesic of {'a' if name == 'torus' else 'an'} {name}")
    x = solutions["Heisenberg group"].states
    axis = parts[2].add_subplot()
    axis.plot(x[:, 0, 1], x[:, 1, 2], color="C3", linewidth=2)
    axis.set(xlabel="a", ylabel="b", aspect="equal")
    parts[2].suptitle("isoperimetric loop")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Check, solve, compare, plot; returns each problem's relative error of the cost."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    errors, solutions = {}, {}
    for name, case in {"torus": torus, "ellipsoid": ellipsoid, "Heisenberg group": heisenberg}.items():
        retraction, solution, expected = case(options.steps)
        manifold = retraction.manifold
        print(check_lie_group(manifold) if isinstance(manifold, MatrixLieGroup) else check_manifold(manifold))
        print(check_retraction(retraction))
        errors[name], solutions[name] = solution.cost / expected - 1, solution
        print(f"{name}: cost {solution.cost:.6f}, known {expected:.6f}, relative difference {errors[name]:.1e}\n")
    path = options.output / "own_manifold.png"
    plot(solutions, path)
    print(f"written: {path}")
    return errors


if __name__ == "__main__":
    main()
