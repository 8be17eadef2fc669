"""Packages that are imported where they are used."""

import warnings
from functools import cache
from importlib import import_module
from typing import Any

from .errors import RetraxError
from .undisturbed import put_off


class MissingPackageError(RetraxError, ImportError):
    """The error of a function that needs a package that is not installed."""


def needed(name: str, what: str) -> Any:
    """The module of a package; raises ``MissingPackageError`` with the line that installs it where it is not
    installed."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.partition(".")[0] != name.partition(".")[0]:
            raise
        package = name.partition(".")[0]
        raise MissingPackageError(
            f"{what} needs the package {package}, which is not installed; try: pip install {package}"
        ) from error


WITHOUT_NUMBA = "Numba is not available, which makes the machine for tapes"


@cache
def numba_is_there() -> bool:
    """Whether Numba is, as not yet for each new Python; a warning says, once, how all goes on without it."""
    try:
        with put_off():
            numba = import_module("numba")
    except (ImportError, OSError, RuntimeError, SystemError) as error:  # OSError: its library of LLVM cannot be loaded
        reason, hint = str(error), "pip install numba"
    else:
        if not numba.config.DISABLE_JIT:
            return True
        reason, hint = "the environment variable NUMBA_DISABLE_JIT is set", "the same without it"
    warnings.warn(
        f"Numba is not available: {reason}. XLA compiles functions instead, tapes run on CasADi's machine, and Python "
        f"solves the linear systems of solve, which takes some hundred times longer; try: {hint}",
        stacklevel=2,
    )
    return False
