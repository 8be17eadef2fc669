"""The core's condensing against the equations in all velocities and multipliers, as dense matrices."""

import numpy as np
import pytest
from retrax.compute.binding.block_elimination import BlockArrays, solve_blocks
from retrax.compute.binding.condensing import CollocationArrays, condense_slope, condense_steps
from retrax.compute.binding.library import best_instruction_set
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, Gauss

from .core_calls import expand_steps

SETS = range(best_instruction_set() + 1)
COUNT = 4  # steps


def drawn(rng, s, n, m, columns, convex=False):
    """Equations of four steps, whose velocities are nearly what the equations of the points determine."""
    q, draw = 3 * n + m, rng.standard_normal

    def symmetric(*shape):
        a = draw(shape)
        return np.ascontiguousarray(a @ a.swapaxes(-1, -2) if convex else a + a.swapaxes(-1, -2))

    jacobian = 0.3 * draw((COUNT, s, n, q))
    jacobian[..., 2 * n : 3 * n] += np.eye(n)
    left, right = 0.3 * draw((2, COUNT, n, 2 * n)) + np.eye(n, 2 * n)
    points = symmetric(COUNT, s, q, q), jacobian, draw((COUNT, s, q, columns)), draw((COUNT, s, n, columns))
    ends = symmetric(COUNT, 2 * n, 2 * n), left, right, draw((COUNT, 2 * n, columns))
    return CollocationArrays(0.1 + rng.random(COUNT), 0.3 * draw((s, s)), rng.random(s), *points, *ends)


def maps(arrays, k):
    """``(dx, dxi, dnu, du)`` of each point and ``(dx, deta)`` as functions of the unknowns ``(dx, dnu, du)`` of a
    step."""
    s, n, q = arrays.jacobian.shape[1:]
    m = q - 3 * n
    x, nu, u = np.split(np.eye(n + s * (n + m)), [n, n + s * n])
    points, h = [], arrays.step_size[k]
    for i in range(s):
        xi = h * np.kron(arrays.matrix[i], np.eye(n)) @ nu
        points.append(np.concatenate([x, xi, nu[i * n : (i + 1) * n], u[i * m : (i + 1) * m]]))
    return points, np.concatenate([x, h * np.kron(arrays.weights, np.eye(n)) @ nu])


def whole(arrays, k):
    """Hessian, equations of the points, slope, defect, and derivatives of both ends in ``(dx, dnu, du)`` of a step."""
    points, both = maps(arrays, k)
    hessian = both.T @ arrays.end_hessian[k] @ both
    hessian += sum(t.T @ p @ t for t, p in zip(points, arrays.hessian[k], strict=True))
    equations = np.concatenate([c @ t for t, c in zip(points, arrays.jacobian[k], strict=True)])
    slope = sum(t.T @ g for t, g in zip(points, arrays.slope[k], strict=True)) + both.T @ arrays.end_slope[k]
    defect = arrays.defect[k].reshape(len(equations), -1)
    return hessian, equations, slope, defect, arrays.end_left[k] @ both, arrays.end_right[k] @ both


def matrix(arrays):
    """The KKT matrix in the unknowns and multipliers of all steps, then the multipliers of the nodes."""
    parts = [whole(arrays, k) for k in range(COUNT)]
    p, size = parts[0][1].shape
    n = arrays.end_left.shape[1]
    own, nodes = size + p, COUNT * (size + p)
    found = np.zeros((nodes + (COUNT + 1) * n,) * 2)
    for k, (hessian, equations, _, _, left, right) in enumerate(parts):
        unknowns, lambdas = slice(k * own, k * own + size), slice(k * own + size, (k + 1) * own)
        found[unknowns, unknowns], found[lambdas, unknowns] = hessian, equations
        found[nodes + k * n : nodes + (k + 2) * n, unknowns] = np.concatenate([left, -right])
        rows = found[:, unknowns].copy()
        rows[unknowns] = found[unknowns, unknowns].T
        found[unknowns, :] = rows.T
    return found


