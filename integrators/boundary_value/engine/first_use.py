"""The first use in an environment of Python: another process compiles a part of the kernels while this one compiles
others.

Numba compiles one function at a time in a process, and those of a pass take nine seconds. Both processes keep theirs on
the disk, where this one finds what the other has made.
"""

import logging
import os
import sys
from functools import cache
from pathlib import Path
from subprocess import DEVNULL, Popen, TimeoutExpired
from typing import Any

from ....optional import numba_is_there
from ....undisturbed import compiling

# Numba is imported where a kernel is asked for, and not with the library.

LONGEST = 60.0  # seconds that are waited for the other process, which takes five

_begun: list[Popen] = []


def _shared() -> list[tuple[Any, Any]]:
    """The kernels that the other process compiles, about half of the work, with their types."""
    from .pursuit_kernels import pursue
    from .pursuit_types import PURSUE
    from .scaling_kernels import units
    from .trial_kernels import UNITS

    return [(pursue, PURSUE), (units, UNITS)]


def compile_shared() -> None:
    """Compile them: what the other process is for."""
    from ....linked import address

    for kernel, kinds in _shared():
        address(kernel, kinds)


def _may_start() -> bool:
    """Whether another process would run beside this one, and be Python: an application may have it built in."""
    is_python = "python" in Path(sys.executable or "").stem.lower() and not getattr(sys, "frozen", False)
    return is_python and (os.cpu_count() or 1) > 1


@cache
def begin() -> None:
    """Start the other process, once, if there is something for it to do."""
    if not numba_is_there():
        return
    from ....kernels import is_missing

    if not any(is_missing(kernel, kinds.args) for kernel, kinds in _shared()):
        return
    logging.getLogger("retrax").info("kernels are compiled for some seconds, once for this environment of Python")
    if not _may_start():
        return
    code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import compile_shared; compile_shared()"
    # It computes nothing: where there is a GPU, it takes none of its memory.
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    command = sys.executable, "-c", code
    try:
        _begun.append(Popen(command, env=environment, stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL))
    except OSError:  # the system starts none: all is compiled here
        return


def ready(kernel: Any) -> Any:
    """The kernel, once the other process has ended: what that has not kept is compiled here."""
    with compiling():
        for process in _begun:
            try:
                process.wait(LONGEST)
            except TimeoutExpired:
                process.kill()
    return kernel
