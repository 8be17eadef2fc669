"""The block elimination of a KKT system against dense linear algebra."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from retrax.integrators.boundary_value.elimination import BlockSystem, eliminate, is_strict_minimum

from tests.support.numerics import SEEDS, compiled, norm

N, NODE, STAGE = 4, 3, 5
FREE_COORDINATES = st.integers(0, NODE)


def random_system(seed: int, free_start: int, free_end: int, convex: bool) -> BlockSystem:
    """A solvable system whose first and last node have this many free coordinates."""
    rng = np.random.default_rng(seed)
    hessian = rng.standard_normal((N, STAGE, STAGE))
    hessian = hessian @ hessian.transpose(0, 2, 1) + 0.1 * np.eye(STAGE) if convex else hessian + hessian.transpose(0, 2, 1)
    left, right = rng.standard_normal((2, N, NODE, STAGE))
    gap, start, end = rng.standard_normal((N + 1, NODE)), np.ones(NODE), np.ones(NODE)
    start[:free_start], end[:free_end] = 0.0, 0.0
    left[0, :free_start] = right[-1, :free_end] = gap[0, :free_start] = gap[-1, :free_end] = 0.0
    return BlockSystem(hessian, left, right, rng.standard_normal((N, STAGE)), gap, start, end)


def dense(system: BlockSystem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hessian, constraint matrix, and the diagonal of the free coordinates' equations ``-c = 0``."""
    hessian, constraints = np.zeros((N * STAGE, N * STAGE)), np.zeros(((N + 1) * NODE, N * STAGE))
    for k in range(N):
        stage = slice(k * STAGE, (k + 1) * STAGE)
        hessian[stage, stage] = system.hessian[k]
        constraints[k * NODE : (k + 1) * NODE, stage] += system.left[k]
        constraints[(k + 1) * NODE : (k + 2) * NODE, stage] -= system.right[k]
    free = np.zeros((N + 1, NODE))
    free[0], free[-1] = system.fixed_start - 1, system.fixed_end - 1
    return hessian, constraints, np.diag(free.ravel())


@cache
def kernel():
    def solve(system: BlockSystem) -> Any:
        solution = eliminate(system)
        return solution.steps, solution.multipliers, is_strict_minimum(solution)

    return compiled(solve)


@given(seed=SEEDS, free_start=FREE_COORDINATES, free_end=FREE_COORDINATES, convex=st.booleans())
def test_elimination_solves_the_kkt_system(seed, free_start, free_end, convex):
    system = random_system(seed, free_start, free_end, convex)
    steps, multipliers, _ = kernel()(system)
    hessian, constraints, free = dense(system)
    matrix = np.block([[hessian, constraints.T], [constraints, free]])
    expected = np.linalg.solve(matrix, -np.concatenate([system.slope.ravel(), system.gap.ravel()]))
    rounding = 1e-13 * np.linalg.cond(matrix) * (1 + norm(expected))
    assert norm(np.concatenate([steps.ravel(), multipliers.ravel()]) - expected) < rounding


@given(seed=SEEDS, free_start=FREE_COORDINATES, free_end=FREE_COORDINATES, tilt=st.floats(-3.0, 3.0))
def test_inertia_tells_whether_the_reduced_hessian_is_positive_definite(seed, free_start, free_end, tilt):
    """Both by the reduced Hessian itself and by the number of negative eigenvalues of the dense KKT matrix."""
    system = random_system(seed, free_start, free_end, convex=True)
    hessian, constraints, free = dense(system)
    fixed = constraints[np.diag(free) == 0]
    null = np.linalg.svd(fixed)[2][np.linalg.matrix_rank(fixed) :].T
    lowest = np.linalg.eigvalsh(null.T @ hessian @ null)[0]
    shift = (1 + tilt) * lowest  # the reduced Hessian's lowest eigenvalue becomes -tilt times what it was
    if abs(tilt) < 1e-3:
        return
    tilted = system._replace(hessian=system.hessian - shift * np.eye(STAGE))
    strict = bool(kernel()(tilted)[2])
    matrix = np.block([[hessian - shift * np.eye(N * STAGE), constraints.T], [constraints, free]])
    assert strict == (tilt < 0)
    assert strict == (np.sum(np.linalg.eigvalsh(matrix) < 0) == constraints.shape[0])


@pytest.mark.parametrize("seed", range(5))
def test_a_reduced_hessian_with_a_zero_eigenvalue_is_no_strict_minimum(seed):
    system = random_system(seed, 0, 0, convex=True)
    hessian, constraints, _ = dense(system)
    null = np.linalg.svd(constraints)[2][constraints.shape[0] :].T
    lowest = np.linalg.eigvalsh(null.T @ hessian @ null)[0]
    flat = system._replace(hessian=system.hessian - lowest * np.eye(STAGE))
    assert not kernel()(flat)[2]


def work(jaxpr: Any) -> int:
    """Number of array entries that a computation writes, loops unrolled."""
    total = 0
    for equation in jaxpr.eqns:
        inner = [p for p in equation.params.values() if isinstance(p, jax.extend.core.ClosedJaxpr)]
        length = equation.params.get("length", 1)
        total += length * sum(work(j.jaxpr) for j in inner)
        total += sum(int(np.prod(v.aval.shape)) for v in equation.outvars)
    return total


def test_the_work_grows_linearly_with_the_number_of_steps():
    small = random_system(0, 0, 0, convex=True)

    def size(steps: int) -> int:
        counts = [steps] * 4 + [steps + 1]
        arrays = [jnp.zeros((count, *leaf.shape[1:])) for count, leaf in zip(counts, small, strict=False)]
        return work(jax.make_jaxpr(eliminate)(BlockSystem(*arrays, *small[5:])).jaxpr)

    assert size(80) - size(40) == 2 * (size(40) - size(20))
