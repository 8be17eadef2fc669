"""Derivatives of retractions in every mode of automatic differentiation, against each other and against differences."""

import numpy as np
import pytest
from hypothesis import example, given

from tests.support.cases import RETRACTIONS, reach
from tests.support.numerics import FRACTIONS, SEEDS, differences
from tests.support.retractions import STEP, newton_derivatives, retraction_facts


def everywhere(test):
    """For every retraction, at ``v = 0`` and at tangent vectors that are at most 1 long and well inside the domain."""
    drawn = given(seed=SEEDS, fraction=FRACTIONS)(example(seed=0, fraction=0.0)(example(seed=0, fraction=1.0)(test)))
    return pytest.mark.parametrize("name", RETRACTIONS)(drawn)


def facts_at(name: str, seed: int, fraction: float) -> dict:
    """Derivatives at a random point and tangent vector."""
    return retraction_facts(name, seed, fraction * min(1.0, reach(name)))


def pair(a: np.ndarray, b: np.ndarray) -> float:
    """Pairing of a covector with a vector of ``TM``, each in its two parts."""
    return sum(float(s @ t) for s, t in zip(a, b, strict=True))


@everywhere
def test_first_derivatives_are_those_of_differences(name, seed, fraction):
    facts = facts_at(name, seed, fraction)
    np.testing.assert_allclose(facts["forward"], differences(facts["values"], STEP), atol=1e-9)


@everywhere
def test_reverse_mode_is_the_transpose_of_forward_mode(name, seed, fraction):
    facts = facts_at(name, seed, fraction)
    np.testing.assert_allclose(pair(facts["reverse"], facts["d"]), facts["c"] @ facts["forward"], atol=1e-12)


@everywhere
def test_second_derivatives_agree_in_every_mode(name, seed, fraction):
    facts = facts_at(name, seed, fraction)
    curved = pair(facts["forward reverse"], facts["e"])
    np.testing.assert_allclose(facts["c"] @ facts["forward forward"], curved, atol=1e-11)
    np.testing.assert_allclose(np.stack(facts["reverse reverse"]), np.stack(facts["forward reverse"]), atol=1e-11)


@everywhere
def test_second_derivatives_are_those_of_differences_of_gradients(name, seed, fraction):
    facts = facts_at(name, seed, fraction)
    for exact, gradients in zip(facts["forward reverse"], facts["gradients"], strict=True):
        np.testing.assert_allclose(exact, differences(gradients, STEP), atol=1e-8)


@pytest.mark.parametrize("name", ["exponential-S2", "qr-SO3"])
@given(seed=SEEDS, fraction=FRACTIONS)
def test_newtons_inverse_is_differentiated_by_the_implicit_function_theorem(name, seed, fraction):
    facts = newton_derivatives(name, seed, 0.2 * fraction)
    by_differences = np.stack([differences(line, STEP) for line in facts["values"]])
    np.testing.assert_allclose(facts["forward"].T, by_differences, atol=1e-8)
    np.testing.assert_allclose(facts["reverse"], facts["c"] @ facts["forward"], atol=1e-12)
