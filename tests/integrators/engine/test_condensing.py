"""Condensing of Gauss's method against the whole KKT matrix with all velocities and multipliers."""

import os

import numpy as np
import pytest
from retrax.integrators.boundary_value.engine.condensing import (
    Ends,
    Points,
    Tableau,
    condense,
    expand,
    full_slope,
    slopes,
)
from retrax.integrators.boundary_value.engine.elimination import eliminate, is_strict_minimum

BATCH, COUNT, NODE, CONTROLS, COLUMNS = 3, 7, 3, 2, 2
POINT = 3 * NODE + CONTROLS


def gauss(s: int) -> Tableau:
    """The tableau of Gauss's method with s stages about the middle of the step."""
    x, b = np.polynomial.legendre.leggauss(s)
    c, powers = (x + 1) / 2, np.arange(s)
    a = (c[:, None] ** (powers + 1) / (powers + 1)) @ np.linalg.inv(c[:, None] ** powers)
    return Tableau(a - b / 4, b / 2)


def random_steps(seed: int, s: int, convex: bool = False) -> tuple[Points, Ends, np.ndarray]:
    """Derivatives at points and ends, and step sizes; velocities are nearly what the points' equations determine."""
    rng = np.random.default_rng(seed)

    def symmetric(*shape: int) -> np.ndarray:
        a = rng.standard_normal(shape)
        return a @ a.swapaxes(-1, -2) if convex else a + a.swapaxes(-1, -2)

    shape = BATCH, COUNT, s
    constraints = 0.3 * rng.standard_normal((*shape, NODE, POINT))
    constraints[..., 2 * NODE : 3 * NODE] += np.eye(NODE)
    points = symmetric(*shape, POINT, POINT), constraints, rng.standard_normal((*shape, POINT, COLUMNS))
    left, right = 0.3 * rng.standard_normal((2, BATCH, COUNT, NODE, 2 * NODE)) + np.eye(NODE, 2 * NODE)
    ends = (
        symmetric(BATCH, COUNT, 2 * NODE, 2 * NODE),
        left,
        right,
        rng.standard_normal((BATCH, COUNT, 2 * NODE, COLUMNS)),
    )
    h = 0.5 + rng.random((BATCH, COUNT))
    return Points(*points, rng.standard_normal((*shape, NODE, COLUMNS))), Ends(*ends), h


def maps(h: float, tableau: Tableau) -> tuple[np.ndarray, np.ndarray]:
    """What the unknowns ``(dx, dnu, du)`` of a step make of ``(dx, dxi, dnu, du)`` at each point, and of ``(dx,
    deta)``."""
    s, eye = len(tableau.weights), np.eye(NODE)
    x, nu, u = np.split(np.eye(NODE + s * (NODE + CONTROLS)), [NODE, NODE + s * NODE])
    points = []
    for i in range(s):
        xi = h * np.kron(tableau.matrix[i], eye) @ nu
        points.append(np.concatenate([x, xi, nu[i * NODE : (i + 1) * NODE], u[i * CONTROLS : (i + 1) * CONTROLS]]))
    return np.array(points), np.concatenate([x, h * np.kron(tableau.weights, eye) @ nu])


