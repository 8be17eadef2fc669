"""The memory that a solve takes: of its trajectory, and of the systems of its steps."""

import tracemalloc

from retrax import problems
from retrax.compute.binding.transcription import Transcription
from retrax.integrators import Solver


def test_a_system_of_a_step_is_held_twice_at_most(monkeypatch):
    """The system that was accepted, and that of the trial: 39 kB each for a slew with limits and three stages."""
    rooms, search_room = [], Transcription.search_room

    def counted(self, size):
        rooms.append(8 * size)
        return search_room(self, size)

    monkeypatch.setattr(Transcription, "search_room", counted)
    entry = problems.get("limited-slew")
    solver, asked, peaks = Solver(entry.problem, entry.discretization, 100), [], []
    given = entry.start, entry.end, entry.horizon
    solver.solve(*given)  # once for what is traced
    tracemalloc.start(1)
    try:
        for steps in (150, 450):  # the memory of one is not kept beside that of the other
            tracemalloc.reset_peak()
            rooms.clear()
            assert solver.with_steps(steps).solve(*given).success
            asked.append(max(rooms))
            peaks.append(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    assert (asked[1] - asked[0]) / 300 < 116e3  # of a search
    assert (peaks[1] - peaks[0]) / 300 < 122e3  # with the guess, the result and what is checked of that
