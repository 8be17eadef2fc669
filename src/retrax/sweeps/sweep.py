"""A sweep: chunks of members are handed to an executor until all are in the store."""

import logging
import uuid
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Executor, Future
from contextlib import closing
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from ..integrators.problem.argument_errors import require_known_options
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError, RetraxError
from ..manifolds.numerics.ambient import is_count
from ..manifolds.numerics.precision import working_precision
from ..progress import progress
from .record import Sweep
from .store import open_store
from .study import Study, make_study, marks
from .worker import ChunkResult, Job, adopt, run

AHEAD = 1000  # chunks that wait for a worker: more than workers, and few to hold in memory
log = logging.getLogger(__name__)


@require_known_options
def sweep(
    build: Callable[[], Study],
    count: int,
    folder: str | Path,
    executor: Executor | None = None,
    chunk: int = 100,
    verbose: bool = False,
) -> Sweep:
    """Solve many cases of a problem in chunks, on any executor, into a folder; continue where an earlier call
    ended.

    Parameters
    ----------
    build : callable
        A function without arguments at the top level of a module that returns a ``Study``. It is called here and once
        in each worker, or in each thread if workers are threads.
    count : int
        The number of members.
    folder : str or Path
        The folder of the results; all workers must have access to it.
    executor : concurrent.futures.Executor, optional
        Such as a ``ProcessPoolExecutor`` that spawns, ``client.get_executor()`` of ``dask.distributed``, or
        ``mpi4py.futures.MPIPoolExecutor``. By default this process solves, on all processors.
    chunk : int
        The number of members that are written together; ``solve_many`` gets at most 100 at once.
    verbose : bool
        Whether to show the progress: a bar with tqdm in a terminal, otherwise lines of the logger ``retrax``.

    Returns
    -------
    Sweep
        The finished members.

    Raises
    ------
    InvalidInputError
        For other arguments, a folder of another sweep, and workers in another precision.

    Notes
    -----
    A chunk is in the folder completely or not at all, and a finished chunk is not solved again. After a crash or an
    interrupt, call ``sweep`` with the same arguments. A member without a solution has the reason as its ``result``. Any
    other error in a function of the study, and the end of an executor, ends the sweep and is raised; finished chunks
    stay. An interrupt is a ``KeyboardInterrupt`` whose argument is the ``Sweep`` until then.

    Workers use one processor each for problems on the tape; functions that XLA compiled use threads of XLA.
    """
    _check(build, count, executor, chunk)
    study, where = make_study(build), Path(folder).absolute()
    store = open_store(where, count, chunk, marks(study, count))
    there = store.finished_chunks()
    job = Job(build, str(where), count, chunk, uuid.uuid4().hex, str(working_precision()), executor is not None)
    if executor is None:
        adopt(study, job.token)
    done = sum(len(store.members(part)) for part in there)
    log.info("%d of %d members are in %s", done, count, where)
    missing = sorted(set(range(store.parts)) - set(there))
    with (
        progress("sweep", count, "members", verbose, done) as advance,
        closing(_completed_chunks(job, missing, executor)) as finished,
    ):
        try:
            failed = 0
            for some in finished:
                failed += some.failed
                advance(some.members, f"{failed} without success")
        except KeyboardInterrupt as interrupt:
            interrupt.args = (Sweep(store),)
            raise
        except Exception as error:
            kept = len(Sweep(store))
            error.add_note(
                f"{kept} of {count} members are in {where}; call sweep again with the same arguments to go on"
            )
            raise
    return _whole(Sweep(store))


def _check(build: Any, count: Any, executor: Any, chunk: Any) -> None:
    if not callable(build):
        raise InvalidInputError(
            f"build must be a function that returns a Study, got {brief(build)}; try a function of a module"
        )
    for name, value in (("count", count), ("chunk", chunk)):
        if not is_count(value):
            raise InvalidInputError(f"{name} must be a whole number of at least 1, got {brief(value)}")
    if not (executor is None or callable(getattr(executor, "submit", None))):
        raise InvalidInputError(
            f"executor must be a concurrent.futures.Executor or None, got {brief(executor)}; try "
            "ProcessPoolExecutor(), and client.get_executor() for a client of Dask"
        )


def _completed_chunks(job: Job, parts: Sequence[int], executor: Executor | None) -> Generator[ChunkResult, None, None]:
    """The chunks as they are finished."""
    if executor is None:
        yield from (run(job, part) for part in parts)
        return
    waiting, pending, ready = iter(parts), set[Future[ChunkResult]](), SimpleQueue[Future[ChunkResult]]()
    try:
        while True:
            for part in islice(waiting, AHEAD - len(pending)):
                future = executor.submit(run, job, part)
                pending.add(future)
                future.add_done_callback(ready.put)
            if not pending:
                return
            future = ready.get()
            pending.discard(future)
            yield future.result()
    finally:
        for future in pending:
            future.cancel()


def _whole(found: Sweep) -> Sweep:
    """The sweep; raises if the workers wrote to other folders of the same name."""
    if not found.complete:
        raise RetraxError(
            f"the workers have finished, and {len(found)} of {found.count} members are in {found.folder}; expected all "
            "of them: give a folder that every worker sees under this name"
        )
    log.info("all %d members are in %s", found.count, found.folder)
    return found
