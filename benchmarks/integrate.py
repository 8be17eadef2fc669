"""Free rigid body and spherical pendulum: steps per second, beside SciPy's DOP853 and diffrax at the same final error.

    python benchmarks/integrate.py [--method midpoint] [--horizon 20] [--step 0.02] [--repeats 7]

The method takes its fixed steps; its final error is the target at which both peers are then tuned to their loosest
tolerance. Warm medians of one run of a flow that is held, and of ``integrate``, which traces the Hamiltonian anew;
processor seconds of the run, of all threads; the first call apart. One JSON line a case.
"""

import argparse
import json
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np
from ode_peers import BATCH, PENDULUM, RIGID_BODY, TargetMissedError, diffrax_solve, final_error, scipy_dop853, timed
from retrax.integrators import KAHAN_LI_6, KAHAN_LI_8, Composition, Flow, SymplecticIntegrator
from retrax.manifolds import SO, Sphere
from retrax.retractions import Cayley, CotangentLift, Gauss, Midpoint, Projection

ROTATIONS, SPHERE = SO(3), Sphere(2)
INERTIA = jnp.array([1.0, 2.0, 3.0])


def rigid_body(q, p):
    """Kinetic energy of a free rigid body, from its body momentum."""
    momentum = ROTATIONS.body(q, p)
    return momentum @ (momentum / INERTIA) / 2


def pendulum(q, p):
    """Energy of the spherical pendulum."""
    return p @ p / 2 + q[2]


def rigid_point(x):
    """The peers' 12 numbers, attitude by rows and body momentum, as a point of T*SO(3)."""
    q = x[:9].reshape(3, 3)
    return q, ROTATIONS.covector(q, x[9:])


def rigid_state(q, p):
    """A point of T*SO(3) as the peers' 12 numbers."""
    return jnp.concatenate([q.reshape(9), ROTATIONS.body(q, p)])


CASES = (
    (RIGID_BODY, rigid_body, Cayley(ROTATIONS), rigid_point, rigid_state),
    (PENDULUM, pendulum, Projection(SPHERE), lambda x: (x[:3], x[3:]), lambda q, p: jnp.concatenate([q, p])),
)


def lifted_midpoint(retraction):
    """The method of order 2 that the others are composed of."""
    return SymplecticIntegrator(CotangentLift(Midpoint(retraction)))


METHODS = {
    "midpoint": lifted_midpoint,
    "composition-6": lambda retraction: Composition(lifted_midpoint(retraction), KAHAN_LI_6),
    "composition-8": lambda retraction: Composition(lifted_midpoint(retraction), KAHAN_LI_8),
    "gauss-3": lambda retraction: SymplecticIntegrator(Gauss(3, retraction)),
    "gauss-4": lambda retraction: SymplecticIntegrator(Gauss(4, retraction)),
}


def retrax_run(case, method, step, steps, batch, repeats):
    """Seconds per run of a held flow, of one made anew (medians), processor seconds, seconds of the first run, final
    error."""
    problem, hamiltonian, retraction, point, state = case
    integrator = METHODS[method](retraction)
    initial = jnp.asarray(problem.initial_states(batch))
    start = jax.vmap(point)(initial) if batch else point(initial)

    def run(flow):
        return (flow.integrate_many if batch else flow.integrate)(start, step, steps, save_every=steps)

    (cold,) = timed(lambda: run(Flow(hamiltonian, integrator)), 1)
    anew = statistics.median(timed(lambda: run(Flow(hamiltonian, integrator)), repeats))
    flow = Flow(hamiltonian, integrator)
    run(flow)
    seconds = statistics.median(timed(lambda: run(flow), repeats))
    began = time.process_time()
    end = run(flow)
    spent = time.process_time() - began
    final = jax.vmap(lambda q, p: state(q[-1], p[-1]))(end.q, end.p) if batch else state(end.q[-1], end.p[-1])
    return seconds, anew, spent, cold, final_error(problem, step * steps, np.asarray(final))


def peer_row(run):
    """What is printed of a peer."""
    return {
        "median_ms": round(1e3 * run.seconds, 3),
        "cold_s": round(run.cold_seconds, 2),
        "steps": run.steps,
        "error": run.error,
    }


def compare(case, method, step, steps, batch, repeats):
    """One case: this library and the peers at its final error."""
    problem, horizon = case[0], step * steps
    seconds, anew, spent, cold, error = retrax_run(case, method, step, steps, batch, repeats)
    row = {
        "case": problem.name,
        "method": method,
        "trajectories": batch or 1,
        "horizon": horizon,
        "step": step,
        "steps": steps,
        "error": error,
    }
    row["retrax"] = {
        "median_ms": round(1e3 * seconds, 3),
        "traced_anew_ms": round(1e3 * anew, 3),
        "processor_ms": round(1e3 * spent, 3),
        "cold_s": round(cold, 2),
        "steps_per_second": round((batch or 1) * steps / seconds),
    }
    peers = {
        f"diffrax {solver}": lambda s=solver: diffrax_solve(problem, horizon, error, batch, s, repeats)
        for solver in ("dopri5", "dopri8")
    }
    if not batch:
        peers["scipy DOP853"] = lambda: scipy_dop853(problem, horizon, error, repeats)
    for name, peer in peers.items():
        try:
            run = peer()
        except TargetMissedError as missed:
            row[name] = str(missed)
        else:
            row[name] = peer_row(run) | {"retrax_over": round(seconds / run.seconds, 2)}
    return row


def main():
    """Print one JSON line for each problem and batch size."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--method", choices=METHODS, default="midpoint")
    parser.add_argument("--horizon", type=float, default=20.0)
    parser.add_argument("--step", type=float, default=0.02)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    steps = round(options.horizon / options.step)
    for case in CASES:
        for batch in (None, BATCH):
            print(json.dumps(compare(case, options.method, options.step, steps, batch, options.repeats)), flush=True)


if __name__ == "__main__":
    main()
