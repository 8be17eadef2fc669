"""Functions do not change in most modules, and are read once."""

import shutil
from pathlib import Path

import pytest
from retrax.compute.binding.core_sources import core_sources

from tests.support.exported import objects_of_core

HERE = Path(__file__).parent
READ_ANEW = {
    HERE / f"test_{name}.py" for name in ("changed_functions", "flow", "functions", "pieces", "solver", "unchanged")
}


@pytest.fixture(autouse=True, scope="module")
def functions_are_read_once(request):
    """One reading, but where a module is about what is read anew."""
    if request.path not in READ_ANEW:
        request.getfixturevalue("traced_once")


@pytest.fixture(scope="session")
def core(tmp_path_factory):
    """The objects of the core, for all exported programs."""
    folder = tmp_path_factory.mktemp("core")
    (folder / "core").mkdir()
    for source in core_sources():
        shutil.copyfile(source, folder / "core" / source.name)
    return objects_of_core(folder, folder / "objects", "-O2", "-fPIC")
