"""The core under sanitizers, valgrind and compilers' warnings; it has no memory and no state of its own."""

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "src" / "core").glob("*.c"))
DRIVERS = sorted(Path(__file__).parent.glob("fuzz_*.c"))
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
FLAGS = ["-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
SANITIZERS = ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
# What the core may take from elsewhere: libm, and moves of memory that compilers write by themselves.
OUTSIDE = (
    "acosh?|asinh?|atanh?|atan2|cosh?|sinh?|tanh?|erf|exp|expm1|floor|ceil|fma|fmax|fmin|fmod|hypot|log|log1p|pow|sqrt|"
    "mem(cpy|set|move|cmp)|__cpu_(model|indicator_init)|_GLOBAL_OFFSET_TABLE_|__stack_chk_fail"
)


def ran(*command, folder=None):
    """What a command prints, run in a folder; it must end well."""
    ended = subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, timeout=3000, check=False)
    assert ended.returncode == 0, ended.stderr + ended.stdout
    return ended.stdout


@pytest.fixture(scope="module", params=DRIVERS, ids=lambda path: path.stem)
def driver(request):
    return request.param


@pytest.mark.skipif(not COMPILERS, reason="there is no gcc or clang")
@pytest.mark.parametrize("compiler", COMPILERS)
def test_no_compiler_warns(compiler):
    for source in [*SOURCES, *DRIVERS]:
        ran(compiler, *STRICT, *FLAGS, "-fsyntax-only", source)


@pytest.mark.skipif("gcc" not in COMPILERS or not shutil.which("nm"), reason="there is no gcc, or no nm")
def test_it_has_no_memory_and_no_state_of_its_own(tmp_path):
    for source in SOURCES:
        own = tmp_path / f"{source.stem}.o"
        ran("gcc", *STRICT, *FLAGS, "-O2", "-fno-pic", "-c", source, "-o", own)
        symbols = [line.split()[-2:] for line in ran("nm", own).splitlines()]
        outside = {name for kind, name in symbols if kind == "U" and not name.startswith("retrax_")}
        assert not {name for name in outside if not re.fullmatch(OUTSIDE, name)}
        assert not {name for kind, name in symbols if kind in "bBCdD"}  # constants are of kind r


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    """A function of options of the compiler: the objects of the core with sanitizers, compiled once."""

    @cache
    def objects(*options):
        folder = tmp_path_factory.mktemp("objects")
        ran("gcc", *STRICT, *FLAGS, *SANITIZERS, *options, "-g", "-O1", "-c", *SOURCES, folder=folder)
        return sorted(folder.glob("*.o"))

    return objects


def count(slow):
    return [pytest.param(2000, 1), pytest.param(slow, 2, marks=pytest.mark.slow)]


@pytest.mark.skipif("gcc" not in COMPILERS, reason="there is no gcc")
@pytest.mark.parametrize(("cases", "seed"), count(200_000))
def test_random_input_under_the_sanitizers(driver, cases, seed, sanitized, tmp_path):
    own, sets = tmp_path / driver.stem, ["-DRETRAX_ONE_INSTRUCTION_SET"] if seed == 1 else []
    ran("gcc", *STRICT, *FLAGS, *SANITIZERS, *sets, "-g", "-O1", driver, *sanitized(*sets), "-o", own, "-lm")
    assert "that ran" in ran(own, cases, seed)


@pytest.mark.slow
@pytest.mark.skipif("gcc" not in COMPILERS or not shutil.which("valgrind"), reason="there is no gcc, or no valgrind")
def test_random_input_under_valgrind(driver, tmp_path):
    """For what sanitizers do not see: numbers that nothing has set."""
    own = tmp_path / driver.stem
    ran("gcc", *STRICT, *FLAGS, "-DRETRAX_ONE_INSTRUCTION_SET", "-g", "-O1", driver, *SOURCES, "-o", own, "-lm")
    assert "that ran" in ran("valgrind", "-q", "--error-exitcode=9", "--leak-check=full", own, 3000, 3)
