"""Functions do not change in most modules, and are read once."""

import pytest

READ_ANEW = ("test_changed_functions", "test_flow", "test_functions", "test_pieces", "test_solver")


@pytest.fixture(autouse=True, scope="module")
def functions_are_read_once(request):
    """One reading, but where a module is about what is read anew."""
    if request.module.__name__.split(".")[-1] not in READ_ANEW:
        request.getfixturevalue("traced_once")
