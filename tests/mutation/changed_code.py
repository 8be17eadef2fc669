"""A change of a module that is imported: its functions get their new code wherever they are held."""

import gc
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType

from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher
from retrax import kernels


def change(path: Path, wrong: str) -> int:
    """Let the functions of an imported file run other code, whose lines are the same; the number of these functions.

    Kernels that are made of any of it are compiled anew: they are kept with a digest of what they are made of. What
    the file has computed while it was imported stays as it is.
    """
    new = {(code.co_qualname, code.co_firstlineno): code for code in _parts(compile(wrong, str(path), "exec"))}
    held = gc.get_objects()
    functions = [f for f in held if type(f) is FunctionType and Path(f.__code__.co_filename).resolve() == path]
    changed = 0
    for function in functions:
        code = new.get((function.__code__.co_qualname, function.__code__.co_firstlineno))
        if code is not None and code != function.__code__.replace(co_filename=str(path)):
            function.__code__ = code
            changed += 1
    _compile_anew(
        path, wrong, [own for own in held if isinstance(own, Dispatcher) and hasattr(own._cache, "_cache_file")]
    )
    return changed


def _parts(code: CodeType) -> Iterator[CodeType]:
    """The code of all functions in some code."""
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield part
            yield from _parts(part)


def _compile_anew(path: Path, wrong: str, found: list[Dispatcher]) -> None:
    """Forget the compiled code of kernels that are made of the file."""
    right = path.read_text()
    before = [kernels._digest(kernel.__module__) for kernel in found]
    path.write_text(wrong)
    kernels._digest.cache_clear()
    for kernel, digest in zip(found, before, strict=True):
        if kernels._digest(kernel.__module__) != digest:
            kernel._cache = NullCache()
    path.write_text(right)
