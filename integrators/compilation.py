"""Options of the compiler for the large kernels of this library."""

from functools import cache

import jax


@cache
def compiler_options() -> dict[str, str | bool]:
    """Per-function options that halve XLA's time to compile on a CPU and leave the running time unchanged.

    The fusion emitters of jaxlib 0.10 spend most of a compilation on the many small loops of per-stage derivatives, and
    LLVM's higher levels find nothing more to do in them. A jaxlib without the options compiles with its defaults. Nothing
    global is set.
    """
    options: dict[str, str | bool] = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": "1"}
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x).lower(0.0).compile(options)
    except jax.errors.JaxRuntimeError:
        return {}
    return options
