"""The compiled core as a part of the package: a shared library in C without Python's interface."""

import sys
from pathlib import Path
from typing import Any

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py

CORE = Path("src/core")
# Products and sums are rounded where the code says so, whatever the compiler; nothing reads the errors of libm.
FLAGS = ["/O2", "/fp:precise"] if sys.platform == "win32" else [
    "-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fvisibility=hidden", "-g0",
]  # fmt: skip


class BuildCore(build_ext):
    """Builds a library that Python opens through ctypes and never imports."""

    def get_export_symbols(self, ext: Any) -> list[str]:
        """Return none: the header marks what the library exports."""
        return []


class BuildPackage(build_py):
    """Puts the sources of the core and its license into the package, for programs that are exported."""

    def run(self) -> None:
        """Build the package."""
        super().run()
        if not self.editable_mode:
            to = Path(self.build_lib, "retrax", "core_source")
            self.mkpath(str(to))
            for path in [*CORE.glob("*.[ch]"), Path("LICENSE")]:
                self.copy_file(str(path), str(to / path.name))


setup(
    ext_modules=[
        Extension(
            "retrax._core",
            sorted(map(str, CORE.glob("*.c"))),
            depends=sorted(map(str, CORE.glob("*.h"))),
            extra_compile_args=FLAGS,
            libraries=[] if sys.platform == "win32" else ["m"],
            py_limited_api=True,  # one file for all Pythons: it uses none of their interface
        )
    ],
    cmdclass={"build_ext": BuildCore, "build_py": BuildPackage},
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