def dense(points: Points, ends: Ends, h: np.ndarray, tableau: Tableau, gap: np.ndarray, fixed: np.ndarray, b: int):
    """KKT matrix and right-hand side of member b, with the slopes of its steps; each step has its unknowns and
    multipliers."""
    s = len(tableau.weights)
    size = NODE + s * (2 * NODE + CONTROLS)
    own = size - s * NODE
    total = COUNT * size + (COUNT + 1) * NODE
    matrix, side, slopes = np.zeros((total, total)), np.zeros((total, COLUMNS)), []
    for k in range(COUNT):
        each, both = maps(h[b, k], tableau)
        hessian = (
            sum(t.T @ p @ t for t, p in zip(each, points.hessian[b, k], strict=True))
            + both.T @ ends.hessian[b, k] @ both
        )
        slope = sum(t.T @ g for t, g in zip(each, points.slope[b, k], strict=True)) + both.T @ ends.slope[b, k]
        equations = np.concatenate([c @ t for t, c in zip(each, points.constraints[b, k], strict=True)])
        first = k * size
        unknowns, lambdas = slice(first, first + own), slice(first + own, first + size)
        matrix[unknowns, unknowns], matrix[lambdas, unknowns], matrix[unknowns, lambdas] = (
            hessian,
            equations,
            equations.T,
        )
        side[unknowns], side[lambdas] = -slope, -points.defect[b, k].reshape(s * NODE, COLUMNS)
        node = COUNT * size + k * NODE
        across = np.concatenate([ends.left[b, k] @ both, -ends.right[b, k] @ both])
        matrix[node : node + 2 * NODE, unknowns] += across
        matrix[unknowns, node : node + 2 * NODE] += across.T
        slopes.append(slope)
    free = np.flatnonzero(fixed == 0) + COUNT * size
    side[COUNT * size :] = -gap[b].reshape(-1, COLUMNS)
    matrix[free], matrix[:, free], side[free] = 0.0, 0.0, 0.0
    matrix[free, free] = -1.0
    return matrix, side, np.array(slopes)


@pytest.mark.parametrize("free", [0, 2])
@pytest.mark.parametrize("s", [1, 2, 3, 4])
def test_the_condensed_system_has_the_step_the_multipliers_and_the_inertia_of_the_whole(s, free):
    (points, ends, h), tableau = random_steps(s, s), gauss(s)
    gap = np.random.default_rng(9).standard_normal((BATCH, COUNT + 1, NODE, COLUMNS))
    start, end = np.ones((BATCH, NODE)), np.ones((BATCH, NODE))
    start[:, :free], end[:, free:] = 0.0, 1.0
    fixed = np.concatenate([start[0], np.ones((COUNT - 1) * NODE), end[0]])
    parts, kept = condense(points, ends, h, tableau)
    solution = eliminate(parts.system(gap, start, end))
    full = expand(kept, solution.steps, solution.multipliers)
    slopes = full_slope(points, ends, h, tableau)
    for b in range(BATCH):
        matrix, side, slope = dense(points, ends, h, tableau, gap, fixed, b)
        expected = np.linalg.solve(matrix, side)
        flat = [a[b].reshape(COUNT, -1, COLUMNS) for a in (full.dx, full.dnu, full.du, full.dlambda)]
        found = np.concatenate(
            [np.concatenate(flat, axis=1).reshape(-1, COLUMNS), solution.multipliers[b].reshape(-1, COLUMNS)]
        )
        rounding = 1e-12 * np.linalg.cond(matrix) * np.max(np.abs(expected))
        assert np.max(np.abs(found - expected)) < rounding
        np.testing.assert_allclose(slopes[b], slope, rtol=1e-12, atol=1e-12)
        assert solution.negative[b] + s * NODE * COUNT == np.sum(np.linalg.eigvalsh(matrix) < 0)


@pytest.mark.parametrize("decade", range(-3, 4))
@pytest.mark.parametrize("s", [2, 3, 4])
def test_a_state_that_rests_stays_at_rest_however_fast_others_change_with_it(s, decade):
    (points, ends, h), last = random_steps(s, s), NODE - 1
    constraints = np.array(points.constraints)
    constraints[..., NODE + last] *= 10.0**decade
    constraints[..., last, :] = np.eye(POINT)[2 * NODE + last]
    _, kept = condense(points._replace(constraints=constraints), ends, h, gauss(s))
    moves = kept.kept[2].reshape(BATCH, COUNT, s, NODE, -1)[:, :, :, last, : NODE + s * CONTROLS]
    assert not moves.any()


