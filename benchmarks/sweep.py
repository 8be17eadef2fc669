"""10 000 slews of spacecraft of random inertia to random attitudes: throughput of a worker, and what executor and store
cost.

Counted is time of the processor, so that other programs on the machine do not count. ``alone`` is ``solve_many`` in one
thread, chunk by chunk, without a sweep. The overhead of a sweep is all time of its processes that is not spent in
solves, from the difference of two sweeps of different lengths: what a worker needs once, its imports and first solves,
is shown apart.

    python benchmarks/sweep.py [--members 10000] [--workers 2] [--chunk 100] [--steps 60]
"""

import argparse
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from retrax.compute.threads import one_thread
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Cayley, Midpoint
from retrax.sweeps import Study, sweep
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)
INERTIA = np.array([5621.0, 4547.0, 2364.0])  # kg m^2
TARGET = np.deg2rad(150) * np.array([1, 2, -2]) / 3  # rotation vector
Q = SO(3) * Euclidean(3)
FEW = 2000


def dynamics(q, u, inertia):
    R, w = q
    return R @ hat(w), (u - jnp.cross(w, inertia * w)) / inertia


def cases(members):
    drawn = np.stack([np.random.default_rng([2026, int(member)]).standard_normal(6) for member in members])
    ends = Rotation.from_rotvec(TARGET + np.deg2rad(10) * drawn[:, :3]).as_matrix(), np.zeros(3)
    inertia = INERTIA * (1 + 0.05 * drawn[:, 3:])
    return {"starts": (np.eye(3), np.zeros(3)), "ends": ends, "horizons": 60.0, "parameters": inertia}


def study(steps):
    problem = OptimalControlProblem(Q, dynamics, running_cost=lambda q, u, inertia: u @ u / 2, controls=3)
    return Study(Solver(problem, Midpoint(Cayley(Q)), steps), cases)


def processor_seconds():
    """Of this process and of those that it began and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def alone(count, chunk, steps):
    """Seconds of the processor that ``solve_many`` takes for each member."""
    own = study(steps)
    own.solver.solve_many(**own.cases(np.arange(chunk)))
    began = time.process_time()
    with one_thread():
        for first in range(0, count, chunk):
            own.solver.solve_many(**own.cases(np.arange(first, first + chunk)))
    return (time.process_time() - began) / count


def swept(count, chunk, steps, workers):
    """The sweep in a pool, and the seconds of the processor, all and those of the solves."""
    began = processor_seconds()
    with tempfile.TemporaryDirectory() as folder:
        with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
            found = sweep(partial(study, steps), count, Path(folder), pool, chunk, verbose=True)
        solves = sum(work.cpu_seconds for work in found.workers.values())
        print(found)
        for name, work in found.workers.items():
            print(f"  {name}: {work.members} members in {work.cpu_seconds:.1f} s of the processor")
        size = sum(path.stat().st_size for path in Path(folder).rglob("*.npz"))
        print(f"  {size / count:.0f} bytes a member")
    return processor_seconds() - began, solves


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    for name, default in (("members", 10_000), ("workers", 2), ("chunk", 100), ("steps", 60)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    how = options.chunk, options.steps
    each = alone(FEW, *how)
    print(f"alone: {1 / each:.0f} members a second of the processor, {1e3 * each:.2f} ms each")
    (few, few_solves), (many, many_solves) = (swept(n, *how, options.workers) for n in (FEW, options.members))
    rate = (options.members - FEW) / (many_solves - few_solves)
    overhead = (many - few) / (many_solves - few_solves) - 1
    once = few - FEW / rate * (1 + overhead)
    print(
        f"in a worker: {rate:.0f} members a second of the processor; overhead of store and executor: {overhead:.2%} of "
        "the solves"
    )
    print(f"imports and first solves of the process that leads and of its workers: {once:.1f} s in all")


if __name__ == "__main__":
    main()
