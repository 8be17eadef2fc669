r"""Path planning around an obstacle

A rigid body moves between two poses past an obstacle: a path planned by pymanopt starts the optimal control solver.

    \dot x = x\,\hat\xi, \qquad
    \text{minimise } \int \tfrac12 (J \lvert\omega\rvert^2 + m \lvert v\rvert^2) + b(t)\,dt, \qquad
    \xi = (\omega, v), \quad x = (R, t)

on SE(3): the kinetic energy of the motion, and a barrier :math:`b = W \exp(S (1 - \lvert t - c\rvert^2/r^2))` around
a ball of radius :math:`r`, which the straight way would cross.

First the path: the nodes between start and end are one point of Power(SE(3), N - 1). Riemannian trust regions of
pymanopt minimise its discrete energy plus the barrier over them. Without the barrier the minimum is the geodesic, a
straight line turned at a constant rate, with the energy
:math:`J N^2 (1 - \cos(\alpha/N)) + \tfrac12 m \lvert d\rvert^2`: the first number that is checked. `solve` takes the
path, with the twists between its nodes, as its guess. The second number: the way is not shorter than a string pulled
taut around the ball, two tangents and an arc, and little longer.

    python examples/path_planning.py [--steps 40] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax import plotting
from retrax.integrators import Guess, OptimalControlProblem, solve
from retrax.interop import to_pymanopt
from retrax.manifolds import SE, Power, hat
from retrax.retractions import Exponential, Midpoint, PowerRetraction, SEDecoupled

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt
import pymanopt

Q = SE(3)
INERTIA, MASS = 0.5, 1.0
ANGLE = np.deg2rad(120)
CENTRE, RADIUS = jnp.array([0.0, -0.3, 0.0]), 1.0
WEIGHT, STEEPNESS = 2.0, 10.0

TURN = jnp.array([1.0, 1.0, 1.0]) * ANGLE / jnp.sqrt(3.0)
STRAIGHT = SEDecoupled(Q)
START = Q.pose(jnp.eye(3), jnp.array([-2.0, 0.0, 0.0]))
WAY = jnp.array([4.0, 0.0, 0.0])
END = STRAIGHT(START, Q.tangent(hat(TURN), WAY))


def barrier(pose):
    """Cost rate of being near the ball."""
    away = Q.parts(pose)[1] - CENTRE
    return WEIGHT * jnp.exp(STEEPNESS * (1 - away @ away / RADIUS**2))


def energy_rate(pose, twist):
    """Kinetic energy of a twist in the body frame, and the barrier."""
    omega, v = twist[:3], twist[3:]
    return (INERTIA * omega @ omega + MASS * v @ v) / 2 + barrier(pose)


PROBLEM = OptimalControlProblem(Q, lambda pose, twist: pose @ Q.hat(twist), energy_rate, controls=6)


@jax.jit
def path_energy(nodes, weight):
    """Discrete energy of a path, and ``weight`` times the barrier along it."""
    path = jnp.concatenate([START[None], nodes, END[None]])
    steps, change = len(path) - 1, path[1:] - path[:-1]
    turns, shifts = jax.vmap(Q.parts)(change)
    kinetic = INERTIA * jnp.sum(turns**2) / 2 + MASS * jnp.sum(shifts**2)
    return steps * kinetic / 2 + weight * jnp.mean(jax.vmap(barrier)(path))


def plan(steps, weight):
    """Nodes of the path of least energy with ``weight`` times the barrier, from the geodesic; and pymanopt's record."""
    space = to_pymanopt(Power(Q, steps - 1), PowerRetraction(STRAIGHT, steps - 1))
    geodesic = [STRAIGHT(START, s * STRAIGHT.inverse(START, END)) for s in np.arange(1, steps) / steps]

    @pymanopt.function.jax(space)
    def cost(nodes):
        return path_energy(nodes, weight)

    optimiser = pymanopt.optimizers.TrustRegions(verbosity=0, max_iterations=200, min_gradient_norm=1e-7)
    result = optimiser.run(pymanopt.Problem(space, cost), initial_point=np.stack(geodesic))
    return jnp.concatenate([START[None], result.point, END[None]]), result


