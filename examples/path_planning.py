"""A spacecraft slew that keeps its camera off the sun: a path planned by pymanopt starts the optimal control solver.

    R' = R hat(w),    J w' + w x J w = u,    minimise  int |u|^2 / 2 + b(R) dt,    b = W exp(S (<R c, s> - cos A))

on SO(3) x R^3, from rest to rest. The camera's axis c is fixed to the body, s points to the sun; b rises steeply where the angle
between them falls below A. The shortest slew would sweep the camera across the sun.

First the path: the nodes between start and end are one point of Power(SO(3), N - 1). Riemannian trust regions of pymanopt
minimise N sum |R_k - R_(k-1)|^2 / 2 plus the barrier over them. Without a barrier the minimum is the geodesic, with the energy
2 N^2 (1 - cos(angle / N)): the number that is checked. The path has no dynamics; `solve` takes it, with the rates and
torques that it implies, as its guess.

    python examples/path_planning.py [--steps 40] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import Guess, OptimalControlProblem, solve
from retrax.interop import to_pymanopt
from retrax.manifolds import SO, Euclidean, Power, hat, vee
from retrax.retractions import Cayley, Exponential, Midpoint

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt
import pymanopt

INERTIA = jnp.array([1.2, 1.0, 0.8])  # kg m^2, principal axes
HORIZON = 10.0  # s
ANGLE = np.deg2rad(120)  # of the slew, about the third axis
KEEP_OUT = np.deg2rad(20)
WEIGHT, STEEPNESS = 0.01, 60.0
CAMERA = jnp.array([1.0, 0.0, 0.0])  # in the body frame
SUN = jnp.array([np.cos(ANGLE / 2), np.sin(ANGLE / 2), 0.1]) / np.sqrt(1.01)  # half way, a little to the side

EXP = Exponential(SO(3))
START = jnp.eye(3)
END = EXP(START, hat(jnp.array([0.0, 0.0, ANGLE])))
Q = SO(3) * Euclidean(3)  # attitude R (body to inertial frame), body rate w in rad/s


def barrier(attitude):
    """Cost rate of looking near the sun."""
    return WEIGHT * jnp.exp(STEEPNESS * ((attitude @ CAMERA) @ SUN - jnp.cos(KEEP_OUT)))


def dynamics(q, u):
    """Velocity of the attitude and of the body rate under a torque u in the body frame, N m."""
    attitude, rate = q
    return attitude @ hat(rate), (u - jnp.cross(rate, INERTIA * rate)) / INERTIA


PROBLEM = OptimalControlProblem(Q, dynamics, lambda q, u: u @ u / 2 + barrier(q[0]), controls=3)


@jax.jit
def path_energy(nodes, weight):
    """Discrete energy of a path, and ``weight`` times the barrier along it."""
    path = jnp.concatenate([START[None], nodes, END[None]])
    steps = len(path) - 1
    return steps * jnp.sum((path[1:] - path[:-1]) ** 2) / 2 + weight * jnp.mean(jax.vmap(barrier)(path))


def plan(steps, weight):
    """Nodes of the path of least energy with ``weight`` times the barrier, from the geodesic; and pymanopt's record."""
    space = to_pymanopt(Power(SO(3), steps - 1))
    geodesic = [EXP(START, s * EXP.inverse(START, END)) for s in np.arange(1, steps) / steps]

    @pymanopt.function.jax(space)
    def cost(nodes):
        return path_energy(nodes, weight)

    optimiser = pymanopt.optimizers.TrustRegions(verbosity=0, max_iterations=200, min_gradient_norm=1e-8)
    result = optimiser.run(pymanopt.Problem(space, cost), initial_point=np.stack(geodesic))
    return jnp.concatenate([START[None], result.point, END[None]]), result


@jax.jit
def guess_from(path):
    """The guess that a path makes: midpoints and rates between its nodes, and the torques that the rates take."""
    h = HORIZON / (len(path) - 1)
    turns = jax.vmap(EXP.preimage)(path[:-1], path[1:])
    attitudes = jax.vmap(lambda x, v: EXP(x, v / 2))(path[:-1], turns)
    rates = jax.vmap(lambda x, v: vee(x.T @ v) / h)(path[:-1], turns)
    torques = INERTIA * jnp.gradient(rates, h, axis=0) + jnp.cross(rates, INERTIA * rates)
    return Guess((attitudes, rates), torques)


def sun_angles(attitudes):
    """Angles between the camera's axis and the sun, rad."""
    return np.arccos(np.clip(np.asarray(attitudes @ CAMERA @ SUN), -1, 1))


def plot(paths, path):
    """The camera's axis on the sphere of directions, with the keep-out cone, and its angle to the sun."""
    figure = plt.figure(figsize=(11, 5), layout="constrained")
    sphere, axis = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    polar, azimuth = np.mgrid[0 : np.pi : 19j, 0 : 2 * np.pi : 37j]
    ball = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
    sphere.plot_wireframe(*ball, color="0.85", linewidth=0.5)
    across = np.linalg.svd(np.asarray(SUN)[None])[2][1:]
    turn = np.linspace(0, 2 * np.pi, 100)[:, None]
    circle = np.cos(KEEP_OUT) * SUN + np.sin(KEEP_OUT) * (np.cos(turn) * across[0] + np.sin(turn) * across[1])
    sphere.plot(*circle.T, color="0.3", linestyle="--")
    for name, attitudes in paths.items():
        sphere.plot(*np.asarray(attitudes @ CAMERA).T, label=name)
        axis.plot(np.linspace(0, HORIZON, len(attitudes)), np.rad2deg(sun_angles(attitudes)), label=name)
    sphere.set_box_aspect((1, 1, 1), zoom=1.4)
    sphere.view_init(20, 60)
    sphere.set_axis_off()
    axis.axhline(np.rad2deg(KEEP_OUT), color="0.3", linestyle="--", label="keep-out cone")
    axis.set_xlabel("time [s]")
    axis.set_ylabel("camera to sun [deg]")
    axis.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Plan, solve, compare, plot; returns the solution, its least angle to the sun, and the error of the geodesic's energy."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    geodesic, free = plan(options.steps, weight=0.0)
    error = abs(free.cost / (2 * options.steps**2 * (1 - np.cos(ANGLE / options.steps))) - 1)
    print(f"path without obstacle: energy {free.cost:.10f}, relative error {error:.1e}")
    path, planned = plan(options.steps, weight=100.0)
    print(f"planned path: energy {planned.cost:.4f}, {planned.iterations} iterations, |gradient| {planned.gradient_norm:.1e}")

    start, end = (START, jnp.zeros(3)), (END, jnp.zeros(3))
    solution = solve(PROBLEM, Midpoint(Cayley(Q)), start, end, HORIZON, options.steps, guess=guess_from(path))
    solution.report()
    paths = {"geodesic": geodesic, "planned path": path, "optimal slew": jnp.asarray(solution.states[0])}
    for name, attitudes in paths.items():
        print(f"{name:13s} comes to {np.rad2deg(np.min(sun_angles(attitudes))):5.1f} degrees of the sun")
    plot(paths, options.output / "path_planning.png")
    print(f"written: {options.output / 'path_planning.png'}")
    return solution, np.min(sun_angles(paths["optimal slew"])), error


if __name__ == "__main__":
    main()
