"""Exported solvers: built by a C compiler, and called through ctypes."""

import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pytest

WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
ARITHMETIC = ["-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-DRETRAX_ONE_INSTRUCTION_SET", "-Icore"]
STATUSES = (
    "SOLVED", "ITERATION_LIMIT", "SINGULAR", "INFEASIBLE", "BAD_INPUT", "BAD_WORKSPACE"
)  # fmt: skip
RESIDUALS = "defect", "stationarity", "violation", "complementarity"


def require(*commands: str) -> None:
    """Skip the test if one of these commands is not installed."""
    for command in commands:
        if not shutil.which(command):
            pytest.skip(f"{command} is not installed")


def ran(*command: Any, folder: Path | None = None) -> str:
    """The output of a command, which has to succeed."""
    ended = subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def built_and_tested(folder: Path, to: Path, compiler: str) -> str:
    """The output of the tests of an exported folder, which are built without warnings."""
    require(compiler, "cmake")
    options = f"-DCMAKE_C_COMPILER={compiler}", "-DCMAKE_BUILD_TYPE=Debug", f"-DCMAKE_C_FLAGS={' '.join(WARNINGS)}"
    ran("cmake", "-S", folder, "-B", to, *options)
    ran("cmake", "--build", to, "-j2")
    return ran("ctest", "--test-dir", to, "--output-on-failure", "--verbose")


def objects_of_core(folder: Path, to: Path, *options: str, compiler: str = "gcc") -> list[Path]:
    """The core, compiled once for all exported programs."""
    to.mkdir()
    sources = sorted((folder / "core").glob("*.c"))
    ran(compiler, *WARNINGS, *ARITHMETIC, *options, f"-I{folder / 'core'}", "-c", *sources, folder=to)
    return sorted(to.glob("*.o"))


