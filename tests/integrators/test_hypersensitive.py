"""A short arc at each end of a long rest, on meshes that are far too coarse for the arcs."""

import pytest
from retrax import problems
from retrax.integrators import Solver

FIRST_ORDER = 1e-8  # relative error of the cost that the accuracy of the entry allows


@pytest.fixture(scope="module")
def entry():
    return problems.get("hypersensitive")


@pytest.mark.parametrize("steps", [18, 20, 22, 24])
def test_trajectories_in_pieces_are_joined(entry, steps):
    """From the straight guess steps of 500 s lead 300 times as far as the states are apart."""
    solver = Solver(entry.problem, entry.discretization, steps)
    for horizon in (9e3, 1e4, 1.1e4):
        solution = solver.solve(entry.start, entry.end, horizon)
        assert solution.statistics.iterations <= 50
        assert solution.cost < 1.1 * entry.optimum  # coarse steps miss a part of the arcs; extremals astray cost 1000


def test_a_refined_mesh_finds_the_optimum(entry):
    solution = entry.solve()
    assert solution.cost == pytest.approx(entry.optimum, rel=FIRST_ORDER)
    assert solution.statistics.iterations <= 120
