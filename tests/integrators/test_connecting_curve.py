"""Curves of first guesses: one that a retraction makes is taken where its steps are about as long as each other."""

import numpy as np
import pytest
from retrax.integrators.boundary_value.inputs.connecting_curve import CURVE_PIECES, UNEVEN, ConnectingCurve
from retrax.manifolds import SO, Euclidean, Product, Sphere
from retrax.retractions import Cayley, Projection, default_retraction


@pytest.mark.parametrize("share", [0.5, 0.9, 1.1, 3.0])
def test_a_curve_is_even_up_to_a_step_of_twice_the_mean_one_wherever_that_is(share):
    """Once in each direction: what is even there is even on the way back; a wrong curve in one array of two is
    wrong."""
    space = Product(Euclidean(2), Euclidean(1))
    start, direction = ConnectingCurve(space, default_retraction(space)), np.array([0.6, 0.8])
    for place in range(CURVE_PIECES):
        steps = np.ones(CURVE_PIECES)
        # A longest one of ``UNEVEN share`` mean ones: the others are one.
        steps[place] = (CURVE_PIECES - 1) / (CURVE_PIECES / (UNEVEN * share) - 1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        whole, straight = along[:, None] * direction, np.linspace(0.0, 1.0, CURVE_PIECES + 1)[:, None]
        both = np.stack([np.concatenate([whole, straight], 1), np.concatenate([whole, straight], 1)[::-1]])
        assert start._even(both).tolist() == [share <= 1] * 2


@pytest.mark.parametrize("angle", [0.5, 3.0, np.pi])
def test_a_turn_up_to_half_a_turn_is_guessed_whichever_way_arrives(angle):
    """The logarithm as far as there is one, and a walk beyond."""
    group = SO(3)
    start, fractions = ConnectingCurve(group, Cayley(group)), np.array([0.25, 0.5, 0.75])
    end = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    found = start.states(np.eye(3).reshape(1, 9), end.reshape(1, 9), fractions).reshape(3, 3, 3)
    np.testing.assert_allclose(found @ found.mT, [np.eye(3)] * 3, atol=1e-10)
    angles = np.arccos((np.trace(found, axis1=1, axis2=2) - 1) / 2)
    np.testing.assert_allclose(angles, fractions * angle, rtol=0.1)


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-9, 0.0])
def test_points_of_a_sphere_that_are_opposite_or_nearly_so_are_led_to_by_a_walk(gap):
    sphere = Sphere(2)
    start, fractions = ConnectingCurve(sphere, Projection(sphere)), np.array([0.2, 0.5, 0.9])
    begin, end = np.array([[0.0, 0.0, 1.0]]), np.array([[np.sin(gap), 0.0, -np.cos(gap)]])
    (found,) = start.states(begin, end, fractions)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.arccos(found[:, 2]), fractions * (np.pi - gap), rtol=0.3)  # the walk is uneven
