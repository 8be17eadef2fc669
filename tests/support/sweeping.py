"""A small study for sweeps, in a module that other processes import; as a script it sweeps with workers until one is
killed."""

import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import jax
import numpy as np
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Gauss, default_retraction
from retrax.sweeps import Study, sweep

LINE = Euclidean(2)
COUNT, CHUNK = 200, 10
UNREACHED, REFUSED = 13, 27  # of 50 members: an end out of reach in 12 iterations, and a horizon below zero


def drift(q, u, mass):
    """A cart of some mass under a force, with a spring that stiffens."""
    return jax.numpy.stack([q[1], (u[0] - q[0] ** 3) / mass])


def cases(members, log=None, pause=0.0):
    """Carts of random mass that go to random places; the numbers of the members and the process go to a log."""
    if log is not None:
        with Path(log).open("a") as file:
            file.write("".join(f"{member} {os.getpid()}\n" for member in members))
    time.sleep(pause)
    drawn = np.stack([np.random.default_rng([3, int(member)]).uniform(1, 2, 2) for member in members])
    ends = np.stack([drawn[:, 0], np.zeros(len(members))], axis=1)
    ends[members % 50 == UNREACHED] = 1e9
    horizons = np.where(members % 50 == REFUSED, -1.0, 1.0)
    return {"starts": np.zeros(2), "ends": ends, "horizons": horizons, "parameters": drawn[:, 1], "max_iterations": 12}


def peaks(solutions):
    """The largest force, and the last state."""
    return {"peak": np.max(np.abs(solutions.controls), axis=(1, 2)), "end": solutions.states[:, -1]}


def study(log=None, pause=0.0, steps=4, law=drift, of=cases, keep=peaks):
    """Carts of random mass on a line."""
    problem = OptimalControlProblem(LINE, law, running_cost=lambda q, u, mass: u @ u / 2, controls=1)
    return Study(Solver(problem, Gauss(2, default_retraction(LINE)), steps), partial(of, log=log, pause=pause), keep)


@contextmanager
def workers(kind):
    """An executor of workers in processes of their own."""
    if kind == "processes":
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            yield pool
    elif kind == "mpi":
        from mpi4py.futures import MPIPoolExecutor

        with MPIPoolExecutor() as pool:
            yield pool
    else:
        from distributed import Client, LocalCluster

        how = {"n_workers": 3, "threads_per_worker": 1, "dashboard_address": None}
        with LocalCluster(**how) as cluster, Client(cluster) as client:
            yield client.get_executor()


if __name__ == "__main__":
    with workers(sys.argv[1]) as executor:
        folder = Path(sys.argv[2])
        sweep(partial(study, str(folder / "log"), float(sys.argv[3])), COUNT, folder / "sweep", executor, CHUNK)
