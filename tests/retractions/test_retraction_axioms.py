"""The axioms of a retraction, its order, its values and its inverse, for every retraction."""

import numpy as np
import pytest
from hypothesis import example, given
from retrax.retractions import SOQR, Addition

from tests.support.cases import FIRST_ORDER, INVERTED, METRICS, RETRACTIONS, reach
from tests.support.numerics import FRACTIONS, SEEDS, slope, unflat
from tests.support.retractions import LENGTHS, newton_inverse, retraction_facts

every_retraction = pytest.mark.parametrize("name", RETRACTIONS)

# Retractions of second order: their curves have no tangential acceleration at the start.
# One-parameter subgroups of rigid motions are screws, not geodesics.
NOT_GEODESIC = {*METRICS, "exponential-SE2"}
SECOND_ORDER = [name for name in RETRACTIONS if name.split("-")[0] not in FIRST_ORDER and name not in NOT_GEODESIC]


@every_retraction
@given(seed=SEEDS)
def test_zero_goes_to_the_base_point(name, seed):
    facts = retraction_facts(name, seed, 1.0)
    np.testing.assert_allclose(facts["at zero"], facts["x"], atol=1e-15)


@every_retraction
@given(seed=SEEDS)
def test_the_derivative_at_zero_is_the_identity_forwards_and_in_reverse(name, seed):
    facts = retraction_facts(name, seed, 0.0)
    np.testing.assert_allclose(facts["push"], facts["frame"], atol=1e-12)
    np.testing.assert_allclose(facts["frame"] @ facts["reverse"][1], facts["frame"] @ facts["c"], atol=1e-12)


@every_retraction
@given(seed=SEEDS)
def test_the_error_against_the_straight_line_is_of_second_order(name, seed):
    facts = retraction_facts(name, seed, 1.0)
    errors = np.linalg.norm(facts["short"] - facts["x"] - LENGTHS[:, None] * facts["v"], axis=1)
    if isinstance(RETRACTIONS[name], Addition):
        assert np.max(errors) < 1e-15
    else:
        assert abs(slope(LENGTHS, errors, floor=1e-13) - 2) < 0.1


@every_retraction
@given(seed=SEEDS, fraction=FRACTIONS)
def test_values_stay_on_the_manifold(name, seed, fraction):
    manifold = RETRACTIONS[name].manifold
    point = unflat(manifold)(retraction_facts(name, seed, fraction * reach(name))["value"])
    verdict = manifold.contains(point, 1e-13)
    assert verdict, verdict.reason


@every_retraction
@given(seed=SEEDS, fraction=FRACTIONS)
@example(seed=0, fraction=0.0)
@example(seed=0, fraction=1.0)
def test_inverse_finds_the_tangent_vector(name, seed, fraction):
    facts = retraction_facts(name, seed, fraction * reach(name))
    assert facts["inside"]
    np.testing.assert_allclose(facts["back"], facts["v"], atol=1e-12, rtol=1e-12)


@every_retraction
@given(seed=SEEDS, fraction=FRACTIONS)
def test_inverse_keeps_the_relative_accuracy_of_short_vectors(name, seed, fraction):
    # A point is known to 1e-16, hence a vector of length 1e-8 to a relative 1e-8.
    facts = retraction_facts(name, seed, 1e-8 * fraction)
    np.testing.assert_allclose(facts["back"], facts["v"], atol=2e-15 * max(1.0, np.max(np.abs(facts["x"]))) ** 2)


@every_retraction
@given(seed=SEEDS)
def test_the_retraction_inverts_its_inverse(name, seed):
    facts = retraction_facts(name, seed, 0.0)
    tangential = facts["to y"] @ facts["frame"].T @ facts["frame"]
    np.testing.assert_allclose(facts["there"], facts["y"], atol=1e-13)
    np.testing.assert_allclose(facts["to y"], tangential, atol=1e-12)
    assert np.linalg.norm(facts["to y"]) > 1e-3


@pytest.mark.parametrize("name", INVERTED)
@given(seed=SEEDS, fraction=FRACTIONS)
def test_newtons_method_finds_the_inverse_too(name, seed, fraction):
    v, found = newton_inverse(name, seed, fraction * min(1.0, reach(name)))
    np.testing.assert_allclose(found, v, atol=1e-13)


@pytest.mark.parametrize("name", SECOND_ORDER)
@given(seed=SEEDS)
def test_second_order_retractions_have_no_tangential_acceleration(name, seed):
    facts = retraction_facts(name, seed, 0.0, along="the fibre")
    np.testing.assert_allclose(facts["frame"] @ facts["forward forward"], 0, atol=1e-12)


@pytest.mark.parametrize("name", ["qr-SO2", "qr-SO3", "qr-SO4"])
@given(seed=SEEDS)
def test_the_qr_retraction_has_a_tangential_acceleration(name, seed):
    # I + t W = q r gives q'' = -2u with u + u' = -W^2, u upper triangular: the skew part of W^2 with its signs below turned.
    facts = retraction_facts(name, seed, 0.0, along="the fibre")
    n = RETRACTIONS[name].manifold.n
    x, w, acceleration = (facts[k].reshape(n, n) for k in ("x", "w", "forward forward"))
    square = x.T @ w @ x.T @ w
    expected = np.triu(square, 1) - np.tril(square, -1)
    tangential = x.T @ acceleration
    np.testing.assert_allclose((tangential - tangential.T) / 2, expected, atol=1e-12)
    assert isinstance(RETRACTIONS[name], SOQR)
    assert n == 2 or np.max(np.abs(expected)) > 1e-6
