"""The core's block elimination beside dense linear algebra: solutions and inertia."""

import numpy as np
import pytest
from retrax.compute.binding.block_elimination import BlockArrays, solve_blocks
from retrax.compute.binding.library import best_instruction_set
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.manifolds.numerics.tolerances import EPS, REGULAR
from retrax.retractions import Addition, Midpoint

from .block_systems import BlockSystem, dense, matrix, random_system

SETS = range(best_instruction_set() + 1)
TILTS = 10.0 ** np.array([-15, -12, -9, -6, -3, 0])


def clear_pivot(equations):
    """The smallest pivot beyond rounding, as ``retrax_inertia`` says, for up to a thousand equations."""
    return EPS**REGULAR * max(1.0, equations / 1e3)


def arrays_of(system, units=None, regularised=None):
    """The first system of a batch as the core has it; ``units``: of the unknowns and of the nodes."""
    n, z = system.left.shape[2:]
    scales = (np.ones(z), np.ones(n)) if units is None else units
    blocks = [np.ascontiguousarray(a[0]) for a in system]
    return BlockArrays(*blocks, *scales, np.ones(z) if regularised is None else regularised)


def flat(result):
    columns = result.step.shape[2]
    return np.concatenate([result.step.reshape(-1, columns), result.multipliers.reshape(-1, columns)])


def drawn(rng):
    """A system of random sizes, perhaps with free ends, perhaps not convex."""
    n, columns, count = int(rng.integers(1, 7)), int(rng.integers(1, 4)), int(rng.integers(1, 9))
    z = n + int(rng.integers(0, 9))
    free = tuple(int(rng.integers(0, n + 1)) * int(rng.random() < 0.5) for _ in range(2))
    return random_system(int(rng.integers(1 << 30)), (1, count, n, z, columns), free, bool(rng.random() < 0.5))


@pytest.mark.parametrize("own", SETS)
def test_solutions_and_inertia_are_those_of_the_dense_matrix(own):
    rng = np.random.default_rng(own)
    for _ in range(150):
        system = drawn(rng)
        result = solve_blocks(arrays_of(system), instruction_set=own)
        kkt = matrix(system, 0)
        eigenvalues = np.linalg.eigvalsh(kkt)
        size = np.abs(eigenvalues)
        if size.min() < 1e-10 * size.max():  # rounding decides the signs
            continue
        assert result.negative == np.sum(eigenvalues < 0)
        sizes = 1 / np.sqrt(np.abs(kkt).max(axis=1))
        assert result.smallest > 1e-3 * np.abs(np.linalg.eigvalsh(kkt * np.outer(sizes, sizes))).min()
        expected = np.linalg.solve(kkt, dense(system, 0)[3])
        error = np.abs(flat(result) - expected).max()
        assert error < 1e-13 * np.linalg.cond(kkt) * (1 + np.abs(expected).max())
        d, hessian = result.step[..., 0], system.hessian[0]
        curvature, most = (np.einsum("ki,kij,kj", f(d), f(hessian), f(d)) for f in (np.array, np.abs))
        assert abs(result.curvature - curvature) < 1e-14 * most
        assert result.size == pytest.approx(np.sum(d * d), rel=1e-14)
        np.testing.assert_array_equal(result.largest_step, np.abs(d).max(axis=0))
        assert result.finite.all()


