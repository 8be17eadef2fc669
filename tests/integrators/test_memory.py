"""The memory that a solve takes: of its trajectory, and of the systems of its steps."""

import tracemalloc

from retrax import problems
from retrax.integrators import Solver


def test_a_system_of_a_step_is_held_twice_at_most():
    """The system that was accepted, and that of the trial: 37 kB each for a slew with limits and three stages."""
    entry = problems.get("limited-slew")
    solver, peaks = Solver(entry.problem, entry.discretization, 100), []
    given = entry.start, entry.end, entry.horizon
    solver.solve(*given)  # once for what is traced
    tracemalloc.start(1)
    try:
        for steps in (100, 400):
            tracemalloc.reset_peak()
            assert solver.with_steps(steps).solve(*given).success
            peaks.append(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / 300 < 120e3
