"""Exported solvers: built by a C compiler, and called through ctypes."""

import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
ARITHMETIC = ["-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-DRETRAX_ONE_INSTRUCTION_SET", "-Icore"]
STATUSES = (
    "SOLVED", "ITERATION_LIMIT", "SINGULAR", "INFEASIBLE", "ELSEWHERE", "BAD_INPUT", "BAD_WORKSPACE"
)  # fmt: skip
RESIDUALS = "defect", "stationarity", "violation", "complementarity"


def needs(command: str) -> str:
    """A reason to skip a test; empty if the command is installed."""
    return "" if shutil.which(command) else f"{command} is not installed"


def ran(*command: Any, folder: Path | None = None) -> str:
    """The output of a command, which has to succeed."""
    ended = subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def objects_of_core(folder: Path, to: Path, *options: str, compiler: str = "gcc") -> list[Path]:
    """The core, compiled once for all exported programs."""
    to.mkdir()
    sources = sorted((folder / "core").glob("*.c"))
    ran(compiler, *WARNINGS, *ARITHMETIC, *options, f"-I{folder / 'core'}", "-c", *sources, folder=to)
    return sorted(to.glob("*.o"))


class Flown:
    """An exported solver, called as flight code would."""

    def __init__(self, folder: Path, name: str, core: list[Path], *options: str) -> None:
        own = f"{name}.c", f"{name}_functions.c"
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
        fields = [*counts, *sums, *rows, ("solution", guess), *residuals, ("strict_minimum", "?")]
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
