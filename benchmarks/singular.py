"""Time of a classification, and per step of each strategy on the final manifold beside the regular integrator.

    python benchmarks/singular.py [--steps 1000] [--repeats 7]

A rigid body on SO(3) x R^3 with one cost-free torque is classified: the first call with its compilation, and the median
of calls from other starts with other moments of inertia, which are arrays of an ``equinox.Module``.

The peer of a step is that of the same problem made regular by a cost ``|u|^2/2`` of its controls, integrated by the
same lifted midpoint map. Warm medians of whole trajectories, alternating, in one run; the first call with its
compilation apart. One JSON line a case.
"""

import argparse
import json
import statistics
import time

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, classify, integrate, singular_integrator
from retrax.manifolds import SO, Euclidean, hat
from retrax.problems import SINGULAR
from retrax.retractions import CotangentLift, Midpoint, default_retraction

CASES = {
    "academic": ("direct", "project"),
    "aly-chan": ("direct", "rattle", "reduced", "project"),
    "sphere": ("rattle", "project"),
    "curved arc": ("rattle", "project"),
    "massless particle": ("stage", "project"),
    "free actuator": ("rattle", "reduced", "project"),
}
STEP = 1e-3


class RigidBody(eqx.Module):
    """``R' = R hat(w)``, ``J w' = u - w x J w`` with moments of inertia ``J``."""

    inertia: Array

    def __call__(self, q, u):
        attitude, rate = q
        return attitude @ hat(rate), (u - jnp.cross(rate, self.inertia * rate)) / self.inertia


def torque_cost(q, u):
    """The third torque costs nothing."""
    return u[:2] @ u[:2] / 2 + q[1] @ q[1]


def measure_classification(repeats):
    """Seconds of ``classify`` on a phase space of dimension 12 with 3 controls."""

    def run(inertia, seed):
        problem = OptimalControlProblem(SO(3) * Euclidean(3), RigidBody(jnp.array(inertia)), torque_cost, 3)
        return timed(lambda: classify(problem, seed=seed).stratum.q)

    cold = run((1.0, 1.7, 2.3), 0)
    warm = [run((1.0, 1.7, 2.3 + i / 10), i) for i in range(1, repeats + 1)]
    return {
        "problem": "free actuator",
        "classify, cold seconds": round(cold, 2),
        "warm": round(statistics.median(warm), 2),
    }


def made_regular(problem):
    """The problem with a cost of its controls."""
    return OptimalControlProblem(
        problem.manifold, problem.dynamics, lambda q, u: problem.running_cost(q, u) + u @ u / 2, problem.controls
    )


def timed(run):
    """Seconds of one call, to the end of its computation."""
    began = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - began


def measure(name, strategies, steps, repeats):
    """One record for each strategy on a problem."""
    problem = SINGULAR[name]().problem
    classification, discretization = classify(problem), Midpoint(default_retraction(problem.manifold))
    start = classification.stratum.q, classification.stratum.p
    if classification.codimension:
        start = classification.manifold.nearby(jax.tree.map(jnp.asarray, start))
    regular = made_regular(problem), PresymplecticIntegrator(CotangentLift(discretization))
    systems = {"regular": regular} | {
        s: (problem, singular_integrator(classification, discretization, s)[0]) for s in strategies
    }
    runs = {
        key: lambda system=system, method=method: integrate(system, method, start, STEP, steps, save_every=steps).q
        for key, (system, method) in systems.items()
    }
    cold = {key: timed(run) for key, run in runs.items()}
    warm = {key: [] for key in runs}
    for _ in range(repeats):
        for key, run in runs.items():
            warm[key].append(timed(run))
    medians = {key: statistics.median(seconds) for key, seconds in warm.items()}
    for key in strategies:
        yield {
            "problem": name,
            "strategy": key,
            "microseconds per step": round(1e6 * medians[key] / steps, 2),
            "regular": round(1e6 * medians["regular"] / steps, 2),
            "ratio": round(medians[key] / medians["regular"], 2),
            "cold seconds": round(cold[key], 2),
        }


def main():
    """Print one line for each problem and strategy."""
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    print(json.dumps(measure_classification(options.repeats)), flush=True)
    for name, strategies in CASES.items():
        for record in measure(name, strategies, options.steps, options.repeats):
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
