"""The work of a worker: make the study once, solve chunks of members, and write them to the store."""

import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..compute.threads import one_thread
from ..manifolds import InvalidInputError
from ..manifolds.numerics.precision import working_precision
from .store import Store
from .study import Study, make_study, solve_members

_own = threading.local()  # what a solver computes with belongs to its thread
_making = threading.Lock()


class Job(NamedTuple):
    """The orders to every worker of a sweep, beside its chunk; each call of ``sweep`` has its own ``token``."""

    build: Callable[[], Any]
    folder: str
    total: int
    chunk: int
    token: str
    precision: str
    alone: bool  # whether other workers need the other processors


class ChunkResult(NamedTuple):
    """How many members of a chunk were solved, and how many have no success."""

    members: int
    failed: int


def run(job: Job, part: int) -> ChunkResult:
    """Solve a chunk of members, and write what was found."""
    store = Store(Path(job.folder), job.total, job.chunk)
    study = _study(job)
    clock, cpu = time.perf_counter(), time.thread_time() if job.alone else time.process_time()
    with one_thread() if job.alone else nullcontext():
        found = solve_members(study, store.members(part))
    seconds = time.perf_counter() - clock, (time.thread_time() if job.alone else time.process_time()) - cpu
    store.write(part, found, seconds)
    return ChunkResult(len(found["success"]), int(np.sum(~found["success"])))


def _study(job: Job) -> Study:
    """The study of a sweep, made once in each thread that works for it."""
    if getattr(_own, "token", None) != job.token:
        _own.study = None  # the one before, with all that it holds
        here = str(working_precision())
        if here != job.precision:
            raise InvalidInputError(
                f"a worker computes in {here}, and the process that began the sweep in {job.precision}; "
                'try jax.config.update("jax_enable_x64", True) inside of build, or JAX_ENABLE_X64=1 in the '
                "environment of workers"
            )
        with _making:
            _own.study = make_study(job.build)
        _own.token = job.token
    return _own.study


def adopt(study: Study, token: str) -> None:
    """Take a study that was made in this process as the study of a sweep."""
    _own.study, _own.token = study, token
