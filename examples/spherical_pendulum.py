r"""The spherical pendulum

The spherical pendulum on :math:`T^*S^2` for 100 000 steps, beside a method of the same order that knows no geometry.

    H(q, p) = \tfrac12 \lvert p\rvert^2 + q_3 \qquad \text{(unit mass, length and gravity)}

The midpoint map of the projection retraction, lifted to the cotangent bundle, gives a symplectic integrator of order
2. It conserves the vertical angular momentum to rounding, because the retraction commutes with rotations, and its
energy error stays bounded. The explicit midpoint rule on the embedded equations, projected to :math:`T^*S^2` after
every step, drifts.

    python examples/spherical_pendulum.py [--steps 100000] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import SymplecticIntegrator, integrate
from retrax.manifolds import Sphere
from retrax.retractions import CotangentLift, Midpoint, Projection

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

S2 = Sphere(2)
STEP = 0.02
START = (jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.6, 0.3]))


def energy(q, p):
    """The Hamiltonian."""
    return p @ p / 2 + q[2]


def explicit_midpoint(start, steps, every):
    """The projected explicit midpoint rule on q' = p, p' = -P_q e_3 - |p|^2 q; one state in ``every``."""

    def field(q, p):
        return p, -S2.projection(q, jnp.array([0.0, 0.0, 1.0])) - (p @ p) * q

    def step(z, _):
        q, p = z
        dq, dp = field(q, p)
        dq, dp = field(q + STEP / 2 * dq, p + STEP / 2 * dp)
        q, p = q + STEP * dq, p + STEP * dp
        q = q / jnp.linalg.norm(q)
        return (q, S2.projection(q, p)), None

    def block(z, _):
        z, _ = jax.lax.scan(step, z, None, length=every)
        return z, z

    return jax.jit(lambda z: jax.lax.scan(block, z, None, length=steps // every)[1])(start)


def largest(times, error, windows=100):
    """The largest size of an error in each of some windows of the logarithm of time, and the times where these end."""
    window = np.digitize(times, np.geomspace(times[0], times[-1], windows)[:-1])
    begins = np.flatnonzero(np.diff(window, prepend=-1))
    return np.append(times[begins[1:] - 1], times[-1]), np.maximum.reduceat(np.abs(error), begins)


def plot(times, errors, path):
    """Energy errors of both methods against time: the largest ones, for they swing between these and zero."""
    figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
    for name, error in errors.items():
        (line,) = axis.loglog(*largest(times, error), label=name)
        axis.loglog(times, np.abs(error), ".", color=line.get_color(), markersize=1, alpha=0.4)
    axis.set_xlabel("time")
    axis.set_ylabel("|energy error|")
    axis.set_title(f"Spherical pendulum, steps of {STEP}; lines: the largest error in each window of time")
    axis.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Integrate both ways, print the errors, plot; returns the energy errors and the largest momentum error."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--steps", type=int, default=100_000, help="number of steps, a multiple of 50")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    every = 50

    integrator = SymplecticIntegrator(CotangentLift(Midpoint(Projection(S2))))
    trajectory = integrate(energy, integrator, START, STEP, options.steps, save_every=every)
    q, p = np.asarray(trajectory.q[1:]), np.asarray(trajectory.p[1:])
    other = explicit_midpoint(START, options.steps, every)
    exact = float(energy(*START))
    errors = {
        "cotangent-lifted midpoint (retrax)": np.asarray(jax.vmap(energy)(q, p)) - exact,
        "projected explicit midpoint": np.asarray(jax.vmap(energy)(*other)) - exact,
    }
    momentum = np.cross(q, p)[:, 2] - float(jnp.cross(*START)[2])
    for name, error in errors.items():
        quarters = [np.max(np.abs(part)) for part in np.array_split(error, 4)]
        print(f"{name:36s} max |energy error| in each quarter: " + "  ".join(f"{m:.2e}" for m in quarters))
    print(f"vertical angular momentum: error {np.max(np.abs(momentum)):.1e} after {options.steps} steps")
    print(f"distance from the sphere:  {np.max(np.abs(np.linalg.norm(q, axis=1) - 1)):.1e}")

    path = options.output / "spherical_pendulum_energy.png"
    plot(np.asarray(trajectory.times[1:]), errors, path)
    print(f"written: {path}")
    return errors, float(np.max(np.abs(momentum)))


if __name__ == "__main__":
    main()
