"""Trials of a batch are judged by their records: those inside the funnel go on, those that lack more do not."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from retrax.integrators.boundary_value.engine.acceptance import (
    FIRST_SHIFT,
    LOWER,
    RAISE,
    RECORD,
    ROUNDED,
    SHORTEST,
    Funnel,
    Judgement,
    Merit,
)

TOLERANCE, WIDTH, BEST = 1e-9, 1e-2, 1e-4


def judgement(
    residual: float,
    shortfall: float,
    promised: float = 1.0,
    cost: float = 2.0,
    missing: float = 10.0,
    fraction: float = 1.0,
    shift: float = 0.0,
) -> Judgement:
    """Of a fraction of a step that promises less cost than 1 and comes to another, lacking so many times what the
    funnel is wide."""
    one = np.ones(1)
    step = SimpleNamespace(reach=one, followed=one)
    state: Any = SimpleNamespace(
        step=step,
        descends=np.ones(1, bool),
        promised=-promised * one,
        turned=0 * one,
        merit=Merit(min(missing, 1.0) * WIDTH * one, one, 0 * one),
        funnel=WIDTH * one,
        fraction=fraction * one,
        best=BEST * one,
        shift=shift * one,
    )
    trial = Merit(missing * WIDTH * one, cost * one, 0 * one)
    return Funnel(TOLERANCE).accepts(state, trial, (residual * one, shortfall * one, cost * one), False)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.99, 1.01, 10.0, 1e6])
def test_a_record_counts_inside_the_funnel_only(share):
    found = judgement(BEST / 2, share * WIDTH)
    assert found.good.tolist() == [share < 1]
    assert found.best.tolist() == [BEST / 2 if share < 1 else BEST]
    assert found.fraction.tolist() == [1.0 if share < 1 else 0.5]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.99, 1.01, 10.0, np.inf])
def test_a_residual_is_a_record_well_below_the_best_one(share):
    found = judgement(share * RECORD * BEST, WIDTH / 2)
    assert found.good.tolist() == [share < 1]
    assert found.funnel.tolist() == [10 * WIDTH if share < 1 else WIDTH]


@pytest.mark.parametrize("share", [-10.0, 0.0, 0.5, 0.9, 1.5, 10.0, 1e6])
def test_a_cost_that_is_more_by_rounding_is_accepted(share):
    """Where a step promises less than that: beside a solution nothing else is left."""
    found = judgement(10 * BEST, 0.0, promised=1e-3 * ROUNDED, cost=1 + share * ROUNDED, missing=0.0)
    assert found.good.tolist() == [share < 1]


@pytest.mark.parametrize("fraction", [1.0, 0.8, 0.74, 0.5, 0.26, 0.25, 0.2, 0.125, 0.0625, 0.01])
def test_the_shift_falls_after_a_whole_step_and_rises_after_one_that_was_cut(fraction):
    """The shorter the part of the step that was accepted, the more, and tenfold at most."""
    before = 1e-2
    found = judgement(BEST / 2, WIDTH / 2, fraction=fraction, shift=before)
    after = found.shift.item()
    assert found.good.all()
    assert np.sign(after - before) == (-1 if fraction > 0.75 else 1 if fraction <= 0.25 else 0)
    assert before / LOWER <= after <= before * RAISE
    if fraction < 0.25:
        assert after >= judgement(BEST / 2, WIDTH / 2, fraction=2 * fraction, shift=before).shift.item()


@pytest.mark.parametrize("shift", [0.0, 1e-9, 1e-2])
def test_the_shift_rises_where_no_part_of_a_step_is_accepted(shift):
    for fraction in (1.0, 0.5, 0.25, 2 * SHORTEST):
        found = judgement(10 * BEST, WIDTH / 2, fraction=fraction, shift=shift)
        assert (found.shift.item(), found.fraction.item()) == (shift, fraction / 2)
    found = judgement(10 * BEST, WIDTH / 2, fraction=SHORTEST, shift=shift)
    assert (found.shift.item(), found.fraction.item()) == (max(RAISE * shift, FIRST_SHIFT), 1.0)
