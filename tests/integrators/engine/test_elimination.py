"""The block elimination of a batch of KKT systems against dense linear algebra."""

import os

import numpy as np
import pytest
from retrax.integrators.boundary_value.engine.border import Response
from retrax.integrators.boundary_value.engine.elimination import BlockSystem, eliminate, is_strict_minimum
from retrax.integrators.boundary_value.engine.joint import JointConditions
from retrax.integrators.boundary_value.engine.scaling import Units, natural_units

from .systems import assert_solves, dense, flat, matrix, random_system

SIZES = 3, 4, 3, 5, 2
ENDS = [(0, 0), (1, 0), (0, 2), (2, 1), (3, 0), (3, 3)]


def constraints(system: BlockSystem) -> int:
    """Number of the nodes' equations."""
    return system.gap.shape[1] * system.gap.shape[2]


@pytest.mark.parametrize("free", ENDS)
@pytest.mark.parametrize("convex", [True, False])
@pytest.mark.parametrize("sizes", [SIZES, (1, 1, 1, 3, 1), (2, 2, 3, 8, 1), (1, 3, 3, 17, 3)])
def test_elimination_solves_the_kkt_system(sizes, convex, free):
    if sizes[2] == 1:
        free = min(free[0], 1), min(free[1], 1)
    system = random_system(17, sizes, free, convex)
    solution = eliminate(system)
    assert_solves(system, solution)
    for m in range(sizes[0]):
        assert solution.negative[m] == np.sum(np.linalg.eigvalsh(matrix(system, m)) < 0)


def test_the_largest_sizes():
    system = random_system(3, (1, 3, 30, 60, 2))
    assert_solves(system, eliminate(system))


def test_long_trajectories():
    """Residuals in the equations themselves: the dense matrix of so many steps is too large."""
    system = random_system(5, (1, 10_000, 1, 2, 1))
    system = system._replace(left=system.left * 0.1 + np.eye(1, 2), right=system.right * 0.1 + np.eye(1, 2))
    steps, c, *_ = eliminate(system)
    slope = system.hessian @ steps + system.left.swapaxes(2, 3) @ c[:, :-1] - system.right.swapaxes(2, 3) @ c[:, 1:]
    gap = np.zeros(system.gap.shape)
    gap[:, :-1] += system.left @ steps
    gap[:, 1:] -= system.right @ steps
    # The weights times the steps are what cancels in the multipliers.
    assert np.max(np.abs(slope + system.slope)) < 1e-13 * 256 * 10_000 * np.max(np.abs(steps))
    assert np.max(np.abs(gap + system.gap)) < 1e-12 * np.max(np.abs(steps))


@pytest.mark.parametrize("free", [(0, 0), (1, 2)])
@pytest.mark.parametrize("seed", range(4))
def test_the_inertia_follows_an_eigenvalue_of_the_reduced_hessian_through_zero(seed, free):
    """All shifts at once, a member each: in the middle the eigenvalue is zero, and none may call that a minimum."""
    one = random_system(seed, (1, *SIZES[1:]), free)
    hessian, rows, diagonal, _ = dense(one, 0)
    fixed = rows[np.diag(diagonal) == 0]
    null = np.linalg.svd(fixed)[2][np.linalg.matrix_rank(fixed) :].T
    lowest = np.linalg.eigvalsh(null.T @ hessian @ null)[0]
    tilts = np.array([-3.0, -1.0, -0.1, -1e-3, -1e-5, -1e-9, 0.0, 1e-9, 1e-5, 1e-3, 0.1, 1.0, 3.0, 30.0])
    system = BlockSystem(*(np.repeat(a, len(tilts), axis=0) for a in one))
    shift = -(1 + tilts) * lowest
    solution = eliminate(system, shift=shift)
    told = np.abs(tilts) != 1e-9  # so near to zero the inertia is right, and rounding may be the reason
    assert list(is_strict_minimum(solution, constraints(system))[told]) == list(tilts[told] < 0)
    for m in np.flatnonzero(tilts):
        tilted = system._replace(hessian=system.hessian + shift[m] * np.eye(SIZES[3]))
        assert solution.negative[m] == np.sum(np.linalg.eigvalsh(matrix(tilted, m)) < 0)


def test_the_largest_steps_are_those_of_the_first_column():
    solution = eliminate(random_system(3, SIZES, (0, 0)))
    np.testing.assert_array_equal(solution.largest, np.abs(solution.steps[..., 0]).max(axis=1))
    broken = random_system(3, SIZES, (0, 0))
    broken.gap[1, 2] = np.nan
    largest = eliminate(broken).largest
    assert np.isnan(largest[1]).all()
    np.testing.assert_array_equal(largest[[0, 2]], solution.largest[[0, 2]])


