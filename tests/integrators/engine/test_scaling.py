"""Natural units of a batch of linearised trajectories."""

from types import SimpleNamespace

import numpy as np
import pytest
from retrax.integrators.boundary_value.engine.elimination import BlockSystem
from retrax.integrators.boundary_value.engine.extent import Extent, ends_meet
from retrax.integrators.boundary_value.engine.scaling import natural_units
from retrax.integrators.problem.point_layout import PointLayout
from retrax.manifolds import Sphere
from retrax.manifolds.numerics.tolerances import EPS, HALF

from .systems import random_system

NODE, STEP = 3, 5


def drawn(seed: int, count: int = 6) -> tuple[BlockSystem, np.ndarray, np.ndarray, np.ndarray]:
    """Steps near the identity, with a gradient of the cost and sizes of states and controls."""
    rng, system = np.random.default_rng(seed), random_system(seed, (3, count, NODE, STEP, 1))
    system = system._replace(left=np.eye(NODE, STEP) + 0.2 * system.left, right=np.eye(NODE, STEP) + 0.2 * system.right)
    return system, rng.standard_normal((3, count, STEP)), rng.random((3, NODE)), rng.random((3, STEP - NODE))


@pytest.mark.parametrize("power", [-12, -3, 0, 2, 9])
def test_they_change_with_the_units_of_the_problem(power):
    system, gradient, states, controls = drawn(2)
    own = natural_units(system, gradient, states, controls)
    d = np.array([1.0, 10.0**power, 1.0, 1.0, 10.0 ** (power / 2)])
    node = d[:NODE, None]
    written = system._replace(
        hessian=system.hessian / np.outer(d, d),
        left=system.left / d * node,
        right=system.right / d * node,
        gap=system.gap * node,
    )
    units = natural_units(written, gradient / d, states * d[:NODE], controls * d[NODE:])
    np.testing.assert_allclose(units.unknowns, own.unknowns * d, rtol=1e-9)
    np.testing.assert_allclose(units.nodes, own.nodes * d[:NODE], rtol=1e-9)
    np.testing.assert_allclose(units.cost, own.cost, rtol=1e-9)


def test_members_do_not_know_of_each_other():
    system, *others = drawn(3)
    together = natural_units(system, *others)
    for m in range(3):
        alone = natural_units(BlockSystem(*(a[m : m + 1] for a in system)), *(a[m : m + 1] for a in others))
        assert all(np.array_equal(a[m], b[0]) for a, b in zip(together, alone, strict=True))


def test_what_a_coordinate_moves_does_not_know_of_other_members():
    layout = PointLayout.of(Sphere(2))
    support = np.array([[[1.0, 0, 0], [0, 1, 0]], [[0.8, 0.1, 0.6], [0.1, 0.9, 0.4]]])
    highest, lowest = np.array([[1e-12, 0, 1], [0.5, 0.6, 0.7]]), np.array([[0, 0, -1.0], [0.1, 0.1, 0.1]])
    none, one = np.zeros((2, 2)), np.zeros(2)
    both = Extent(highest, lowest, support, none, none, none, one, none, none, none)
    for m in range(2):
        alone = Extent(*(a[m : m + 1] for a in both))
        for together, own in zip(both.moved(layout), alone.moved(layout), strict=True):
            np.testing.assert_array_equal(together[m], own[0])


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("share", [0.0, 1e-3, 0.5, 0.99, 1.01, 2.0, 1e3])
def test_a_coordinate_moves_by_more_than_half_of_the_digits_of_its_column_or_not_at_all(share, size):
    support = np.array([[[0.8, 0.1, 0.6], [0.1, 0.9, 0.4]]])
    highest, spread = np.array([[0.2, 1.0, 0.7]]), share * EPS**HALF * np.array([[0.0, 1.0, 0.5]])
    none, one = np.zeros((1, 2)), np.zeros(1)
    found = Extent(size * highest, size * (spread - highest), support, none, none, none, one, none, none, none)
    moved, sizes = found.moved(PointLayout.of(Sphere(2)))
    # The first coordinate moves by three tenths of the spread, beside 0.8 of the column.
    expected = np.array([[0.3, 0.9]]) * share * EPS**HALF * size
    np.testing.assert_allclose(moved, np.where([[share > 0.8 / 0.3, share > 1]], expected, 0.0), rtol=1e-6)
    np.testing.assert_allclose(sizes, size * np.array([[0.8, 0.9]]))


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-7, 0.9e-3, 1.1e-3, 0.1, 1.0, 1e9])
def test_ends_that_are_apart_by_what_their_array_is_large_do_not_meet(apart):
    """Whatever gaps are measured by; what is rounding beside the other arrays may be as large as its own array."""
    values, in_arrays = np.array([[1.0, 0.5, 1e-9]]), np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    extent = SimpleNamespace(highest=values, lowest=-values)
    for distance, expected in (([apart, 0.0, 0.0], apart < 1e-3), ([0.0, 0.0, apart], apart < 1e-6)):
        assembled = SimpleNamespace(extent=extent, distance=np.array([distance]))
        assert ends_meet(assembled, in_arrays, 1e-11).tolist() == [expected]
