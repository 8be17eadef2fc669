"""Numba compiles a kernel anew, for seconds, for arrays of another kind: no caller passes such ones."""

import jax.numpy as jnp
import numpy as np
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.boundary_value.engine import (
    acceptance_kernels,
    elimination_kernels,
    extent_kernels,
    inequality_kernels,
    pursuit_kernels,
    scaling_kernels,
)
from retrax.integrators.boundary_value.engine.pursuit_types import PURSUE
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint
from retrax.tape import machine

KERNELS = (
    elimination_kernels.solve,
    acceptance_kernels.judge,
    extent_kernels.meet,
    extent_kernels.survey,
    extent_kernels.measure,
    inequality_kernels.survey,
    inequality_kernels.raise_points,
    inequality_kernels.move,
    pursuit_kernels.pursue,
    machine.run,
    scaling_kernels.units,
)


def test_one_trajectory_and_many_with_limits_are_arrays_of_one_kind():
    plane = Euclidean(2)
    problem = OptimalControlProblem(
        plane, lambda q, u: jnp.array([q[1], u[0]]), lambda q, u: u @ u / 2, 1, control_bounds=(-5.0, 5.0)
    )
    solver = Solver(problem, Midpoint(Addition(plane)), 8)
    assert solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0).success
    assert solver.solve_many(np.zeros(2), np.array([[1.0, 0.0]] * 17), 1.0).success.all()
    # Members that begin once more, here two whose limits contradict their ends, are a part of a batch.
    several = solver.solve_many(np.zeros(2), np.array([1.0, 0.0]), np.array([0.1, 0.2, 1.0, 1.0]))
    assert list(several.success) == [False, False, True, True]
    for kernel in KERNELS:
        assert len(kernel.signatures) == 1, (kernel.__name__, kernel.signatures)
    assert list(pursuit_kernels.pursue.overloads) == [PURSUE.args]  # as another process compiles it
