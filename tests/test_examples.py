"""Every example runs, reaches the numbers that it asserts, and has the form of a page of the gallery."""

import re
import runpy
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
SHORT = {"attitude_slew", "minimum_time", "spherical_pendulum"}  # of the default run
NAMED = [pytest.param(path, id=path.stem, marks=() if path.stem in SHORT else pytest.mark.slow) for path in EXAMPLES]
END = "# sphinx_gallery_start_ignore\n"


@pytest.mark.parametrize("path", NAMED)
def test_an_example_reaches_its_numbers_and_writes_its_figures(path, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(path), "--output", str(tmp_path)])
    plt.switch_backend("agg")
    runpy.run_path(str(path), run_name="__main__")
    plt.close("all")
    assert (tmp_path / f"{path.stem}_1.png").exists()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_a_page_of_cells(path):
    text = path.read_text()
    title, line = re.match(r'r?"""\n(.+)\n(=+)\n\n', text).groups()
    assert len(title) == len(line)
    assert len(title.split()) <= 5
    assert text.count("\n# %%\n") >= 2
    assert "\nassert " in text, "an example compares its numbers with known ones"


def test_the_examples_end_with_the_same_lines():
    assert len({path.read_text().split(END)[1] for path in EXAMPLES}) == 1
