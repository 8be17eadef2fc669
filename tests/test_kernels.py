"""Compiled kernels are taken from the disk again as long as nothing that they are made of changes."""

import importlib
import sys
from pathlib import Path

import pytest
from numba import typeof
from numba.core import caching
from retrax import kernels
from retrax.errors import CompilingInterrupted

PARTS = """from retrax.kernels import kernel_part

@kernel_part()
def part(x):
    return {factor} * x
"""
KERNEL = """from retrax.kernels import kernel
from .parts import part

@kernel()
def found(x):
    return part(x) + 1
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Writes a package of a kernel and of its part, and imports the kernel anew."""
    folder = tmp_path / "of_parts"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "kernel.py").write_text(KERNEL)
    monkeypatch.syspath_prepend(tmp_path)
    # Python takes its own compiled code again where a file of the same size is written in the same second.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def imported(factor: float):
        (folder / "parts.py").write_text(PARTS.format(factor=factor))
        for name in [name for name in sys.modules if name.startswith("of_parts")]:
            monkeypatch.delitem(sys.modules, name)
        importlib.invalidate_caches()
        kernels._digest.cache_clear()
        return importlib.import_module("of_parts.kernel").found

    return imported


def test_a_kernel_is_compiled_anew_where_a_part_of_it_changes_in_another_file(package):
    for factor, hits in ((2.0, 0), (2.0, 1), (3.0, 0), (3.0, 1), (2.0, 0)):
        found = package(factor)
        kinds = (typeof(5.0),)
        assert kernels.is_missing(found, kinds) != bool(hits)
        assert found(5.0) == 5 * factor + 1
        assert not kernels.is_missing(found, kinds)
        assert kernels.is_missing(found, (typeof(5),))
        assert sum(found.stats.cache_hits.values()) == hits


@pytest.mark.parametrize("module", ["pursuit_kernels", "condensing_kernels", "elimination_kernels"])
def test_what_a_kernel_is_made_of_is_found(module, monkeypatch):
    """Its digest changes with a file of parts two imports away, and not with one that it does not import."""
    name = f"retrax.integrators.boundary_value.engine.{module}"
    importlib.import_module(name)

    def digest(changed: str = "") -> str:
        kernels._digest.cache_clear()
        read = kernels.Path.read_bytes
        with monkeypatch.context() as other:
            other.setattr(kernels.Path, "read_bytes", lambda path: read(path) + b"#" * (path.name == changed))
            return kernels._digest(name)

    assert digest() == digest() == digest("solver.py")
    assert len({digest(), digest("vectors.py"), digest("arrays.py"), digest(f"{module}.py")}) == 4


@pytest.fixture
def told(monkeypatch):
    """As if nothing had been said of a folder yet."""
    monkeypatch.setattr(kernels, "_errors", [])


def test_kernels_without_a_folder_are_compiled_with_one_warning(package, told, monkeypatch):
    for name in [name for name in vars(caching) if name.endswith("CacheLocator")]:
        monkeypatch.setattr(getattr(caching, name), "from_function", classmethod(lambda cls, *given: None))
    with pytest.warns(
        UserWarning, match=r"not kept on the disk.*cannot cache function.*try .*NUMBA_CACHE_DIR"
    ) as heard:
        found = [package(factor) for factor in (2.0, 3.0)]
    assert len([one for one in heard if "not kept" in str(one.message)]) == 1
    assert [kernel(5.0) for kernel in found] == [11.0, 16.0]
    assert not kernels.is_missing(found[0], (typeof(5.0),)), "another process could not help"


def test_a_folder_that_cannot_be_written_costs_a_warning(package, told, monkeypatch):
    def full(*given):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "save", full)
    with pytest.warns(UserWarning, match="not kept on the disk.*No space left"):
        assert package(2.0)(5.0) == 11.0


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_files_of_something_else_are_written_anew(package, told, ending):
    assert package(2.0)(5.0) == 11.0
    found = package(2.0)
    for file in Path(found._cache.cache_path).glob(f"*kernel.found*.{ending}"):
        file.write_bytes(b"something else")
    again = package(2.0)
    assert kernels.is_missing(again, (typeof(5.0),)) == (ending == "nbi")
    assert again(5.0) == 11.0
    assert sum(again.stats.cache_hits.values()) == 0
    last = package(2.0)
    assert last(5.0) == 11.0
    assert sum(last.stats.cache_hits.values()) == 1


def test_an_interrupt_says_that_a_kernel_was_compiled(package, monkeypatch):
    def interrupted(*given, **options):
        raise KeyboardInterrupt

    found = package(2.0)
    with monkeypatch.context() as other:
        other.setattr(found._compiler, "compile", interrupted)
        with pytest.raises(CompilingInterrupted):
            found.compile((typeof(5.0),))
    assert found(5.0) == 11.0
