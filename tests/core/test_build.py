"""The source distribution builds a wheel with the core where there is no C compiler: with the one of ziglang."""

import ctypes
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from retrax.compute.binding.library import HEADER_VERSION
from retrax.compute.binding.structs import Residual

ROOT = Path(__file__).parents[2]
SDIST = "import backend, sys; print(backend.build_sdist(sys.argv[1]))"


def ran(*command, **options):
    ended = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=900, check=False, **options)
    assert ended.returncode == 0, ended.stderr + ended.stdout
    return ended.stdout


@pytest.mark.slow
def test_without_a_compiler_pip_builds_the_core_from_the_source_distribution(tmp_path):
    tools, source, python = tmp_path / "tools", tmp_path / "source", tmp_path / "python"
    ran(sys.executable, "-m", "pip", "install", "--quiet", "--target", tools, "setuptools>=77")
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "build", "*.so", "*.egg-info", "output"))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tools), str(source / "build_support")])}
    ran(sys.executable, "-c", SDIST, tmp_path, cwd=source, env=environment)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        names = {name.partition("/")[2] for name in packed.getnames()}
    assert names >= {f"src/core/{path.name}" for path in (ROOT / "src" / "core").iterdir()}

    python.mkdir()
    (python / "python").symlink_to(sys.executable)
    alone = {name: value for name, value in os.environ.items() if name != "CC"} | {"PATH": str(python)}
    assert shutil.which("gcc", path=alone["PATH"]) is None
    ran(sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", tmp_path, archive, env=alone)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        carried = {path.name for path in (ROOT / "src" / "core").iterdir()} | {"LICENSE"}
        assert {name for name in packed.namelist() if "/core_source/" in name} == {
            f"retrax/core_source/{name}" for name in carried
        }
        (library,) = [name for name in packed.namelist() if name.startswith("retrax/_core.")]
        packed.extract(library, tmp_path)
    assert "-abi3-" in wheel.name
    assert (tmp_path / library).stat().st_size < 500_000
    core = ctypes.CDLL(tmp_path / library)
    assert core.retrax_core_version() == HEADER_VERSION
    core.retrax_tape_instruction_name.restype = ctypes.c_char_p
    assert core.retrax_tape_instruction_name(4) == b"MUL_ADD"


def test_places_of_residuals_are_those_of_the_header():
    header = (ROOT / "src" / "core" / "retrax_core.h").read_text()
    (names,) = re.findall(r"enum \{\s*(RETRAX_DEFECT,.*?)\};", header, re.DOTALL)
    found = re.findall(r"^ *RETRAX_(\w+)", names, re.MULTILINE)
    assert found == [*(own.name for own in Residual), "RESIDUALS"]