@jax.jit
def guess_from(path):
    """The guess that a path makes: poses midway between its nodes, and the twists that lead from one node to the
    next."""
    exponential = Exponential(Q)
    tangents = jax.vmap(exponential.preimage)(path[:-1], path[1:])
    poses = jax.vmap(lambda x, v: exponential(x, v / 2))(path[:-1], tangents)
    twists = jax.vmap(lambda x, v: Q.vee(Q.left_trivialise(x, v)))(path[:-1], tangents)
    return Guess(poses, (len(path) - 1) * twists)


def positions(poses):
    """Where the body is, shape ``(N, 3)``."""
    return np.asarray(poses)[:, :3, 3]


def distance(poses):
    """Least distance to the centre of the ball, between the nodes too."""
    t = positions(poses)
    between = np.linspace(t[:-1], t[1:], 20).reshape(-1, 3)
    return np.min(np.linalg.norm(between - np.asarray(CENTRE), axis=1))


def length(poses):
    """Length of the way."""
    return np.sum(np.linalg.norm(np.diff(positions(poses), axis=0), axis=1))


def taut_string():
    """Length of the shortest way around the ball: two tangents and an arc of a great circle between them."""
    a, b = (np.asarray(Q.parts(pose)[1] - CENTRE) for pose in (START, END))
    far = np.linalg.norm([a, b], axis=1)
    angle = np.arccos(a @ b / np.prod(far)) - np.sum(np.arccos(RADIUS / far))
    return np.sum(np.sqrt(far**2 - RADIUS**2)) + RADIUS * angle


def plot(solution, paths, path):
    """The ways around the ball with the body's axes on the optimal one, and the distances to the ball."""
    figure = plt.figure(figsize=(11, 5), layout="constrained")
    space, axis = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    widths = 1.5, 5.0, 1.5  # the last two ways are nearly the same
    for (name, poses), colour, width in zip(paths.items(), ("C0", "#ffbf7f", "C2"), widths, strict=True):
        if poses is not solution.states:
            space.plot(*positions(poses).T, color=colour, linewidth=width)
        away = np.linalg.norm(positions(poses) - CENTRE, axis=1)
        axis.plot(np.linspace(0, 1, len(poses)), away, color=colour, linewidth=width, label=name)
    space.set_prop_cycle(color=["tab:green"])
    plotting.path(solution, ax=space, obstacles=[(CENTRE, RADIUS)])
    space.view_init(50, -70)
    space.set(title="the optimal motion, with body axes x red, y green, z blue")
    space.title.set_fontsize("medium")
    space.set_zticks([-1, 0, 1])
    axis.axhline(RADIUS, color="0.3", linestyle=":", label="the ball")
    axis.set_xlabel("time")
    axis.set_ylabel("distance to the centre")
    axis.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Plan, solve, compare, plot; returns the solution, its least distance, its length, and the error of the first
    energy."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    geodesic, free = plan(options.steps, weight=0.0)
    exact = INERTIA * options.steps**2 * (1 - np.cos(ANGLE / options.steps)) + MASS * WAY @ WAY / 2
    error = abs(free.cost / exact - 1)
    print(f"path without obstacle: energy {free.cost:.10f}, relative error {error:.1e}")
    path, planned = plan(options.steps, weight=1.0)
    print(
        f"planned path: energy {planned.cost:.4f}, {planned.iterations} iterations, |gradient| "
        f"{planned.gradient_norm:.1e}"
    )

    solution = solve(
        PROBLEM, START, END, 1.0, method=Midpoint(Exponential(Q)), steps=options.steps, guess=guess_from(path)
    )
    solution.report()
    paths = {"geodesic": geodesic, "planned path": path, "optimal motion": solution.states}
    for name, poses in paths.items():
        print(f"{name:14s} comes to {distance(poses):.3f} of the centre, length {length(poses):.3f}")
    print(f"a taut string has the length {taut_string():.3f}")
    plot(solution, paths, options.output / "path_planning.png")
    print(f"written: {options.output / 'path_planning.png'}")
    return solution, distance(solution.states), length(solution.states), error


if __name__ == "__main__":
    main()