@pytest.mark.parametrize("s", [1, 2, 4])
def test_slopes_by_what_is_left_have_those_by_the_velocities_through_their_map(s):
    (points, ends, h), tableau = random_steps(s, s), gauss(s)
    _, condensed = condense(points, ends, h, tableau)
    cost = np.random.default_rng(3).standard_normal(points.slope.shape[:4])
    lagrangian, pull = points.slope[..., 0], ends.slope[..., 0]
    (whole, paid), inside = slopes((lagrangian, cost), pull, condensed)
    maps = condensed.kept[2].reshape(BATCH, COUNT, *condensed.kept[2].shape[1:])[..., : whole.shape[2]]
    for found, velocities, own, of_ends in ((whole, inside[0], lagrangian, pull), (paid, inside[1], cost, 0 * pull)):
        full = full_slope(points._replace(slope=own[..., None]), ends._replace(slope=of_ends[..., None]), h, tableau)[
            ..., 0
        ]
        middle = full[..., NODE : NODE + s * NODE]
        left = np.concatenate([full[..., :NODE], full[..., NODE + s * NODE :]], axis=2)
        np.testing.assert_allclose(velocities.reshape(middle.shape), middle, rtol=1e-13, atol=1e-13)
        expected = left + np.einsum("bkiz,bki->bkz", maps, middle)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(maps).max())


def test_the_condensed_inertia_follows_the_whole_through_zero():
    """The curvature of the controls is lowered until the whole matrix is singular, and on."""
    s, tableau = 2, gauss(2)
    points, ends, h = random_steps(5, s, convex=True)
    gap, ones = np.zeros((BATCH, COUNT + 1, NODE, COLUMNS)), np.ones((BATCH, NODE))

    def negative(shift: float, b: int) -> tuple[int, int, bool]:
        lowered = points._replace(hessian=points.hessian - shift * np.diag(np.arange(POINT) >= 3 * NODE))
        solution = eliminate(condense(lowered, ends, h, tableau)[0].system(gap, ones, ones))
        matrix = dense(lowered, ends, h, tableau, gap, np.ones((COUNT + 1) * NODE), b)[0]
        told = is_strict_minimum(solution, (COUNT + 1) * NODE)[b]
        return solution.negative[b] + s * NODE * COUNT, np.sum(np.linalg.eigvalsh(matrix) < 0), told

    equations = (COUNT + 1 + s * COUNT) * NODE
    low, high = 0.0, 100.0
    for _ in range(30):
        middle = (low + high) / 2
        ours, theirs, strict = negative(middle, 0)
        assert ours == theirs or high - low < 1e-7
        low, high = (middle, high) if theirs == equations else (low, middle)
        assert strict == (theirs == equations) or high - low < 1e-3
    assert 0 < low < 100


def test_steps_do_not_know_of_each_other(monkeypatch):
    (points, ends, h), tableau = random_steps(1, 3), gauss(3)
    together = condense(points, ends, h, tableau)[0]
    monkeypatch.setattr("retrax.compute.threads.WORTH_A_THREAD", 1)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    for b in range(BATCH):
        mine = slice(b, b + 1)
        alone = condense(Points(*(a[mine] for a in points)), Ends(*(a[mine] for a in ends)), h[mine], tableau)[0]
        for ours, theirs in zip(together, alone, strict=True):
            assert np.array_equal(ours[b], theirs[0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("field", Points._fields)
def test_points_that_are_not_finite_have_no_step(field, bad):
    (points, ends, h), tableau = random_steps(2, 2), gauss(2)
    getattr(points, field)[1, 3, 1, ..., 0] = bad
    parts, kept = condense(points, ends, h, tableau)
    ones = np.ones((BATCH, NODE))
    solution = eliminate(parts.system(np.zeros((BATCH, COUNT + 1, NODE, COLUMNS)), ones, ones))
    expanded = expand(kept, solution.steps, solution.multipliers)
    assert np.isnan(solution.steps[1, ..., 0]).all()
    assert np.isfinite(solution.steps[[0, 2]]).all()
    assert all(np.isfinite(a[[0, 2]]).all() for a in expanded)
    assert np.isnan(expanded.dnu[1, ..., 0]).all()


def test_equations_that_do_not_determine_the_velocities_have_no_step():
    (points, ends, h), tableau = random_steps(2, 2), gauss(2)
    points.constraints[0, 2, 1, 0] = 0.0
    parts, _ = condense(points, ends, h, tableau)
    ones = np.ones((BATCH, NODE))
    solution = eliminate(parts.system(np.zeros((BATCH, COUNT + 1, NODE, COLUMNS)), ones, ones))
    assert np.isnan(solution.steps[0]).all()
    assert np.isfinite(solution.steps[1:]).all()
