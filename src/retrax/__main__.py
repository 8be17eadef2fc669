"""``python -m retrax`` prints the versions and settings that a bug report needs."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax

from . import __version__
from .compute.binding.library import MissingCoreError, best_instruction_set

PACKAGES = "numpy", "scipy", "jax", "jaxlib", "equinox", "casadi", "geomstats", "pymanopt", "matplotlib"
INSTRUCTION_SETS = "portable C", "AVX2", "AVX-512"  # in the order of ``retrax_instruction_set``
VARIABLES = "JAX_", "XLA_", "PJRT_", "OMP_", "OPENBLAS_", "MKL_"  # beginnings of names that change results


def installed_version(package: str) -> str:
    """The version of a package, or ``not installed``."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def compiled_core() -> str:
    """The instruction set with which the core runs, or the reason why it does not."""
    try:
        return INSTRUCTION_SETS[best_instruction_set()]
    except MissingCoreError as error:
        return f"missing: {error}"


def main() -> None:
    """Print them."""
    config: Any = jax.config
    rows = {
        "retrax": __version__,
        "Python": f"{platform.python_version()} on {platform.platform()}",
        **{package: installed_version(package) for package in PACKAGES},
        "precision": "double" if config.jax_enable_x64 else "single, until jax_enable_x64 is set",
        "devices of JAX": ", ".join(str(device) for device in jax.devices()),
        "threads": f"{os.cpu_count()} processors",
        "core": compiled_core(),
        "XLA programs kept in": config.jax_compilation_cache_dir or "no folder",
        **{name: value for name, value in sorted(os.environ.items()) if name.startswith(VARIABLES)},
    }
    width = max(map(len, rows))
    for name, value in rows.items():
        print(f"{name:<{width}}  {value}")


if __name__ == "__main__":
    main()
