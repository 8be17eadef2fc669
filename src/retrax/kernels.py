"""What Numba compiles: kernels, which Python calls, and functions that are nothing but parts of them.

Numba optimises the code of a function, and again wherever it is called, with all that it calls in turn: of kernels that
are made of small functions the most time goes into code that never runs by itself. So LLVM optimises parts in kernels,
and only there, and kernels once.
"""

import re
import sys
import warnings
from collections.abc import Callable
from functools import cache, partial
from hashlib import blake2b
from importlib.util import resolve_name
from pathlib import Path
from typing import Any, ClassVar, Literal, final

import numba
from llvmlite import binding
from numba._dynfunc import make_function
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering

from .undisturbed import compiling, undisturbed


class _Code(JITCodeLibrary):
    """Code whose functions are not optimised one by one before the whole is."""

    def _optimize_functions(self, ll_module: Any) -> None:
        """Leave them as they are, for this machine."""
        ll_module.data_layout = self._codegen._data_layout


class _Kernel(_Code):
    """Code that LLVM optimises once: Numba does it before and after it looks for counts of references."""

    def _optimize_final_module(self) -> None:
        passes, builder = self._passes()
        passes.run(self._final_module, builder)

    def _passes(self) -> tuple[Any, Any]:
        """Those of Numba."""
        return self._codegen._module_pass_manager()


@final
class _KernelOfVectors(_Kernel):
    """Code whose vectors are its own: its loops are short, and to write them out takes longer than it gains."""

    def _passes(self) -> tuple[Any, Any]:
        options = binding.create_pipeline_tuning_options(speed_level=1)
        options.loop_vectorization = options.slp_vectorization = False
        options.loop_interleaving = options.loop_unrolling = False
        builder = binding.create_pass_builder(self._codegen._tm, options)
        return builder.getModulePassManager(), builder


@final
class _Part(_Code):
    """Code to link into that of others, which the machine never sees by itself."""

    def _optimize_final_module(self) -> None:
        """Leave it as it is."""

    def _finalize_final_module(self) -> None:
        """Keep it from the engine, which would compile it, and call it where LLVM did not inline its copy."""
        self._finalize_dynamic_globals()
        self._finalized = True