@pytest.mark.parametrize("own", SETS)
def test_units_and_regularisation_are_applied_as_if_the_system_were_written_in_them(own):
    """Written in units of its own, a system has the solution that the raised dense matrix has without units."""
    rng = np.random.default_rng(20 + own)
    for _ in range(40):
        plain = random_system(int(rng.integers(1 << 30)), (1, 5, 3, 5, 2), (1, 2), convex=True)
        d, g, cost = 10 ** rng.uniform(-4, 4, 5), 10 ** rng.uniform(-4, 4, 3), float(10 ** rng.uniform(-4, 4))
        system = plain._replace(
            hessian=plain.hessian / np.outer(d, d) * cost,
            left=plain.left / d * g[:, None],
            right=plain.right / d * g[:, None],
            slope=plain.slope / d[:, None] * cost,
            gap=plain.gap * g[:, None],
        )
        scales, shift = rng.random(5), float(rng.random())
        result = solve_blocks(arrays_of(system, (d, g), scales), cost, shift, instruction_set=own)
        raised = plain._replace(hessian=plain.hessian + shift * np.diag(scales))
        kkt = matrix(raised, 0)
        assert result.negative == np.sum(np.linalg.eigvalsh(kkt) < 0)
        solution = np.linalg.solve(kkt, dense(raised, 0)[3])
        steps, multipliers = solution[:25].reshape(5, 5, 2), solution[25:].reshape(6, 3, 2)
        first = steps[..., 0]
        for ours, theirs in (
            (result.step / d[:, None], steps),
            (result.multipliers * g[:, None] / cost, multipliers),
            (result.largest_step / d, np.abs(first).max(axis=0)),
            (result.size, np.einsum("ki,i,ki", first, scales, first)),
            (result.curvature, np.einsum("ki,kij,kj", first, raised.hessian[0], first)),
        ):
            np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("own", SETS)
@pytest.mark.parametrize("tilt", [*-TILTS, 0.0, *TILTS])
def test_an_eigenvalue_of_the_reduced_hessian_goes_through_zero(tilt, own):
    """The smallest pivot goes through zero with it, in proportion: where that is clear the inertia is right, and it is
    clear where the eigenvalue is."""
    for seed in range(12):
        system = random_system(seed, (1, 4, 3, 5, 1), (seed % 3, 1), convex=False)
        hessian, rows, diagonal, _ = dense(system, 0)
        fixed = rows[np.diag(diagonal) == 0]
        null = np.linalg.svd(fixed)[2][np.linalg.matrix_rank(fixed) :].T
        lowest = np.linalg.eigvalsh(null.T @ hessian @ null)[0]
        shift = -lowest + tilt
        result = solve_blocks(arrays_of(system), 1.0, shift, own)
        count = rows.shape[0]
        clear = result.smallest > clear_pivot(count)
        if clear or abs(tilt) >= 1e-9:
            assert (result.negative == count) == (tilt > 0)
        if abs(tilt) >= 1e-9:
            tilted = system._replace(hessian=system.hessian + shift * np.eye(5))
            assert result.negative == np.sum(np.linalg.eigvalsh(matrix(tilted, 0)) < 0)
        assert clear or abs(tilt) < 1e-7
        assert not clear or abs(tilt) > 1e-13


def with_a_focal_point(seed, eigenvalue):
    """A system of which the leading block up to some stage has this eigenvalue on its null space."""
    rng, system, stage, z = (
        np.random.default_rng(seed),
        random_system(seed, (1, 5, 3, 5, 1), (seed % 3, 1)),
        seed % 4,
        5,
    )
    hessian, rows, diagonal, _ = dense(system, 0)
    count, equations = (stage + 1) * z, (stage + 1) * 3
    rows = rows[:equations, :count][np.diag(diagonal)[:equations] == 0]
    null = np.linalg.svd(rows)[2][len(rows) :].T
    way = np.zeros(count)
    way[-z:] = rng.standard_normal(z)
    own = null.T @ way
    most = 1 / (own @ np.linalg.solve(null.T @ hessian[:count, :count] @ null, own))
    system.hessian[0, stage] -= most * (1 - eigenvalue) * np.outer(way[-z:], way[-z:])
    return system


