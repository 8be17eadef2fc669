"""Curves of first guesses: one that a retraction makes is taken where its steps are about as long as each other."""

import numpy as np
import pytest
from retrax.integrators.boundary_value.engine.start import PIECES, UNEVEN, Start
from retrax.manifolds import Euclidean, Product
from retrax.retractions import default_retraction


@pytest.mark.parametrize("share", [0.5, 0.9, 1.1, 3.0])
def test_a_curve_is_even_up_to_a_step_of_twice_the_mean_one_wherever_that_is(share):
    """Once in each direction: what is even there is even on the way back; a wrong curve in one array of two is
    wrong."""
    space = Product(Euclidean(2), Euclidean(1))
    start, direction = Start(space, default_retraction(space)), np.array([0.6, 0.8])
    for place in range(PIECES):
        steps = np.ones(PIECES)
        # A longest one of ``UNEVEN share`` mean ones: the others are one.
        steps[place] = (PIECES - 1) / (PIECES / (UNEVEN * share) - 1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        whole, straight = along[:, None] * direction, np.linspace(0.0, 1.0, PIECES + 1)[:, None]
        both = np.stack([np.concatenate([whole, straight], 1), np.concatenate([whole, straight], 1)[::-1]])
        assert start._even(both).tolist() == [share <= 1] * 2
