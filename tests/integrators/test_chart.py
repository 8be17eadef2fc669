"""Polynomials of time in charts around the centres of steps: through points of a known curve they are that curve."""

import numpy as np
import pytest
import scipy.linalg
from numpy.polynomial import Polynomial
from retrax.compute.automatic import AutomaticEvaluator
from retrax.integrators.boundary_value.transcription.chart import Chart, lagrange
from retrax.manifolds import SE, SO, Euclidean, hat
from retrax.retractions import Addition, Cayley, Exponential, Gauss

AXIS = np.array([0.6, 0.0, 0.8])


def places_of(stages):
    return np.array(Gauss(stages, Addition(Euclidean(1))).nodes)


@pytest.mark.parametrize("stages", [2, 3, 4])
def test_polynomials_through_a_polynomial_have_its_slopes(stages):
    chart, places = Chart(Addition(Euclidean(2)), AutomaticEvaluator()), places_of(stages)
    curves = [Polynomial(np.random.default_rng(k).standard_normal(stages + 2)) for k in range(2)]
    begin, end, states = (np.stack([a(np.array(t)) for a in curves], axis=-1) for t in (0.0, 1.0, places))
    found = chart.polynomials(places, begin[None], states[None], end[None])
    np.testing.assert_allclose(found.centres, [(begin + end) / 2], rtol=1e-12)
    at = np.linspace(-0.2, 1.3, 7)
    slopes = np.stack([a.deriv()(at) for a in curves], axis=-1)
    np.testing.assert_allclose(found.slopes(at), slopes[None], rtol=1e-10, atol=1e-10)
    values = lagrange(found.places, at) @ found.coordinates + found.centres
    np.testing.assert_allclose(values[0], np.stack([a(at) for a in curves], axis=-1), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("sweep", [0.0, 1e-6, 0.1, 1.0, 2.0])
def test_slopes_of_turns_about_an_axis_are_those_of_the_angle(sweep):
    group, places, angle = SO(3), places_of(3), Polynomial([0.2, 1.0, 0.5, -0.4]) * sweep
    chart = Chart(Exponential(group), AutomaticEvaluator())

    def turn(t):
        return scipy.linalg.expm(np.asarray(hat(angle(t) * AXIS))).ravel()

    states = np.stack([turn(t) for t in places])
    found = chart.polynomials(places, turn(0.0)[None], states[None], turn(1.0)[None])
    middle = scipy.linalg.expm(np.asarray(hat((angle(0.0) + angle(1.0)) / 2 * AXIS))).ravel()
    np.testing.assert_allclose(found.centres[0], middle, atol=1e-12)
    at = np.array([0.0, 0.3, 1.0])
    sizes = np.linalg.norm(found.slopes(at)[0], axis=-1)
    unit = np.linalg.norm(np.asarray(hat(AXIS)))  # of a basis that is orthonormal in matrices
    np.testing.assert_allclose(sizes, np.abs(angle.deriv()(at)) * unit, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("family", [Cayley, Exponential])
def test_a_centre_is_as_far_from_both_ends_in_opposite_directions(family):
    group = SO(3)
    chart, draw = Chart(family(group), AutomaticEvaluator()), np.random.default_rng(0).standard_normal
    begins, ends = (
        np.stack([scipy.linalg.expm(np.asarray(hat(0.6 * draw(3)))).ravel() for _ in range(4)]) for _ in range(2)
    )
    centres = chart.centres(begins, begins, ends)
    before, after = (chart.coordinates(centres, points) for points in (begins, ends))
    np.testing.assert_allclose(before, -after, atol=1e-12)
    np.testing.assert_allclose(chart.points(centres, after), ends, atol=1e-12)


@pytest.mark.parametrize("group", [SO(2), SO(3), SE(2), SE(3)], ids=str)
@pytest.mark.parametrize("family", [Cayley, Exponential])
@pytest.mark.usual(2)
def test_the_functions_of_charts_of_groups_are_tapes(family, group):
    """A closed loop evaluates these functions at each sample, and XLA takes longer to call than a tape to run."""
    evaluator = AutomaticEvaluator()
    assert Chart(family(group), evaluator).functions
    assert evaluator.name == "tape", evaluator.reason