class _KernelLowering(NativeLowering):
    """Lowers to code of this kind."""

    kind: ClassVar[type[_Kernel]]

    def run_pass(self, state: Any) -> Literal[True]:
        state.library = self.kind(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        super().run_pass(state)
        return True


@final
@register_pass(mutates_CFG=True, analysis_only=False)
class _LoopsLowering(_KernelLowering):
    _name, kind = "lowering_of_loops", _Kernel


@final
@register_pass(mutates_CFG=True, analysis_only=False)
class _VectorsLowering(_KernelLowering):
    _name, kind = "lowering_of_vectors", _KernelOfVectors


@final
@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Lowers to code that is left as it is."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> Literal[True]:
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered, name = state.cr, state.func_id.func_name
        handle = make_function(lowered.fndesc.lookup_module(), name, "", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(handle, lowered.fndesc, [state.library])
        state.cr = lowered._replace(cfunc=handle)
        return True


class _Compiler(CompilerBase):
    """The passes of ``numba.njit``, with another one to lower."""

    lowering: ClassVar[type[NativeLowering]]

    def define_pipelines(self) -> list[PassManager]:
        """The one pipeline."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(self.lowering if own is NativeLowering else own, words) for own, words in passes.passes]
        passes.finalize()
        return [passes]


@final
class _LoopsCompiler(_Compiler):
    lowering = _LoopsLowering


@final
class _VectorsCompiler(_Compiler):
    lowering = _VectorsLowering


@final
class _PartCompiler(_Compiler):
    lowering = _PartLowering


_errors: list[Exception] = []  # of what could not be kept

# Not those in functions, which may have run or not, but for a module's own where Numba is there.
IMPORT = re.compile(r"^(?:if numba_is_there\(\):\n    )?from (\.+[\w.]*) import (.*)$", re.MULTILINE)


@cache
def _digest(module: str) -> str:
    """A digest of the source of a module and of all that it imports of this package.

    Numba takes a compiled function from the disk again unless the file changes that it stands in: not where a part does
    that stands in another.
    """
    sources, left = dict[str, bytes](), [module]
    while left:
        name = left.pop()
        own = sys.modules.get(name)
        if name in sources or own is None or not getattr(own, "__file__", None):
            continue
        sources[name] = Path(str(own.__file__)).read_bytes()
        package = name if hasattr(own, "__path__") else name.rpartition(".")[0]
        for where, names in IMPORT.findall(sources[name].decode()):
            found = resolve_name(where, package)
            within = [f"{found}.{word.strip()}" for word in names.split(",")]
            left += [part if part in sys.modules else found for part in within]
    return blake2b(b"".join(sources[name] for name in sorted(sources)), digest_size=16).hexdigest()


# Numba's own types do not know all of its options.
_njit: Any = numba.njit
pasted: Callable[[Any], Any] = _njit(inline="always")  # where a call takes longer than what it computes


def kernel(vectors: bool = False, **options: Any) -> Callable[[Any], Any]:
    """For functions that Python calls: compiled once on a computer, or read from its disk; ``vectors``: they make
    their own, so that loops are left as they are, and allocate nothing.

    A sixth of the time would go into looking for garbage among all that Numba makes and keeps.
    """

    def made(function: Any) -> Any:
        passes = {"pipeline_class": _VectorsCompiler, "_nrt": False} if vectors else {"pipeline_class": _LoopsCompiler}
        own = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True, **passes, **options}
        try:
            found = _njit(cache=True, **own)(function)
        except RuntimeError as error:  # there is no folder that it can be kept in
            _warn(error)
            found = _njit(**own)(function)
        found.compile = undisturbed(compiling()(found.compile))
        if _has_a_place(found):
            found._cache._cache_file._source_stamp = _digest(function.__module__)
            _forgive(found._cache)
        return found

    return made


def _has_a_place(kernel: Any) -> bool:
    """Whether there is a folder where it is kept."""
    return hasattr(kernel._cache, "_cache_file")


def _forgive(kept: Any) -> None:
    """Let a folder that cannot be read or written, or that holds something else, cost time and nothing more."""
    load, save, empty = kept.load_overload, kept.save_overload, kept.flush

    def attempted(attempt: Callable[..., Any], *given: Any) -> Any:
        try:
            return attempt(*given)
        except Exception as error:  # pickle raises about everything for bytes that it did not write
            _warn(error)
            return None

    def loaded(*given: Any) -> Any:
        try:
            return load(*given)
        except Exception:  # the same: what is there is of no use
            attempted(empty)
            return None

    kept.load_overload, kept.save_overload = loaded, partial(attempted, save)


def _warn(error: Exception) -> None:
    """Say, once, that nothing is kept."""
    if not _errors:
        warnings.warn(
            f"compiled kernels are not kept on the disk, and compiled anew in each process, for seconds: {error}; try "
            "the environment variable NUMBA_CACHE_DIR, a folder that can be written",
            stacklevel=2,
        )
    _errors.append(error)


def kernel_part(**options: Any) -> Callable[[Any], Any]:
    """For functions that nothing but other compiled functions calls."""
    alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _PartCompiler}
    return _njit(error_model="numpy", nogil=True, **options, **alone)


def is_missing(kernel: Any, kinds: tuple[Any, ...]) -> bool:
    """Whether a kernel for arguments of these types could be on the computer's disk, and is not."""
    if not _has_a_place(kernel):
        return False
    key = kernel._cache._index_key(kinds, kernel.targetctx.codegen())
    try:
        return key not in kernel._cache._cache_file._load_index()
    except Exception:  # pickle raises about everything for bytes that it did not write
        return True
