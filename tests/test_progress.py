"""Progress of long work: lines of the logger, or a bar in a terminal."""

import io
import logging
import sys

import numpy as np
import pytest
from retrax.progress import LOG_SECONDS, progress


def test_the_library_says_nothing_by_itself(capsys):
    logging.getLogger("retrax").warning("a line for which nobody asked")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("pause", [0.5, 0.99, 1.01, 3.0])
def test_lines_come_when_their_time_has_come(pause, caplog, monkeypatch):
    clock = iter(np.arange(0, 1e6, pause * LOG_SECONDS / 2))
    monkeypatch.setattr("time.monotonic", lambda: float(next(clock)))
    with caplog.at_level(logging.INFO, "retrax"), progress("work", 10, "parts", verbose=True) as advance:
        for _ in range(9):
            advance(1)
        before = len(caplog.records)
    assert len(caplog.records) == before + 1, "the last one says how it ended"
    assert 1 <= before <= 9
    assert "9 of 10 parts" in caplog.records[-1].getMessage()


def test_a_terminal_shows_a_bar(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress("work", 10, "parts", verbose=True, done=4) as advance:
        advance(6, "well")
    shown = sys.stderr.getvalue()
    assert "work: 100%" in shown
    assert "10/10" in shown


def test_a_bar_is_not_needed(monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with caplog.at_level(logging.INFO, "retrax"), progress("work", 2, "parts", verbose=True) as advance:
        advance(2)
    assert "2 of 2 parts" in caplog.text
