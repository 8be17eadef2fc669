"""Functions of problems do not change in most modules: what one call traces of them is not traced again by the next."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def within_one_reading(request):
    """One reading for a module that is not marked ``reads_anew``."""
    if request.node.get_closest_marker("reads_anew") is None:
        request.getfixturevalue("traced_once")
