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

from ..integrators.options import known_options
from ..integrators.text import brief
from ..manifolds import InvalidInputError, RetraxError
from ..manifolds.numerics.ambient import is_count
from ..manifolds.numerics.precision import working_precision
from ..progress import progress
from .record import Sweep
from .store import opened
from .study import Study, made, marks
from .worker import Done, Job, adopt, run

AHEAD = 1000  # chunks that wait for a worker: more than workers, and few to hold in memory
log = logging.getLogger(__name__)


@known_options
def sweep(
    build: Callable[[], Study],
    count: int,
    folder: str | Path,
    executor: Executor | None = None,
    chunk: int = 100,
    verbose: bool = False,
) -> Sweep:
    """Solve ``count`` cases of a problem in chunks, on any executor, into a folder; go on where an earlier call ended.

    ``build``: a function without arguments that returns a ``Study``. It is called here, to look at the problem, and
    once in each worker (in each thread, if workers are threads); only its name travels to them, so it stands at the top
    level of a module. ``executor``: any ``concurrent.futures.Executor``, such as a ``ProcessPoolExecutor`` that spawns,
    ``client.get_executor()`` of ``dask.distributed``, or ``mpi4py.futures.MPIPoolExecutor``; None solves here, on all
    processors. Workers of an executor use one processor each for problems on the tape; functions that XLA compiled use
    threads of its own. ``folder``: where the results are written, by the workers themselves: all must see it.
    ``chunk``: members that are written together; ``solver.solve_many`` solves at most 100 at once. ``verbose`` shows
    the progress: a bar in a terminal where tqdm is installed, else lines of the logger ``retrax``.

    A chunk is in the folder whole or not at all, and one that is there is not solved again: after a crash, or Ctrl-C,
    call ``sweep`` with the same arguments. A member that is not solved, or is refused by the solver, has its reason as
    its ``result``, and the others do not suffer. Any other error in a function of the study ends the sweep, and is
    raised, as is the end of an executor: what is finished is kept.

    Raises ``InvalidInputError`` for other arguments, a folder of another sweep, and workers in another precision;
    Ctrl-C is the usual ``KeyboardInterrupt``, whose one argument is the ``Sweep`` until then.
    """
    _check(build, count, executor, chunk)
    study, where = made(build), Path(folder).absolute()
    store = opened(where, count, chunk, marks(study, count))
    there = store.finished()
    job = Job(build, str(where), count, chunk, uuid.uuid4().hex, str(working_precision()), executor is not None)
    if executor is None:
        adopt(study, job.token)
    done = sum(len(store.members(part)) for part in there)
    log.info("%d of %d members are in %s", done, count, where)
    missing = sorted(set(range(store.parts)) - set(there))
    with (
        progress("sweep", count, "members", verbose, done) as advance,
        closing(_finished(job, missing, executor)) as finished,
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


def _finished(job: Job, parts: Sequence[int], executor: Executor | None) -> Generator[Done, None, None]:
    """The chunks as they are finished."""
    if executor is None:
        yield from (run(job, part) for part in parts)
        return
    waiting, pending, ready = iter(parts), set[Future[Done]](), SimpleQueue[Future[Done]]()
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
