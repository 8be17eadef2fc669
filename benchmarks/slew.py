"""The rest-to-rest slew beside CasADi with IPOPT and FATROP: warm, for a new problem, cold, many at once, and long.

    python benchmarks/slew.py [--only warm limited fastest new cold many batch long] [--steps 100 200 400]
        [--repeats 21]

All sides solve the same problem by a midpoint scheme from the same kind of guess (attitude interpolated, rates zero),
in one run, calls taken in turns; medians. One JSON line a case.

- ``warm``: a solve with everything built, the whole call; of calls in turns, where each finds the processor's
  caches filled by the other sides, and of ten in a row, as a controller makes them.
- ``limited``: the same with each torque within 10 N m, which one of them reaches in three tenths of the horizon; IPOPT
  alone.
- ``fastest``: in the least time with each torque within 50 N m; IPOPT alone.
- ``new``: in a running process that solved another problem before, from a body of other inertia to its first solution.
- ``cold``: a new process from its start to the first solution, and its peak memory.
- ``many``: 1024 slews from the identity, by 30 to 170 degrees about random axes, each to an attitude error of 1e-6 rad
  as propagated (``repropagation.py``), by collocation of order 6 and 8: ours at once, FATROP one after the other.
- ``device``, only if it is asked for: the same by ours alone, by the tape and by XLA where that computes, as on a GPU.
- ``batch``: 256 such slews in 100 midpoint steps with each torque within 12 N m, all at once; how many are solved.
- ``long``: time per step from 100 to 10 000 steps.
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
CASES = ("warm", "limited", "fastest", "new", "cold", "many", "batch", "long")
ROW = 10  # calls
TOLERANCE = 1e-8  # relative, as IPOPT and FATROP are asked for
LIMIT, STRONG, OF_A_BATCH = 10.0, 50.0, 12.0  # N m
BATCH = 256  # slews
COUNT, LARGEST_ERROR = 1024, 1e-6  # slews; rad
STAGES, FEW = (3, 4), (4, 5, 6, 8, 10, 12, 16, 20)  # of collocation; the fewest steps that reach the error are taken
ON_DEVICE = 5  # steps of the slews that XLA computes too, as in `many`
MOST = 0.99  # of the slews that reach it: a solver that ends elsewhere from some guess does so with any number of steps


def timed(call):
    """Seconds that a call takes."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def in_turns(calls, repeats, row=1):
    """Median seconds of each call, some in a row."""
    seconds = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            seconds[name] += [timed(call) for _ in range(row)]
    return {name: statistics.median(values) for name, values in seconds.items()}


def casadi_slews(steps):
    """The slew with CasADi: two transcriptions for IPOPT, one for FATROP."""
    from casadi_slew import CasadiSlew, FatropSlew

    return {
        "IPOPT, torque eliminated": CasadiSlew(steps),
        "IPOPT, torque unknown": CasadiSlew(steps, torque_variables=True),
        "FATROP": FatropSlew(steps),
    }


def warm(steps, repeats):
    """Median milliseconds of a warm solve on each side, and the costs."""
    from retrax_slew import RetraxSlew

    slews = {"retrax": RetraxSlew(steps), **casadi_slews(steps)}
    costs = {name: slew.solve() if name == "retrax" else slew.solve()[0] for name, slew in slews.items()}
    calls, rows = {name: slew.solve for name, slew in slews.items()}, {}
    for words, row in (("in turns", 1), ("in a row", ROW)):
        medians = in_turns(calls, repeats, row)
        ours, ipopt = medians["retrax"], min(value for name, value in medians.items() if name.startswith("IPOPT"))
        over = {"the faster IPOPT": round(ours / ipopt, 2), "FATROP": round(ours / medians["FATROP"], 2)}
        rows[words] = {"median_ms": {name: round(1e3 * t, 3) for name, t in medians.items()}, "retrax_over": over}
    return {"case": "warm", "steps": steps, **rows, "cost": costs}


def limited(steps, repeats):
    """Median milliseconds of a warm solve with limited torques on both sides, and the costs."""
    from casadi_slew import CasadiSlew
    from retrax_slew import RetraxSlew

    ours, other = RetraxSlew(steps, torque_limit=LIMIT), CasadiSlew(steps, torque_variables=True, torque_limit=LIMIT)
    return {"case": "limited", **beside_ipopt(ours, other, steps, repeats)}


def fastest(steps, repeats):
    """The same for the least time with limited torques: the costs are seconds."""
    import casadi_slew
    import retrax_slew

    pair = retrax_slew.LeastTimeSlew(steps, STRONG), casadi_slew.LeastTimeSlew(steps, STRONG)
    return {"case": "fastest", **beside_ipopt(*pair, steps, repeats)}


