"""The core's condensing beside the engine's."""

import numpy as np
import pytest
from retrax.compute.binding.condensing import CollocationArrays, condense_slope, condense_steps, expand_steps
from retrax.compute.binding.library import best_instruction_set
from retrax.integrators.boundary_value.engine.condensing import Ends, Points, Tableau, condense, expand, slopes
from retrax.manifolds import InvalidInputError

SETS = range(best_instruction_set() + 1)


def drawn(rng, s, n, m, columns):
    """Equations of four steps of one trajectory, as the engine has them and as the core has."""
    count, q = 4, 3 * n + m
    draw = rng.standard_normal
    hessian, end_hessian = draw((1, count, s, q, q)), draw((1, count, 2 * n, 2 * n))
    constraints = 0.3 * draw((1, count, s, n, q))
    constraints[..., 2 * n : 3 * n] += np.eye(n)
    points = Points(
        hessian + hessian.swapaxes(3, 4), constraints, draw((1, count, s, q, columns)), draw((1, count, s, n, columns))
    )
    sides = draw((2, 1, count, n, 2 * n))
    ends = Ends(end_hessian + end_hessian.swapaxes(2, 3), *sides, draw((1, count, 2 * n, columns)))
    h, tableau = 0.1 + rng.random((1, count)), Tableau(0.3 * draw((s, s)), rng.random(s))
    return (points, ends, h, tableau), CollocationArrays(h[0], *tableau, *(a[0] for a in (*points, *ends)))


@pytest.mark.parametrize("own", SETS)
@pytest.mark.parametrize("sizes", [(1, 1, 0, 1), (1, 2, 1, 1), (2, 3, 1, 2), (3, 6, 3, 1), (4, 2, 9, 3), (2, 9, 0, 1)])
def test_condensed_systems_and_their_expansions_are_those_of_the_engine(sizes, own):
    rng = np.random.default_rng(sum(sizes))
    for _ in range(5):
        theirs, arrays = drawn(rng, *sizes)
        parts, kept = condense(*theirs)
        ours, ours_kept = condense_steps(arrays, own)
        size = max(np.abs(a).max() for a in parts)
        for name, a, b in zip(parts._fields, ours, parts, strict=False):
            np.testing.assert_allclose(a, b[0], rtol=1e-9, atol=1e-10 * size, err_msg=name)
        np.testing.assert_array_equal(ours.hessian, ours.hessian.swapaxes(1, 2))
        s, n, m, columns = sizes
        step, multipliers = rng.standard_normal((4, n + s * m, columns)), rng.standard_normal((5, n, columns))
        expanded = expand(kept, step[None], multipliers[None])
        velocities, lambdas = expand_steps(arrays, ours_kept, step, multipliers)
        for a, b in ((velocities, expanded.dnu[0]), (lambdas, expanded.dlambda[0])):
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9 * np.abs(b).max())
        both, pull = rng.standard_normal((2, 1, 4, s, 3 * n + m)), rng.standard_normal((1, 4, 2 * n))
        outer, inner = slopes((both[0], both[1]), pull, kept)
        for k, end_slope in enumerate((pull[0], None)):
            found = condense_slope(arrays, ours_kept, both[k, 0], end_slope)
            for a, b in zip(found, (inner[k][0], outer[k][0]), strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10 * np.abs(b).max())


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_step_that_is_not_finite_leaves_the_others_as_they_are(bad):
    _, arrays = drawn(np.random.default_rng(1), 2, 3, 1, 1)
    expected = condense_steps(arrays)[0]
    for name in ("hessian", "jacobian", "slope", "defect", "end_hessian", "end_left", "end_right", "end_slope"):
        wrong = getattr(arrays, name).copy()
        wrong[2] = bad
        found, kept = condense_steps(arrays._replace(**{name: wrong}))
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_array_equal(a[[0, 1, 3]], b[[0, 1, 3]])
        assert not all(np.isfinite(a[2]).all() for a in (*found, *kept))


def test_arrays_that_do_not_fit_are_refused():
    _, arrays = drawn(np.random.default_rng(2), 2, 3, 1, 1)
    _, kept = condense_steps(arrays)
    for name in CollocationArrays._fields:
        block = getattr(arrays, name)
        for wrong in (block[:-1].copy(), block.astype(np.float32), block[..., None]):
            with pytest.raises(InvalidInputError, match=r"of collocation steps: got|have Jacobians"):
                condense_steps(arrays._replace(**{name: wrong}))
    with pytest.raises(InvalidInputError, match="have Jacobians"):
        condense_steps(arrays._replace(jacobian=arrays.jacobian[..., :8].copy()))
    step, multipliers = np.zeros((4, 5, 1)), np.zeros((5, 3, 1))
    expand_steps(arrays, kept, step, multipliers)
    for wrong in ((step[:-1].copy(), multipliers), (step, multipliers[:-1].copy()), (step[..., 0].copy(), multipliers)):
        with pytest.raises(InvalidInputError, match="of a condensed system: got"):
            expand_steps(arrays, kept, *wrong)
    with pytest.raises(InvalidInputError, match="swaps of condensed steps"):
        expand_steps(arrays, kept._replace(swaps=kept.swaps.astype(np.int32)), step, multipliers)
