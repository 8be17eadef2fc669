"""Compiled kernels are taken from the disk again as long as nothing that they are made of changes."""

import importlib
import sys

import pytest
from numba import typeof
from retrax import kernels

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
        assert kernels.is_kept(found, kinds) == bool(hits)
        assert found(5.0) == 5 * factor + 1
        assert kernels.is_kept(found, kinds)
        assert not kernels.is_kept(found, (typeof(5),))
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