def blocks(arrays, condensed, defect):
    n, z = condensed.left.shape[1:]
    ones = np.ones(n), np.ones(n), np.ones(z), np.ones(n), np.ones(z)
    sides = condensed.slope, np.ascontiguousarray(with_mending(condensed, defect))
    return BlockArrays(condensed.hessian, condensed.left, condensed.right, *sides, *ones)


def with_mending(condensed, defect):
    """The defects of the nodes, and what velocities that mend the defects of points move the ends by."""
    found = defect.copy()
    found[:-1] += condensed.before
    found[1:] -= condensed.after
    return found


@pytest.mark.parametrize("own", SETS)
@pytest.mark.parametrize("sizes", [(1, 1, 0, 1), (1, 2, 1, 1), (2, 3, 1, 2), (3, 6, 3, 1), (4, 2, 9, 3), (2, 9, 0, 1)])
def test_a_condensed_system_is_the_whole_on_the_null_space_of_the_points(sizes, own):
    """With ``dnu = -A_nu^-1 (A_w w + d)``; the multipliers follow from the rows of the velocities."""
    rng, (s, n, m, columns) = np.random.default_rng(sum(sizes)), sizes
    for _ in range(3):
        arrays = drawn(rng, *sizes)
        found, kept = condense_steps(arrays, own)
        np.testing.assert_array_equal(found.hessian, found.hessian.swapaxes(1, 2))
        step, multipliers = rng.standard_normal((COUNT, n + s * m, columns)), rng.standard_normal((5, n, columns))
        velocities, lambdas = expand_steps(arrays, kept, step, multipliers)
        slope, end_slope = rng.standard_normal((COUNT, s, 3 * n + m)), rng.standard_normal((COUNT, 2 * n))
        slopes = condense_slope(arrays, kept, slope, end_slope)
        for k in range(COUNT):
            hessian, equations, pull, defect, left, right = whole(arrays, k)
            inner = np.arange(n, n + s * n)
            outer = np.setdiff1d(np.arange(len(hessian)), inner)
            z, y = np.zeros((len(hessian), len(outer))), np.zeros((len(hessian), columns))
            z[outer], z[inner] = np.eye(len(outer)), -np.linalg.solve(equations[:, inner], equations[:, outer])
            y[inner] = -np.linalg.solve(equations[:, inner], defect)
            size = np.linalg.cond(equations[:, inner]) ** 2 * np.abs(hessian).max()
            expected = z.T @ hessian @ z, left @ z, right @ z, z.T @ (pull + hessian @ y), left @ y, right @ y
            for name, a, b in zip(found._fields, found, expected, strict=True):
                np.testing.assert_allclose(a[k], b, rtol=1e-9, atol=1e-12 * size, err_msg=name)
            moves = z @ step[k] + y
            np.testing.assert_allclose(velocities[k].reshape(s * n, -1), moves[inner], rtol=1e-8, atol=1e-12 * size)
            rows = hessian @ moves + pull + left.T @ multipliers[k] - right.T @ multipliers[k + 1]
            own_lambdas = -np.linalg.solve(equations[:, inner].T, rows[inner])
            np.testing.assert_allclose(lambdas[k].reshape(s * n, -1), own_lambdas, rtol=1e-7, atol=1e-11 * size)
            points, both = maps(arrays, k)
            full = sum(t.T @ g for t, g in zip(points, slope[k], strict=True)) + both.T @ end_slope[k]
            np.testing.assert_allclose(slopes[0][k].ravel(), full[inner], rtol=1e-9, atol=1e-12 * size)
            np.testing.assert_allclose(slopes[1][k], z.T @ full, rtol=1e-9, atol=1e-12 * size)


