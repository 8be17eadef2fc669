"""What Numba compiles: kernels, which Python calls, and functions that are nothing but parts of them.

Numba optimises the code of a function, and again wherever it is called, with all that it calls in turn: of kernels that
are made of small functions the most time goes into code that never runs by itself. So LLVM optimises parts in kernels,
and only there.
"""

from collections.abc import Callable
from typing import Any, Literal, final

import numba
from numba._dynfunc import make_function
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering

from .collection import put_off


@final
class _Part(JITCodeLibrary):
    """Code to link into that of others, which the machine never sees by itself."""

    def _optimize_final_module(self) -> None:
        """Leave it as it is."""

    def _finalize_final_module(self) -> None:
        """Keep it from the engine, which would compile it, and call it where LLVM did not inline its copy."""
        self._finalize_dynamic_globals()
        self._finalized = True


@final
@register_pass(mutates_CFG=True, analysis_only=False)
class _PlainLowering(NativeLowering):
    """Lowers to code that is left as it is."""

    _name = "plain_lowering"

    def run_pass(self, state: Any) -> Literal[True]:
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered, name = state.cr, state.func_id.func_name
        handle = make_function(lowered.fndesc.lookup_module(), name, "", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(handle, lowered.fndesc, [state.library])
        state.cr = lowered._replace(cfunc=handle)
        return True


@final
class InlinedCompiler(CompilerBase):
    """The passes of Numba, with a plain one to lower."""

    def define_pipelines(self) -> list[PassManager]:
        """The one pipeline of ``numba.njit``."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_PlainLowering if pass_ is NativeLowering else pass_, words) for pass_, words in passes.passes
        ]
        passes.finalize()
        return [passes]


# Numba's own types do not know all of its options.
_njit: Any = numba.njit
pasted: Callable[[Any], Any] = _njit(inline="always")  # where a call takes longer than what it computes


def kernel(**options: Any) -> Callable[[Any], Any]:
    """For functions that Python calls: compiled once on a computer, or read from its disk.

    A sixth of the time would go into looking for garbage among all that Numba makes and keeps.
    """

    def made(function: Any) -> Any:
        found = _njit(cache=True, error_model="numpy", nogil=True, **options)(function)
        found.compile = put_off()(found.compile)
        return found

    return made


def part(**options: Any) -> Callable[[Any], Any]:
    """For functions that nothing but other compiled functions calls."""
    alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": InlinedCompiler}
    return _njit(error_model="numpy", nogil=True, **options, **alone)
