"""Settings of the peers' tests on our classes: double precision, seeds, and what docs/peers.md says is expected to
fail."""

import builtins
import random
from fnmatch import fnmatchcase
from pathlib import Path

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)
random.seed(0)  # geomstats draws numbers of points when it is imported

from geomstats.test.conf import pytest_collection_modifyitems as drop_inactive  # noqa: E402
from geomstats.test.conf import pytest_make_parametrize_id  # noqa: E402, F401

PAGE = Path(__file__).parents[2] / "docs" / "peers.md"


def expected_failures():
    """Rows ``(class, test, exception, reason)`` of the page's table; class and test are patterns."""
    cells = [line.strip("|").split(" | ") for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    return [tuple(cell.strip(" `") for cell in row) for row in cells]


def matches(item, row):
    """Whether a row of the table is about a test."""
    return fnmatchcase(item.cls.__name__, row[0]) and fnmatchcase(item.originalname, row[1])


@pytest.fixture(scope="session")
def unmatched_rows(request):
    """Rows of the table that are about none of the collected tests."""
    return [row for row in expected_failures() if not any(matches(item, row) for item in request.session.items)]


@pytest.fixture(autouse=True)
def seed():
    """A fixed seed: both libraries, and our doors to them, draw from NumPy's global state."""
    np.random.seed(0)  # noqa: NPY002


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(session, config, items):
    """Keep the tests that have data, and mark those that are expected to fail, strictly."""
    drop_inactive(session, config, items)
    rows = expected_failures()
    for item in items:
        for row in rows:
            if matches(item, row):
                raises = None if row[2] == "any" else getattr(builtins, row[2])
                item.add_marker(pytest.mark.xfail(reason=row[3], raises=raises, strict=True))
