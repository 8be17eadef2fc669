"""The core's block elimination beside the engine's and dense linear algebra: solutions and inertia."""

import numpy as np
import pytest
from retrax.compute.binding.block_elimination import BlockArrays, solve_blocks
from retrax.compute.binding.library import best_instruction_set
from retrax.integrators.boundary_value.engine.elimination import BlockSystem, clear_pivot, eliminate
from retrax.integrators.boundary_value.engine.scaling import Units
from retrax.manifolds import InvalidInputError

from ..integrators.engine.systems import dense, matrix, random_system

SETS = range(best_instruction_set() + 1)
TILTS = 10.0 ** np.array([-15, -12, -9, -6, -3, 0])


def arrays_of(system, units=None, regularised=None):
    """The first system of a batch as the core has it."""
    n, z = system.left.shape[2:]
    scales = (np.ones(z), np.ones(n)) if units is None else (units.unknowns[0], units.nodes[0])
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
def test_solutions_and_inertia_are_those_of_the_engine_and_of_the_dense_matrix(own):
    rng = np.random.default_rng(own)
    for _ in range(150):
        system = drawn(rng)
        result, engine = solve_blocks(arrays_of(system), instruction_set=own), eliminate(system)
        kkt = matrix(system, 0)
        eigenvalues = np.linalg.eigvalsh(kkt)
        size = np.abs(eigenvalues)
        if size.min() < 1e-10 * size.max():  # rounding decides the signs
            continue
        assert result.negative == engine.negative[0] == np.sum(eigenvalues < 0)
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
def test_units_and_regularisation_are_those_of_the_engine(own):
    """Written in units of its own, a system has the solution that it has without units."""
    rng = np.random.default_rng(20 + own)
    for _ in range(40):
        plain = random_system(int(rng.integers(1 << 30)), (1, 5, 3, 5, 2), (1, 2), convex=True)
        units = Units(10 ** rng.uniform(-4, 4, (1, 5)), 10 ** rng.uniform(-4, 4, (1, 3)), 10 ** rng.uniform(-4, 4, 1))
        d, g, cost = units.unknowns[0], units.nodes[0], float(units.cost[0])
        system = plain._replace(
            hessian=plain.hessian / np.outer(d, d) * cost,
            left=plain.left / d * g[:, None],
            right=plain.right / d * g[:, None],
            slope=plain.slope / d[:, None] * cost,
            gap=plain.gap * g[:, None],
        )
        scales, shift = rng.random(5), float(rng.random())
        result = solve_blocks(arrays_of(system, units, scales), cost, shift, instruction_set=own)
        engine = eliminate(plain, shift=np.array([shift]), scales=scales[None])
        assert result.negative == engine.negative[0]
        for ours, theirs in (
            (result.step / d[:, None], engine.steps[0]),
            (result.multipliers * g[:, None] / cost, engine.multipliers[0]),
            (result.largest_step / d, engine.largest[0]),
            (result.size, engine.size[0]),
            (result.curvature, engine.curvature[0]),
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
        engine = eliminate(system, shift=np.array([shift]))
        count = rows.shape[0]
        clear = result.smallest > clear_pivot(count)
        if clear or abs(tilt) >= 1e-9:
            assert (result.negative == count) == (tilt > 0)
        if abs(tilt) >= 1e-9:
            assert result.negative == engine.negative[0]
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
