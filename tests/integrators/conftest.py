"""Functions do not change in most modules, and are read once."""

from pathlib import Path

import pytest

HERE = Path(__file__).parent
READ_ANEW = {
    HERE / f"test_{name}.py" for name in ("changed_functions", "flow", "functions", "pieces", "solver", "unchanged")
}


@pytest.fixture(autouse=True, scope="module")
def functions_are_read_once(request):
    """One reading, but where a module is about what is read anew."""
    if request.path not in READ_ANEW:
        request.getfixturevalue("traced_once")