def test_a_shift_raises_the_hessian_by_its_scales():
    rng, system = np.random.default_rng(2), random_system(2, SIZES, convex=False)
    shift, scales = np.array([0.0, 0.5, 40.0]), 0.1 + rng.random((3, 5))
    solution = eliminate(system, shift=shift, scales=scales)
    raised = system.hessian + (shift[:, None] * scales)[:, None, None] * np.eye(5)
    assert_solves(system._replace(hessian=raised), solution)
    d = solution.steps[..., 0]
    np.testing.assert_allclose(solution.curvature, np.einsum("bki,bkij,bkj->b", d, raised, d), rtol=1e-9)
    np.testing.assert_allclose(solution.size, np.einsum("bki,bi,bki->b", d, scales, d), rtol=1e-12)


@pytest.mark.parametrize("free", ENDS)
def test_units_are_applied_as_if_the_system_were_written_in_them(free):
    rng, system = np.random.default_rng(3), random_system(3, SIZES, free)
    units = Units(10 ** rng.uniform(-4, 4, (3, 5)), 10 ** rng.uniform(-4, 4, (3, 3)), 10 ** rng.uniform(-4, 4, 3))
    # Written in units of its own, the system is the random one again.
    d, g, cost = units.unknowns[:, None, None], units.nodes[:, None, :, None], units.cost[:, None, None, None]
    own = system._replace(
        hessian=system.hessian / d / d.swapaxes(2, 3) * cost,
        left=system.left / d * g,
        right=system.right / d * g,
        slope=system.slope / d.swapaxes(2, 3) * cost,
        gap=system.gap * g,
    )
    shift = np.array([0.0, 0.1, 2.0])
    solution, plain = eliminate(own, units, shift), eliminate(system, shift=shift)
    in_units = solution._replace(
        steps=solution.steps / d.swapaxes(2, 3),
        multipliers=solution.multipliers * (g / cost),
        largest=solution.largest / units.unknowns,
    )
    for name, ours, theirs in zip(solution._fields, in_units, plain, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8, err_msg=name)
    steps, multipliers, *_ = eliminate(own, units)
    kkt, side = matrix(own, 1), dense(own, 1)[3]
    found = np.concatenate([steps[1].reshape(-1, 2), multipliers[1].reshape(-1, 2)])
    assert np.all(np.abs(kkt @ found - side) <= 1e-9 * (np.abs(kkt) @ np.abs(found) + np.abs(side)))


@pytest.mark.parametrize("threads", [False, True])
def test_members_of_a_batch_do_not_know_of_each_other(threads, monkeypatch):
    if threads:
        monkeypatch.setattr("retrax.compute.threads.WORTH_A_THREAD", 1)
        monkeypatch.setattr(os, "cpu_count", lambda: 3)
    system = random_system(8, (7, 4, 3, 5, 2), (1, 0), convex=False)
    together = eliminate(system, shift=np.linspace(0, 1, 7))
    for m in range(7):
        alone = eliminate(BlockSystem(*(a[m : m + 1] for a in system)), shift=np.linspace(0, 1, 7)[m : m + 1])
        for ours, theirs in zip(together, alone, strict=True):
            assert np.array_equal(ours[m], theirs[0])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["hessian", "left", "right"])
def test_a_matrix_that_is_not_finite_has_no_solution(field, bad):
    rng, system = np.random.default_rng(1), random_system(9, (2, 4, 3, 5, 2))
    expected = eliminate(system)
    block = getattr(system, field)
    for _ in range(12):
        place = (1, *(rng.integers(size) for size in block.shape[1:]))
        wrong = block.copy()
        wrong[place] = bad
        if field == "hessian":
            wrong[place[0], place[1], place[3], place[2]] = bad
        solution = eliminate(system._replace(**{field: wrong}))
        assert np.isnan(flat(solution, 1)).all()
        assert not is_strict_minimum(solution, constraints(system))[1]
        assert np.array_equal(flat(solution, 0), flat(expected, 0))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("field", ["slope", "gap"])