@pytest.mark.parametrize("own", SETS)
@pytest.mark.parametrize("eigenvalue", [0.0, *(sign * 10.0**-k for k in (1, 5, 8, 11, 15) for sign in (-1, 1))])
def test_a_leading_block_goes_through_a_singular_one(eigenvalue, own):
    """Where the block of the first stages is about singular and the matrix is not, solution and inertia stay right."""
    for seed in range(12):
        system = with_a_focal_point(seed, eigenvalue)
        kkt = matrix(system, 0)
        result, expected = (
            solve_blocks(arrays_of(system), instruction_set=own),
            np.linalg.solve(kkt, dense(system, 0)[3]),
        )
        assert result.negative == np.sum(np.linalg.eigvalsh(kkt) < 0)
        assert np.abs(flat(result) - expected).max() < 1e-9 * np.linalg.cond(kkt) * np.abs(expected).max()
        assert result.smallest > 1e-9


@pytest.mark.parametrize("own", SETS)
def test_singular_matrices(own):
    """Unknowns that nothing depends on, equations of no unknown, equal equations, and nothing at all."""
    for seed in range(10):
        for name in ("unknown", "equation", "equal equations", "zero"):
            system = random_system(seed, (1, 4, 3, 5, 2))
            if name == "unknown":
                for part in (
                    system.hessian[..., 4, :],
                    system.hessian[..., 4],
                    system.left[..., 4],
                    system.right[..., 4],
                ):
                    part[:] = 0.0
            elif name == "equation":
                system.left[:, 0, 1] = 0.0
            elif name == "equal equations":
                for part in (system.left, system.right):
                    part[:, :, 1] = part[:, :, 0]
            else:
                for part in (system.hessian, system.left, system.right):
                    part[:] = 0.0
            count = system.gap.shape[1] * system.gap.shape[2]
            result = solve_blocks(arrays_of(system), instruction_set=own)
            assert not (result.negative == count and result.smallest > clear_pivot(count)), name
            assert np.isfinite(flat(result)).all(axis=0).tolist() == result.finite.tolist()
            assert np.isnan(flat(result)[:, ~result.finite]).all()


def test_many_unknowns_of_a_stage():
    system = random_system(3, (1, 3, 30, 60, 2))
    kkt, expected = matrix(system, 0), np.linalg.solve(matrix(system, 0), dense(system, 0)[3])
    error = np.abs(flat(solve_blocks(arrays_of(system))) - expected).max()
    assert error < 1e-13 * np.linalg.cond(kkt) * (1 + np.abs(expected).max())


def test_long_trajectories():
    """Residuals in the equations themselves: the dense matrix of so many stages is too large."""
    system = random_system(5, (1, 10_000, 1, 2, 1))
    system = system._replace(left=system.left * 0.1 + np.eye(1, 2), right=system.right * 0.1 + np.eye(1, 2))
    result = solve_blocks(arrays_of(system))
    hessian, left, right, slope, gap = (own[0] for own in system[:5])
    d, c = result.step, result.multipliers
    stages = hessian @ d + left.swapaxes(1, 2) @ c[:-1] - right.swapaxes(1, 2) @ c[1:] + slope
    nodes = gap.copy()
    nodes[:-1] += left @ d
    nodes[1:] -= right @ d
    # The weights times the steps are what cancels in the multipliers.
    assert np.max(np.abs(stages)) < 1e-13 * 256 * 10_000 * np.max(np.abs(d))
    assert np.max(np.abs(nodes)) < 1e-12 * np.max(np.abs(d))


def oscillator(h, count, sides):
    """Midpoint steps of an oscillator: the kinetic less the potential energy, with both ends fixed."""
    left = np.repeat(np.array([[[[1.0, -h / 2]]]]), count, axis=1)
    right = np.repeat(np.array([[[[1.0, h / 2]]]]), count, axis=1)
    hessian = np.repeat(h * np.diag([-1.0, 1.0])[None, None], count, axis=1)
    return BlockSystem(hessian, left, right, *sides, np.ones((1, 1)), np.ones((1, 1)))


