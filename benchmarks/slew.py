"""The rest-to-rest slew beside CasADi with IPOPT: warm and cold times, time per step, peak memory.

    python benchmarks/slew.py [--steps 50 100 200 400] [--repeats 21]

Both sides solve the same problem by a midpoint scheme from the same kind of guess (attitude interpolated, rates zero), in one
run, calls taken in turns. Warm: a re-solve with everything built, wall time of the whole call, median. Cold: a new process
from its start to the first solution; for retrax with an empty and with a filled compilation cache. One JSON line a case.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COLD = "--cold"
TOLERANCE = 1e-8  # relative, as IPOPT and FATROP are asked for


def retrax_slew(steps):
    """A function that solves the slew with retrax and returns its cost."""
    import jax
    import jax.numpy as jnp
    import numpy as np
    from retrax.integrators import OptimalControlProblem, solve
    from retrax.manifolds import SO, Euclidean, hat
    from retrax.retractions import Cayley, Midpoint

    jax.config.update("jax_enable_x64", True)
    inertia = jnp.array([5621.0, 4547.0, 2364.0])
    manifold = SO(3) * Euclidean(3)

    def dynamics(q, u):
        attitude, rate = q
        return attitude @ hat(rate), (u - jnp.cross(rate, inertia * rate)) / inertia

    problem = OptimalControlProblem(manifold, dynamics, lambda q, u: u @ u / 2, controls=3)
    angle, axis = np.deg2rad(150), np.array([1.0, 2.0, -2.0]) / 3
    cross = np.cross(np.eye(3), -axis)
    target = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    start, end = (np.eye(3), np.zeros(3)), (target, np.zeros(3))
    discretization = Midpoint(Cayley(manifold))
    return lambda: solve(problem, discretization, start, end, horizon=60.0, steps=steps, tolerance=TOLERANCE)


def casadi_slews(steps):
    """Functions that solve the slew with CasADi: two transcriptions for IPOPT, one for FATROP."""
    from casadi_slew import CasadiSlew, FatropSlew

    solvers = {
        "IPOPT, torque eliminated": CasadiSlew(steps),
        "IPOPT, torque unknown": CasadiSlew(steps, torque_variables=True),
        "FATROP": FatropSlew(steps),
    }
    return {name: slew.solve for name, slew in solvers.items()}


def warm(steps, repeats):
    """Median seconds of a warm solve on each side, calls taken in turns, and the costs."""
    calls = {"retrax": retrax_slew(steps), **casadi_slews(steps)}
    first = calls["retrax"]()
    costs = {"retrax": first.cost, **{name: call()[0] for name, call in calls.items() if name != "retrax"}}
    seconds = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            began = time.perf_counter()
            call()
            seconds[name].append(time.perf_counter() - began)
    medians = {name: statistics.median(values) for name, values in seconds.items()}
    return {
        "case": "warm",
        "steps": steps,
        "median_ms": {name: round(1e3 * value, 3) for name, value in medians.items()},
        "microseconds_per_step": {name: round(1e6 * value / steps, 1) for name, value in medians.items()},
        "retrax_over": {name: round(medians["retrax"] / value, 2) for name, value in medians.items() if name != "retrax"},
        "newton_steps": first.statistics.iterations,
        "first_solve_compile_s": round(first.statistics.compile_seconds, 2),
        "cost": costs,
    }


def cold_process(side, environment):
    """Wall seconds and peak memory (MiB) of a new process that solves once with 100 steps."""
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, __file__, COLD, side], env={**os.environ, **environment}, stdout=subprocess.PIPE)
    output, _ = process.communicate()
    seconds = time.perf_counter() - began
    if process.returncode:
        raise RuntimeError(f"the cold run of {side} failed with exit code {process.returncode}")
    return seconds, json.loads(output)["peak_mib"]


def cold(repeats):
    """Median seconds from the start of a process to its first solution, and peak memory, on each side."""
    rows = {}
    with tempfile.TemporaryDirectory() as cache:
        cached = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_COMPILATION_CACHE_MIN_COMPILE_TIME_SECS": "0"}
        uncached = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
        cold_process("retrax", cached)
        cases = (("retrax", "retrax", uncached), ("retrax, cache warm", "retrax", cached), ("IPOPT", "casadi", {}))
        for name, side, environment in cases:
            runs = [cold_process(side, environment) for _ in range(repeats)]
            rows[name] = {
                "median_s": round(statistics.median(run[0] for run in runs), 2),
                "peak_mib": round(statistics.median(run[1] for run in runs)),
            }
    return {"case": "cold process, 100 steps", **rows}


def run_cold(side):
    """What a cold process does: solve once, then print its own peak memory."""
    if side == "retrax":
        retrax_slew(100)()
    else:
        from casadi_slew import CasadiSlew

        CasadiSlew(100).solve()
    status = Path("/proc/self/status").read_text()  # ru_maxrss would count the parent's memory before exec
    peak = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    print(json.dumps({"peak_mib": int(peak) / 1024}))


def main():
    """Print one JSON line for each case."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, nargs="+", default=[50, 100, 200, 400])
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument(COLD, choices=["retrax", "casadi"], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cold:
        run_cold(options.cold)
        return
    for steps in options.steps:
        print(json.dumps(warm(steps, options.repeats)), flush=True)
    print(json.dumps(cold(max(3, options.repeats // 5))), flush=True)


if __name__ == "__main__":
    main()