def test_a_column_that_is_not_finite_has_no_solution_but_the_others_have(field, bad):
    system = random_system(9, (2, 4, 3, 5, 2))
    expected = eliminate(system)
    getattr(system, field)[1, 2, 1, 1] = bad
    getattr(system, field)[1, 0, 1, 1] = -bad
    solution = eliminate(system)
    assert np.isnan(flat(solution, 1)[:, 1]).all()
    assert np.array_equal(flat(solution, 1)[:, 0], flat(expected, 1)[:, 0])
    assert is_strict_minimum(solution, constraints(system)).all()


def test_a_singular_matrix_has_no_strict_minimum():
    """An unknown that nothing depends on, and an equation of no unknown."""
    for change in (
        lambda s: (s.hessian[..., 4, :], s.hessian[..., 4], s.left[..., 4], s.right[..., 4]),
        lambda s: (s.left[:, 0, 1],),
    ):
        system = random_system(4)
        for part in change(system):
            part[:] = 0.0
        assert not is_strict_minimum(eliminate(system), constraints(system)).any()


@pytest.mark.parametrize("count", [3, 10, 100, 1000, 10_000])
def test_the_inertia_of_a_trajectory_whose_length_goes_through_a_conjugate_point(count):
    """Oscillators, half of their period from end to end: all lengths at once."""
    offs = np.array([-1e-2, -1e-4, -1e-6, 0.0, 1e-6, 1e-4, 1e-2])
    h = 2 * np.tan(np.pi / count / 2) * (1 + offs[:, None, None, None])
    one = np.ones_like(h)
    left, right = np.concatenate([one, -h / 2], axis=3), np.concatenate([one, h / 2], axis=3)
    hessian = h * np.diag([-1.0, 1.0])
    blocks = [np.repeat(a, count, axis=1) for a in (hessian, left, right)]
    sides = np.ones((len(offs), count, 2, 1)), np.zeros((len(offs), count + 1, 1, 1))
    system = BlockSystem(*blocks, *sides, one[:, 0, 0], one[:, 0, 0])
    units = natural_units(system, np.zeros((len(offs), count, 2)), one[:, 0, 0], one[:, 0, 0])
    solution = eliminate(system, units)
    assert list(is_strict_minimum(solution, count + 1)) == list(offs < 0)
    assert list(solution.negative[offs != 0] - count - 1) == list(offs[offs != 0] > 0)


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-12, 1e-9, -1e-6, 1e-3])
def test_focal_points_inside_a_trajectory_cost_no_digits(off):
    """An oscillator is a quarter of its period from the start at a node: the problem up to it, with a free end, is
    singular.

    Midpoint steps turn by 2 atan(h / 2); three of them by a quarter.
    """
    h = 2 * np.tan(np.pi / 12) * (1 + off)
    rng, count = np.random.default_rng(0), 5
    end = np.repeat(np.array([[[1.0, h / 2]]]), count, axis=0)[None]
    start = np.repeat(np.array([[[1.0, -h / 2]]]), count, axis=0)[None]
    hessian = np.repeat(h * np.diag([-1.0, 1.0])[None], count, axis=0)[None]
    sides = rng.standard_normal((1, count, 2, 1)), rng.standard_normal((1, count + 1, 1, 1))
    system = BlockSystem(hessian, start, end, *sides, np.ones((1, 1)), np.ones((1, 1)))
    part = BlockSystem(*(a[:, :3] for a in system[:4]), system.gap[:, :4], np.ones((1, 1)), np.zeros((1, 1)))
    assert np.min(np.abs(np.linalg.eigvalsh(matrix(part, 0)))) < 1e-14 + 3 * abs(off)
    solution = eliminate(system)
    assert is_strict_minimum(solution, constraints(system)).all()
    expected = np.linalg.solve(matrix(system, 0), dense(system, 0)[3])
    assert np.max(np.abs(flat(solution, 0) - expected)) < 1e-11 * np.max(np.abs(expected))


@pytest.mark.parametrize("bad", [None, "steps", "multipliers"])
def test_the_step_of_a_phase_is_finite_where_its_steps_and_its_multipliers_are(bad):
    draw, free = np.random.default_rng(0).standard_normal, (np.array([1]), np.array([0, 1]))
    parts = {"steps": draw((2, 4, 3, 4)), "multipliers": draw((2, 5, 2, 4))}
    if bad is not None:
        parts[bad][1, 2, 0, 1] = np.nan
    ends = draw((2, 1, 4)), draw((2, 2, 4)), np.zeros((2, 2)), np.ones((2, 2)), free, np.zeros(2), np.ones(2)
    found = JointConditions._step(Response(*parts.values(), *ends), draw((2, 1)), draw((2, 2)), draw((2, 2)))
    assert found.finite.tolist() == [True, bad is None]
