"""What a callback sees of shooting."""

import numpy as np
import pytest
from retrax.integrators import Result, solve

from tests.integrators.shooting.test_singular_solve import ALY_CHAN, MIDPOINT, ONE, ZERO, classified


@pytest.mark.parametrize("last", [0, 1, 100])
def test_a_callback_sees_the_iterations_of_shooting_and_may_end_them(last):
    seen = []

    def stop(iteration):
        seen.append(iteration)
        return iteration.number == last

    given = (ZERO, None), (ONE, None), np.pi / 2, 8
    known = {"classification": classified(ALY_CHAN), "throw": False}
    found = solve(ALY_CHAN, MIDPOINT, *given, callback=stop, **known)
    assert [iteration.number for iteration in seen] == list(range(len(seen)))
    assert all(np.isfinite(iteration.gap).all() and np.isnan(iteration.cost).all() for iteration in seen)
    assert found.success == (last == 100)
    assert len(seen) == (found.statistics.iterations + 1 if found.success else last + 1)
    if not found.success:
        assert found.result == Result[Result.stopped]
