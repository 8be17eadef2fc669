"""The list of errors is true of the project: each line is there once, and each test exists."""

from pathlib import Path

import pytest

from .planted import PLANTED

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", PLANTED)
def test_an_error_has_one_place_and_tests(name):
    planted = PLANTED[name]
    assert (ROOT / planted.file).read_text().count(planted.right) == 1, f"{planted.file} has no such line, or several"
    assert planted.wrong != planted.right
    assert planted.tests
    for test in planted.tests:
        path, _, function = test.partition("::")
        assert (
            f"def {function.partition('[')[0]}(" in (ROOT / path).read_text() if function else (ROOT / path).exists()
        ), test
