r"""Singular arcs on the sphere

A singular problem on the sphere: RATTLE on its final constraint manifold, beside a projection method.

    \dot q = f(q) + u\,e_3 \times q \text{ on } S^2, \qquad \min \int F(q)\,dt

The control has no cost. :math:`P_f` is a curved surface in :math:`T^*S^2` with a symplectic form. RATTLE keeps both
to rounding; a projection method keeps :math:`P_f` alone, changes its form by :math:`O(h^3)` a step, and its energy
drifts.

    python examples/singular_sphere.py [--steps 100000] [--output examples/output]
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from retrax.integrators import classify, integrate, singular_integrator, symplecticity_defect
from retrax.manifolds.numerics import ambient as vec
from retrax.problems import SINGULAR
from retrax.retractions import Midpoint, Projection

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")
import matplotlib.pyplot as plt

GUESS = jnp.array([-0.93, 0.09, 0.3557]), jnp.array([0.11, -0.01, 0.295])
SIZES = np.array([0.2, 0.1, 0.05])
STEP = 0.1
BLOCK = 25  # nodes kept of which the figure shows the range


def energies(problem, classification, path):
    """Pontryagin's Hamiltonian along a trajectory: on ``P_f`` it does not depend on the control."""
    u = classification.stratum.u
    return np.asarray(jax.vmap(lambda q, p: problem.hamiltonian(q, p, u))(path.q, path.p))


def drift(times, errors, blocks=50):
    """Slope of a line through the means of blocks, and its standard error."""
    t, e = (np.array([np.mean(part) for part in np.array_split(a, blocks)]) for a in (times, errors))
    (slope, _), covariance = np.polyfit(t, e, 1, cov=True)
    return slope, np.sqrt(covariance[0, 0])


def plot(defects, runs, path):
    """The defects against the step, those of zero at 1e-17, and the range of the energy errors against time."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    for name, defect in defects.items():
        left.loglog(SIZES, np.maximum(defect, 1e-17), "o-", label=name)
    left.loglog(SIZES, 0.02 * SIZES**3, "k:", label="slope 3")
    left.set_xticks(SIZES, [f"{h:g}" for h in SIZES])
    left.minorticks_off()
    left.set(xlabel="step", ylim=(5e-18, 1e-2), title="change of $\\omega_f$ over one step")
    left.legend(loc="center right")
    for name, (times, error) in runs.items():
        parts = np.array_split(error, len(error) // BLOCK)
        middles = [np.mean(part) for part in np.array_split(times, len(parts))]
        right.fill_between(
            middles, [np.min(part) for part in parts], [np.max(part) for part in parts], alpha=0.7, label=name
        )
    right.ticklabel_format(axis="y", scilimits=(0, 0))
    right.set(xscale="log", xlabel="time", title=f"energy error, its range over every {BLOCK} nodes")
    right.legend(loc="lower left")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments=None):
    """Returns the defects by method, the largest residual of ``P_f`` and the drift with its standard error by
    method."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--steps",
        type=int,
        default=100_000,
        help="steps of RATTLE, a multiple of 500, at least 5000; a tenth projected",
    )
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    options = parser.parse_args(arguments)
    if options.steps < 5000 or options.steps % 500:
        parser.error(f"--steps must be a multiple of 500, at least 5000, got {options.steps}")
    options.output.mkdir(parents=True, exist_ok=True)

    problem = SINGULAR["sphere"]().problem
    classification = classify(problem)
    print(f"{classification}\n")
    final = classification.manifold
    z = final.nearby(GUESS)
    defects, gaps, runs, drifts = {}, {}, {}, {}
    for name, steps in (("rattle", options.steps), ("project", options.steps // 10)):
        method, choice = singular_integrator(classification, Midpoint(Projection(problem.manifold)), name)
        path = integrate(problem, method, z, STEP, steps, save_every=10)
        defects[name] = np.asarray(symplecticity_defect(classification.presymplectic, method, problem, z, SIZES))
        gaps[name] = float(jnp.max(jax.vmap(lambda q, p: vec.size(final.equations((q, p))))(path.q, path.p)))
        energy = energies(problem, classification, path)
        runs[name] = np.asarray(path.times), energy - energy[0]
        drifts[name] = drift(*runs[name])
        quarters = [np.max(np.abs(part)) for part in np.array_split(runs[name][1], 4)]
        print(choice)
        print(f"    omega_f changes over one step of {SIZES} by {defects[name]}")
        print(f"    equations of P_f over {steps} steps: {gaps[name]:.1e}")
        print("    max |energy error| in each quarter: " + "  ".join(f"{quarter:.2e}" for quarter in quarters))
        print(f"    drift of the energy: {drifts[name][0]:.1e} +- {drifts[name][1]:.1e} per unit of time")

    path = options.output / "singular_sphere.png"
    plot(defects, runs, path)
    print(f"written: {path}")
    return defects, gaps, drifts


if __name__ == "__main__":
    main()