def beside_ipopt(ours, other, steps, repeats):
    """Median milliseconds of a warm solve of both sides, iterations and costs."""
    costs = {"retrax": ours.solve(), "IPOPT": other.solve()[0]}
    medians = in_turns({"retrax": ours.solve, "IPOPT": other.solve}, repeats)
    return {
        "steps": steps,
        "median_ms": {name: round(1e3 * value, 3) for name, value in medians.items()},
        "iterations": {"retrax": ours.found.statistics.iterations, "IPOPT": other.iterations},
        "retrax_over": {"IPOPT": round(medians["retrax"] / medians["IPOPT"], 2)},
        "cost": costs,
    }


def new_problem(repeats):
    """Median seconds from a problem that the process has not seen to its first solution, 100 steps."""
    import casadi_slew
    import numpy as np
    from retrax_slew import INERTIA, RetraxSlew

    inertias = iter(INERTIA * (1 + np.random.default_rng(0).uniform(-0.1, 0.1, (3 * repeats + 3, 3))))

    def peer(kind):
        casadi_slew.SCALED_INERTIA = next(inertias) / INERTIA.max()
        return kind(100).solve()

    calls = {
        "retrax": lambda: RetraxSlew(100, inertia=next(inertias)).solve(),
        "IPOPT": lambda: peer(casadi_slew.CasadiSlew),
        "FATROP": lambda: peer(casadi_slew.FatropSlew),
    }
    own = casadi_slew.SCALED_INERTIA
    try:
        for call in calls.values():
            call()
        medians = in_turns(calls, repeats)
    finally:
        casadi_slew.SCALED_INERTIA = own  # `many` makes its peers of this body
    return {"case": "new problem, 100 steps", "median_s": {k: round(v, 3) for k, v in medians.items()}}


def cold_process(side, environment):
    """Wall seconds to the solution and to the end, and peak memory (MiB), of a new process that solves once with 100
    steps."""
    began = time.time()
    process = subprocess.Popen(
        [sys.executable, __file__, COLD, side], env={**os.environ, **environment}, stdout=subprocess.PIPE
    )
    output, _ = process.communicate()
    ended = time.time()
    if process.returncode:
        raise RuntimeError(f"the cold run of {side} failed with exit code {process.returncode}")
    told = json.loads(output)
    return told["solved"] - began, ended - began, told["peak_mib"]


def cold(repeats):
    """Median seconds from the start of a process to its first solution, and to its end, and peak memory, on each side;
    and ours on a computer's very first use, once."""
    rows = {}
    with tempfile.TemporaryDirectory() as cache:
        cached = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
        uncached = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
        cold_process("retrax", cached)
        cases = (
            ("retrax", "retrax", uncached),
            ("retrax, XLA's cache filled", "retrax", cached),
            ("IPOPT", "ipopt", {}),
            ("FATROP", "fatrop", {}),
        )
        for name, side, environment in cases:
            rows[name] = cold_row([cold_process(side, environment) for _ in range(repeats)])
    return {"case": "cold process, 100 steps", **rows}


def cold_row(runs):
    """Medians of what cold processes took."""
    solved, ended, peak = map(statistics.median, zip(*runs, strict=True))
    return {"median_s": round(solved, 2), "ended_s": round(ended, 2), "peak_mib": round(peak)}


def run_cold(side):
    """What a cold process does: solve once, then print when it was there, and its own peak memory."""
    if side == "retrax":
        from retrax_slew import RetraxSlew

        RetraxSlew(100).solve()
    else:
        import casadi_slew

        {"ipopt": casadi_slew.CasadiSlew, "fatrop": casadi_slew.FatropSlew}[side](100).solve()
    solved = time.time()
    status = Path("/proc/self/status").read_text()  # ru_maxrss would count the parent's memory before exec
    peak = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    print(json.dumps({"solved": solved, "peak_mib": int(peak) / 1024}))


def random_targets():
    """Angles (rad) and unit axes of the slews."""
    import numpy as np

    random = np.random.default_rng(0)
    axes = random.normal(size=(COUNT, 3))
    return np.deg2rad(random.uniform(30, 170, COUNT)), axes / np.linalg.norm(axes, axis=1, keepdims=True)


def errors(torques, angles, axes):
    """The attitude errors, rad."""
    from repropagation import attitude_error

    return [attitude_error(*parts) for parts in zip(torques, angles, axes, strict=True)]


def at_once(steps, stages, angles, axes, evaluator="automatic"):
    """All slews at once: the seconds of the first call, their errors, and a call that solves them again."""
    import numpy as np
    from retrax_slew import HORIZON, RetraxSlew, at_rest, polynomials, turns

    start, ends = at_rest(np.eye(3)), at_rest(turns(angles, axes))
    solver = RetraxSlew(steps, stages, TOLERANCE, evaluator=evaluator).solver

    def call():
        return solver.solve_many(start, ends, HORIZON, tolerance=TOLERANCE)

    began = time.perf_counter()
    found = call()
    seconds = time.perf_counter() - began
    torques = [polynomials(s.require_success().times, s.stage_times, s.controls) for s in found]
    return seconds, errors(torques, angles, axes), call