@pytest.mark.parametrize("own", SETS)
@pytest.mark.parametrize("s", [1, 2, 3, 4])
def test_the_condensed_trajectory_has_the_step_and_the_inertia_of_the_whole(s, own):
    n, m, columns, rng = 3, 2, 2, np.random.default_rng(s)
    arrays, defect = drawn(rng, s, n, m, columns), rng.standard_normal((COUNT + 1, n, columns))
    condensed, kept = condense_steps(arrays, own)
    solution = solve_blocks(blocks(arrays, condensed, defect), instruction_set=own)
    velocities, lambdas = expand_steps(arrays, kept, solution.step, solution.multipliers)
    of_steps = [np.concatenate([solution.step[k, :n], velocities[k].reshape(s * n, -1), solution.step[k, n:],
                                lambdas[k].reshape(s * n, -1)]) for k in range(COUNT)]  # fmt: skip
    found = np.concatenate([*of_steps, solution.multipliers.reshape(-1, columns)])
    parts = [whole(arrays, k) for k in range(COUNT)]
    side = -np.concatenate([*(np.concatenate([own[2], own[3]]) for own in parts), defect.reshape(-1, columns)])
    kkt = matrix(arrays)
    np.testing.assert_allclose(kkt, kkt.T, atol=1e-12)
    expected = np.linalg.solve(kkt, side)
    assert np.abs(found - expected).max() < 1e-12 * np.linalg.cond(kkt) * np.abs(expected).max()
    assert solution.negative + s * n * COUNT == np.sum(np.linalg.eigvalsh(kkt) < 0)


def test_the_condensed_inertia_follows_the_whole_through_zero():
    """The curvature of the controls is lowered until the whole matrix is singular, and on."""
    n, m, s, rng = 3, 2, 2, np.random.default_rng(5)
    tableau = Gauss(s, Addition(Euclidean(1)))
    arrays = drawn(rng, s, n, m, 1, convex=True)
    arrays = arrays._replace(matrix=np.array(tableau.centred), weights=np.array(tableau.weights))
    low, high, equations = 0.0, 100.0, (COUNT + 1 + s * COUNT) * n
    for _ in range(30):
        middle = (low + high) / 2
        hessian = arrays.hessian - middle * np.diag(np.arange(3 * n + m) >= 3 * n)
        lowered = arrays._replace(hessian=hessian)
        condensed = condense_steps(lowered)[0]
        solution = solve_blocks(blocks(lowered, condensed, np.zeros((COUNT + 1, n, 1))))
        theirs = np.sum(np.linalg.eigvalsh(matrix(lowered)) < 0)
        assert solution.negative + s * n * COUNT == theirs or high - low < 1e-7
        low, high = (middle, high) if theirs == equations else (low, middle)
    assert 0 < low < 100


@pytest.mark.parametrize("decade", range(-3, 4))
@pytest.mark.parametrize("s", [2, 3, 4])
def test_a_state_at_rest_stays_at_rest_however_fast_others_change_with_it(s, decade):
    n, m = 3, 2
    arrays = drawn(np.random.default_rng(s), s, n, m, 1)
    jacobian = arrays.jacobian.copy()
    jacobian[..., n + 2] *= 10.0**decade
    jacobian[..., 2, :] = np.eye(3 * n + m)[2 * n + 2]
    _, kept = condense_steps(arrays._replace(jacobian=jacobian))
    assert not kept.velocities.reshape(COUNT, s, n, -1)[:, :, 2, : n + s * m].any()


def test_equations_that_do_not_determine_the_velocities_have_no_step():
    arrays = drawn(np.random.default_rng(2), 2, 3, 2, 1)
    arrays.jacobian[2, 1, 0] = 0.0
    condensed, _ = condense_steps(arrays)
    assert not np.isfinite(condensed.hessian[2]).all()
    assert np.isfinite(condensed.hessian[[0, 1, 3]]).all()
    solution = solve_blocks(blocks(arrays, condensed, np.zeros((COUNT + 1, 3, 1))))
    assert not solution.finite.any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_step_that_is_not_finite_leaves_the_others_as_they_are(bad):
    arrays = drawn(np.random.default_rng(1), 2, 3, 1, 1)
    expected = condense_steps(arrays)[0]
    for name in ("hessian", "jacobian", "slope", "defect", "end_hessian", "end_left", "end_right", "end_slope"):
        wrong = getattr(arrays, name).copy()
        wrong[2] = bad
        found, kept = condense_steps(arrays._replace(**{name: wrong}))
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_array_equal(a[[0, 1, 3]], b[[0, 1, 3]])
        assert not all(np.isfinite(a[2]).all() for a in (*found, *kept))


def test_arrays_that_do_not_fit_are_refused():
    arrays = drawn(np.random.default_rng(2), 2, 3, 1, 1)
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
