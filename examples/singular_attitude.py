r"""Singular attitude control

Attitude control with a cost-free or a failed actuator: singular extremals on :math:`SO(3) \times \mathbb R^3`,
integrated on :math:`P_f`.

    \dot R = R\,\hat w, \qquad J\dot w + w \times Jw = u

Two problems: with a third torque that costs nothing, :math:`\min \int \tfrac12 (u_1^2 + u_2^2) + \lvert w\rvert^2`,
and with the third actuator failed and the other two free of cost, :math:`\min \int \lvert w\rvert^2`. Pontryagin's
Hamiltonian does not determine the free torques; its extremals live on a symplectic :math:`P_f`, of dimension 10 and 8
in the 12 of :math:`T^*Q`. RATTLE keeps :math:`P_f` and its form to rounding, and the spatial angular costate, a
momentum of the symmetry of both problems, as well.

With the failed actuator, rotations near the middle axis stay near it, and the energy error oscillates. With the free
one extremals are saddles, as those of a linear quadratic regulator: they come near rest about two axes and leave
again. The start is of one that stays for a while, and its energy error comes and goes with the rates.

    python examples/singular_attitude.py [--output examples/output]
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax import plotting
from retrax.integrators import OptimalControlProblem, classify, integrate, singular_integrator, symplecticity_defect
from retrax.manifolds import SO, Euclidean, hat
from retrax.manifolds.numerics import ambient as vec
from retrax.problems import SINGULAR
from retrax.retractions import Cayley, Midpoint

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

INERTIA = jnp.array([1.0, 1.7, 2.3])
Q = SO(3) * Euclidean(3)  # attitude R (body to inertial frame), body rate w
COUNTS = np.array([400, 800])
SIZES = np.array([0.2, 0.1, 0.05])


def dynamics(q, u):
    """Velocity of the attitude and of the body rate; nothing drives the third axis."""
    attitude, rate = q
    torque = jnp.concatenate([u, jnp.zeros(1)])
    return attitude @ hat(rate), (torque - jnp.cross(rate, INERTIA * rate)) / INERTIA


PROBLEMS = {
    "free actuator": SINGULAR["free actuator"]().problem,
    "failed actuator": OptimalControlProblem(Q, dynamics, lambda q, u: q[1] @ q[1], controls=2),
}
# Body rate, body angular costate and costate of the rate at the start, and the horizon; ``nearby`` moves them to
# ``P_f``.
STARTS = {
    "free actuator": ([1.0, -0.5, 1.5], [0.6, -0.4, 3.0], [-1.1015, 0.2385, 0.0], 8.0),
    "failed actuator": ([0.5, 1.0, 0.3], [1.0, 2.0, 0.1], [0.0, 0.0, 0.5], 40.0),
}


@eqx.filter_jit
def along(problem, classification, path):
    """Hamiltonian, with the control as a function of the state, equations of ``P_f`` and spatial angular costate at the
    nodes."""

    def at(q, p):
        energy = problem.hamiltonian(q, p, classification.control(q, p))
        return energy, vec.size(classification.equations((q, p))), SO(3).spatial(q[0], p[0])

    return jax.vmap(at)(path.q, path.p)


def examine(problem, start):
    """Classification of a problem, what its discrete extremals from one start preserve, and the finest of them."""
    *start, horizon = start
    rate, body_costate, rate_costate = jnp.array(start)
    classification = classify(problem)
    method, choice = singular_integrator(classification, Midpoint(Cayley(Q)), "rattle")
    print(f"{classification}\n{choice}")
    final = classification.manifold
    attitude = jnp.eye(3)
    z = final.nearby(((attitude, rate), (SO(3).covector(attitude, body_costate), rate_costate)))
    paths = [integrate(problem, method, z, horizon / n, int(n), save_every=int(n) // 200) for n in COUNTS]
    energy, gaps, momentum = (
        np.asarray(a) for a in zip(*(along(problem, classification, path) for path in paths), strict=True)
    )
    numbers = {
        "P_f": np.max(gaps),
        "omega_f": np.asarray(symplecticity_defect(classification.presymplectic, method, problem, z, SIZES)),
        "momentum": np.max(np.abs(momentum - momentum[0, 0])),
        "energy": np.max(np.abs(energy - energy[:, :1]), axis=1),
    }
    return classification, numbers, paths[-1], energy[-1] - energy[-1, 0]


def plot(found, path):
    """Body rates, torques and the energy error of both problems, and the defects of the form."""
    figure, axes = plt.subplots(2, 3, figsize=(13, 7), sharex="row", layout="constrained")
    for row, (name, (_, numbers, run, error)) in zip(axes, found.items(), strict=True):
        plotting.state(run, 1, problem=Q, ax=row[0]).set_ylabel(f"{name}\nbody rate")
        plotting.controls(run, ax=row[1]).set_ylabel("torque")
        row[2].plot(run.times, error)
        row[2].set(xlabel="time", ylabel="energy error")
        row[2].set_title(f"$\\omega_f$ changes by {np.max(numbers['omega_f']):.0e} a step", fontsize="medium")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Returns for each problem its classification, the numbers, the finest trajectory and its energy error."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)

    found = {}
    for name, problem in PROBLEMS.items():
        print(f"{name}\n")
        found[name] = examine(problem, STARTS[name])
        numbers = found[name][1]
        print(f"    equations of P_f along {COUNTS} steps: {numbers['P_f']:.1e}")
        print(f"    omega_f changes over one step of {SIZES} by {numbers['omega_f']}")
        print(f"    spatial angular costate changes by {numbers['momentum']:.1e}")
        print(f"    max |energy error|: {numbers['energy']}")
        print()
    path = options.output / "singular_attitude.png"
    plot(found, path)
    print(f"written: {path}")
    return found


if __name__ == "__main__":
    main()
