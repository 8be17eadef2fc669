"""The iterations of a singular problem: what a callback sees, and what is printed."""

import numpy as np
import pytest
from retrax.integrators import Result, solve
from retrax.integrators.boundary_value.shooting.segments import Shooting
from retrax.integrators.singular import singular_integrator

from .test_singular_solve import ALY_CHAN, MIDPOINT, ONE, ZERO, classified


@pytest.mark.parametrize(("last", "interrupted"), [(0, False), (1, False), (1, True), (100, False)])
@pytest.mark.slow
def test_a_callback_sees_the_iterations_of_shooting_and_may_end_them(last, interrupted):
    seen = []

    def stop(iteration):
        seen.append(iteration)
        if interrupted and iteration.number == last:
            raise KeyboardInterrupt
        return iteration.number == last

    given = (ZERO, None), (ONE, None), np.pi / 2
    known = {"classification": classified(ALY_CHAN), "throw": False}
    found = solve(ALY_CHAN, *given, method=MIDPOINT, steps=8, callback=stop, **known)
    assert [iteration.number for iteration in seen] == list(range(len(seen)))
    assert all(np.isfinite(iteration.defect).all() and np.isnan(iteration.cost).all() for iteration in seen)
    assert {np.shape(part) for iteration in seen for part in iteration[1:]} == {(1,)}  # one member
    assert found.success == (last == 100)
    assert len(seen) == (found.statistics.iterations + 1 if found.success else last + 1)
    if not found.success:
        assert found.result == Result[Result.stopped]
        assert found.statistics.stopped


def test_a_last_segment_that_is_shorter_ends_with_the_last_step():
    """Three steps in a segment of four: ``(x1, x2)`` turns by the angle ``2 arctan(h/2)`` a step."""
    found, h = classified(ALY_CHAN), 0.1
    last = Shooting(ALY_CHAN, singular_integrator(found, MIDPOINT)[0], found.manifold, h, steps=3, length=4)
    _, (nodes, solved) = last.segment(((ZERO, ONE), (ONE, ZERO)), np.zeros((4, 0)), 0)
    assert solved
    turns = 2 * np.arctan(h / 2) * np.array([1, 2, 3, 3])
    np.testing.assert_allclose(nodes.z[0][0][:, 0], np.sin(turns), atol=1e-13)


@pytest.mark.parametrize("verbose", [False, True])
@pytest.mark.parametrize("known", [(), ("classification",), ("classification", "integrator")])
@pytest.mark.usual(1)
def test_what_is_done_before_the_iterations_is_printed_where_it_is_asked_for(verbose, known, capsys):
    given = {"classification": (c := classified(ALY_CHAN)), "integrator": singular_integrator(c, MIDPOINT)[0]}
    options = {"verbose": verbose, **{name: given[name] for name in known}}
    solution = solve(ALY_CHAN, (ZERO, None), (ONE, None), np.pi / 2, method=MIDPOINT, steps=4, **options)
    words = ["is classified", "is chosen", "are looked for", "is compiled", "iteration"][len(known) :]
    numbers = [f"{count:>9} " for count in range(solution.statistics.iterations + 1)]
    expected, lines = [*words, *numbers, "is examined"] if verbose else [], capsys.readouterr().out.splitlines()
    assert [part in line for part, line in zip(expected, lines, strict=True)] == [True] * len(expected)
