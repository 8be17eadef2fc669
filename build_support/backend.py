"""The build backend: setuptools, with the compiler of the package ziglang where the computer has no C compiler."""

import os
import shutil
import sys
import sysconfig
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (
    build_sdist,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]


def has_compiler() -> bool:
    """Whether there is the C compiler that setuptools would call; on Windows setuptools searches for it itself."""
    own = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[0]
    return sys.platform == "win32" or shutil.which(own) is not None


def _requirements(own: list[str]) -> list[str]:
    return own if has_compiler() else [*own, "ziglang"]


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Return what pip installs before it builds a wheel."""
    return _requirements(build_meta.get_requires_for_build_wheel(config_settings))


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Return what pip installs before it builds an editable wheel."""
    return _requirements(build_meta.get_requires_for_build_editable(config_settings))


def _choose_compiler() -> None:
    """Let setuptools call zig if there is no other compiler."""
    if not has_compiler():
        zig = f"{sys.executable} -m ziglang cc"
        os.environ |= {"CC": zig, "LDSHARED": f"{zig} -shared"}


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build a wheel, and return the name of its file."""
    _choose_compiler()
    return build_meta.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build an editable wheel, and return the name of its file."""
    _choose_compiler()
    return build_meta.build_editable(wheel_directory, config_settings, metadata_directory)