@pytest.mark.parametrize("count", [3, 10, 100, 1000, 10_000])
@pytest.mark.usual(1)
def test_the_inertia_of_a_trajectory_whose_length_goes_through_a_conjugate_point(count):
    """Half of a period from end to end, and somewhat less and more; a step turns by ``2 atan(h / 2)``.

    The pivots of ten thousand steps have rounding that hides an eigenvalue nearer to zero.
    """
    near = 1e-6 if count < 10_000 else 1e-5
    line, offs = Euclidean(1), np.array([-1e-2, -1e-4, -near, near, 1e-4, 1e-2])
    problem = OptimalControlProblem(line, lambda q, u: u, lambda q, u: (u @ u - q @ q) / 2, 1)
    horizons, rest = 2 * count * np.tan(np.pi / count / 2) * (1 + offs), np.zeros((len(offs), 1))
    found = Solver(problem, Midpoint(Addition(line)), count).solve_many(rest, rest, horizons)
    assert [own.strict_minimum for own in found.checks] == list(offs < 0)


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-12, 1e-9, -1e-6, 1e-3])
def test_focal_points_inside_a_trajectory_cost_no_digits(off):
    """A quarter of a period from the start, at a node, the problem up to there with a free end is singular."""
    h, rng, count = 2 * np.tan(np.pi / 12) * (1 + off), np.random.default_rng(0), 5
    system = oscillator(h, count, (rng.standard_normal((1, count, 2, 1)), rng.standard_normal((1, count + 1, 1, 1))))
    part = BlockSystem(*(a[:, :3] for a in system[:4]), system.gap[:, :4], np.ones((1, 1)), np.zeros((1, 1)))
    assert np.min(np.abs(np.linalg.eigvalsh(matrix(part, 0)))) < 1e-14 + 3 * abs(off)
    result = solve_blocks(arrays_of(system))
    assert result.negative == count + 1
    assert result.smallest > clear_pivot(count + 1)
    expected = np.linalg.solve(matrix(system, 0), dense(system, 0)[3])
    assert np.max(np.abs(flat(result) - expected)) < 1e-11 * np.max(np.abs(expected))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("field", BlockSystem._fields[:5])
def test_numbers_that_are_not_finite(field, bad):
    """In the matrix they leave no solution; in a right-hand side only that column has none."""
    for seed in range(20):
        rng, system = np.random.default_rng(seed), random_system(seed, (1, 4, 3, 5, 2))
        block = getattr(system, field)
        block[0, rng.integers(len(block[0])), rng.integers(block.shape[2]), 1] = bad
        if field == "hessian":
            block[:] = np.where(np.isfinite(block), block, bad) * np.where(np.isfinite(block.swapaxes(2, 3)), 1, np.nan)
        result = solve_blocks(arrays_of(system))
        assert result.finite.tolist() == ([True, False] if field in ("slope", "gap") else [False, False])
        assert np.isnan(result.smallest) == (field not in ("slope", "gap"))  # so that nothing calls it a minimum
        assert np.isnan(flat(result)[:, ~result.finite]).all()


def test_arrays_that_do_not_fit_are_refused():
    arrays = arrays_of(random_system(0, (1, 4, 3, 5, 2)))
    for name in BlockArrays._fields:
        block = getattr(arrays, name)
        if name == "left":  # whose shape says what the others must have
            with pytest.raises(InvalidInputError):
                solve_blocks(arrays._replace(left=block[:, :-1].copy()))
            continue
        wrongs = [block[:-1].copy(), block.astype(np.float32), np.broadcast_to(block[:1] * 0, block.shape)]
        for wrong in wrongs if name != "slope" else wrongs[:2]:
            with pytest.raises(InvalidInputError, match=rf"{name} of a linear system: got|not empty"):
                solve_blocks(arrays._replace(**{name: wrong}))
    with pytest.raises(InvalidInputError, match="not empty"):
        solve_blocks(arrays._replace(slope=arrays.slope[..., :0]))