def many_of_ours(stages, angles, axes):
    """All slews at once: for each number of steps their errors and a call that solves them again."""
    for steps in FEW:
        yield steps, *at_once(steps, stages, angles, axes)[1:]


def many_of_fatrop(stages, angles, axes):
    """The same, one after the other; guesses and ends are made before."""
    from casadi_orders import OrderedSlew

    for steps in FEW:
        slew, torques = OrderedSlew(f"Gauss {stages}", steps, "fatrop", tolerance=TOLERANCE), []
        targets = [slew.target(*parts) for parts in zip(angles, axes, strict=True)]
        for target in targets:
            slew.solve(target)
            torques.append(slew.torque())

        def call(slew=slew, targets=targets):
            return [slew.solve(target) for target in targets]

        yield steps, errors(torques, angles, axes), call


def fewest(solutions):
    """The first solutions of which most reach the error, else the last: their steps, how many reach it, and the
    call."""
    for steps, found, call in solutions:
        chosen = steps, sum(error <= LARGEST_ERROR for error in found), call
        if chosen[1] >= MOST * COUNT:
            break
    return chosen


def many():
    """Milliseconds a slew of 1024 with different targets."""
    targets, rows = random_targets(), {}
    for name, solves in (("FATROP", many_of_fatrop), ("retrax", many_of_ours)):
        for stages in STAGES:
            steps, reached, call = fewest(solves(stages, *targets))
            seconds = statistics.median(timed(call) for _ in range(3))
            rows[f"{name}, Gauss {stages}"] = {
                "ms_each": round(1e3 * seconds / COUNT, 4),
                "steps": steps,
                "reached": reached,
            }
    return {"case": f"{COUNT} slews", **rows}


def device(repeats):
    """Milliseconds a slew of the same, four stages, by the tape and by XLA where that computes; seconds of the first
    call; how many reach the error."""
    import jax

    rows = {}
    for evaluator in ("tape", "xla"):
        first, found, call = at_once(ON_DEVICE, 4, *random_targets(), evaluator)
        rows[evaluator] = {
            "first_s": round(first, 1),
            "ms_each": round(1e3 * statistics.median(timed(call) for _ in range(repeats)) / COUNT, 3),
            "reached": sum(error <= LARGEST_ERROR for error in found),
        }
    return {"case": f"{COUNT} slews", "device": str(jax.devices()[0]), "processors": os.cpu_count(), **rows}


def batch(repeats):
    """Milliseconds a slew of a batch with limited torques."""
    import numpy as np
    from retrax_slew import HORIZON, RetraxSlew, at_rest, turns

    angles, axes = random_targets()
    slew, ends = RetraxSlew(100, torque_limit=OF_A_BATCH), at_rest(turns(angles[:BATCH], axes[:BATCH]))

    def call():
        return slew.solver.solve_many(at_rest(np.eye(3)), ends, HORIZON, tolerance=TOLERANCE)

    solved = int(np.sum(call().success))
    seconds = statistics.median(timed(call) for _ in range(repeats))
    return {"case": f"{BATCH} limited slews", "ms_each": round(1e3 * seconds / BATCH, 3), "solved": solved}


def long(repeats):
    """Microseconds a step of ours with 100 to 10 000 steps, midpoint scheme."""
    from retrax_slew import RetraxSlew

    rows = {}
    for steps in (100, 1000, 10_000):
        slew = RetraxSlew(steps)
        slew.solve()
        rows[str(steps)] = round(1e6 * statistics.median(timed(slew.solve) for _ in range(repeats)) / steps, 2)
    return {"case": "long", "microseconds_a_step": rows}


def main():
    """Print one JSON line for each case."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=(*CASES, "device"), default=CASES)
    parser.add_argument("--steps", type=int, nargs="+", default=[100, 200, 400])
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument(COLD, choices=["retrax", "ipopt", "fatrop"], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cold:
        run_cold(options.cold)
        return
    few = max(3, options.repeats // 4)
    runs = [("warm", lambda steps=steps: warm(steps, options.repeats)) for steps in options.steps]
    runs += [("limited", lambda steps=steps: limited(steps, options.repeats)) for steps in options.steps]
    runs += [("fastest", lambda steps=steps: fastest(steps, few)) for steps in options.steps]
    runs += [
        ("new", lambda: new_problem(few)),
        ("cold", lambda: cold(few)),
        ("many", many),
        ("device", lambda: device(few)),
        ("batch", lambda: batch(few)),
        ("long", lambda: long(few)),
    ]
    for name, run in runs:
        if name in options.only:
            print(json.dumps(run()), flush=True)


if __name__ == "__main__":
    main()