def compile_loop_of_the_page(header: str, folder: Path, to: Path) -> None:
    """Compile the loop in C of the page on flight code that includes a header of an exported folder."""
    page = (Path(__file__).parents[2] / "docs" / "flight.md").read_text()
    blocks = re.findall(r"^```c\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    (loop,) = [block for block in blocks if f'#include "{header}"' in block]
    (to / "loop.c").write_text(loop)
    ran("gcc", *WARNINGS, f"-I{folder}", "-c", "loop.c", folder=to)


class Flown:
    """An exported solver, called as flight code would."""

    def __init__(self, folder: Path, name: str, core: list[Path], *options: str, more: tuple[str, ...] = ()) -> None:
        own = f"{name}.c", f"{name}_functions.c", *more
        ran("gcc", *WARNINGS, *ARITHMETIC, *options, "-shared", "-fPIC", *own, *core, "-lm", "-o", "flown.so",
            folder=folder)  # fmt: skip
        header = (folder / f"{name}.h").read_text()
        self.sizes = {key: int(value) for key, value in re.findall(rf"{name.upper()}_(\w+) = (\d+)", header)}
        self.library = ctypes.CDLL(str(folder / "flown.so"))
        self.call = self.library[f"{name}_solve"]
        guess = np.dtype(self._fields(header, rf"typedef struct {{\n([^}}]*)}} {name}_guess;", name))
        self.input = np.dtype(
            [*self._fields(header, rf"typedef struct {{\n([^}}]*)}} {name}_input;", name), ("guess", guess)]
        )
        nodes, numbers = self.sizes["STEPS"] + 1, self.sizes["STATE_NUMBERS"]
        rows = [("times", "f8", (nodes,)), ("states", "f8", (nodes, numbers)), ("costates", "f8", (nodes, numbers))]
        counts, sums = [("status", "i4"), ("iterations", "i4")], [("cost", "f8"), ("horizon", "f8")]
        residuals = [(residual, "f8") for residual in RESIDUALS]
        shape = tuple(self.sizes[own] for own in ("STEPS", "POINTS", "CONTROL_DIMENSION", "STATE_NUMBERS"))
        gains = [("gains", "f8", shape)] if "double gains" in header else []
        fields = [*counts, *sums, *rows, ("solution", guess), *residuals, *gains, ("strict_minimum", "?")]
        self.output = np.dtype(fields, align=True)
        default = (ctypes.c_char * self.input.itemsize).in_dll(self.library, f"{name}_default_input")
        self.default = np.frombuffer(bytes(default), self.input).copy()[0]
        self.workspace = np.full(self.sizes["WORKSPACE_BYTES"] // 8 + 1, np.nan)

    def _fields(self, header: str, struct: str, name: str) -> list[tuple[str, str, tuple[int, ...]]]:
        """The arrays and numbers of a struct of the header."""
        found = re.search(struct, header)
        assert found is not None
        fields = []
        for field, lengths in re.findall(r"double (\w+)((?:\[[^]]*\])*);", found[1]):
            names = re.findall(rf"\[{name.upper()}_(\w+)( \+ 1)?\]", lengths)
            fields.append((field, "f8", tuple(self.sizes[size] + bool(more) for size, more in names)))
        return fields

    def solve(self, given: Any, shift: int = 0) -> Any:
        """The output of a solve; ``shift``: of the workspace from the alignment that NumPy gives, in numbers."""
        given, found = np.array(given, self.input), np.zeros((), self.output)
        place = self.workspace.ctypes.data + 8 * shift
        status = self.call(*map(ctypes.c_void_p, (given.ctypes.data, found.ctypes.data, place)))
        assert status == found["status"]
        return found


SHIM = """
#include "{name}_controller.h"
#include <stddef.h>
#if defined(__GNUC__)
#define SEEN __attribute__((visibility("default")))
#endif
SEEN size_t controller_bytes(void) {{ return sizeof({name}_controller); }}
SEEN size_t output_place(void) {{ return offsetof({name}_controller, output); }}
"""
SOURCES = "solve", "iterate", "plan", "none"


class FlownController(Flown):
    """An exported controller, called once per sample as flight code would."""

    def __init__(self, folder: Path, name: str, core: list[Path], *options: str) -> None:
        (folder / "shim.c").write_text(SHIM.format(name=name))
        super().__init__(folder, name, core, *options, more=(f"{name}_controller.c", "shim.c"))
        header = (folder / f"{name}_controller.h").read_text()
        self.sizes |= {key: int(value) for key, value in re.findall(rf"{name.upper()}_(\w+) = (\d+)", header)}
        self.library.controller_bytes.restype = self.library.output_place.restype = ctypes.c_size_t
        self.memory = np.zeros(self.library.controller_bytes() // 8 + 1)
        self.given = self.memory[: self.input.itemsize // 8].view(self.input)[0]  # what the next solve is given
        begin = self.library.output_place() // 8
        self.found = self.memory[begin : begin + self.output.itemsize // 8].view(self.output)[0]  # of the last solve
        self._step = self.library[f"{name}_step"]
        self._at = [ctypes.c_void_p(own.ctypes.data) for own in (self.memory, self.workspace)]
        self.library[f"{name}_begin"](self._at[0])
        self.iterations, self.sources, self.seconds = list[int](), list[str](), list[float]()

    def __call__(self, state: np.ndarray, time: float) -> np.ndarray:
        """The control for a flat state at a time."""
        given, control = np.array(state, float), np.zeros(self.sizes["OWN_CONTROLS"])
        assert given.shape == (self.sizes["GIVEN_NUMBERS"],)
        at, to = (ctypes.c_void_p(own.ctypes.data) for own in (given, control))
        began = perf_counter()
        source = self._step(self._at[0], at, ctypes.c_double(time), to, self._at[1])
        self.seconds.append(perf_counter() - began)
        self.sources.append(SOURCES[source])
        self.iterations.append(int(self.found["iterations"]))
        return control
