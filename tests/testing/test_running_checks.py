"""How checks are listed, run, skipped and reported."""

from typing import final

import jax
import jax.numpy as jnp
import pytest
from hypothesis import given
from retrax.manifolds import InvalidInputError, Manifold, Sphere
from retrax.retractions import CotangentLift, Exponential, Midpoint, Projection, Retraction
from retrax.testing import (
    ConformanceError,
    check_cotangent_lift,
    check_discretization_map,
    check_lie_group,
    check_manifold,
    check_retraction,
    list_checks,
    parametrize_with_checks,
    strategies,
)

from tests.support.numerics import norm

SPHERE = Sphere(2)


@final
class Longer(Retraction):
    """``R(x, 1.01 v)`` of the projection."""

    manifold: Manifold

    def __call__(self, x, v):
        return Projection(self.manifold)(x, 1.01 * v)


@parametrize_with_checks({"R": Projection(SPHERE)}, order=2, skip={"inverse_is_tangent": "to see a skip"})
def test_each_check_is_a_test(check):
    check()


def test_checks_have_names_and_facts():
    for subject in (SPHERE, Projection(SPHERE), Midpoint(Projection(SPHERE)), CotangentLift(Midpoint(Projection(SPHERE)))):
        checks = list_checks(subject)
        assert len({check.name for check in checks}) == len(checks)
        assert all(check.fact for check in checks)
        assert str(checks[0]) == f"{checks[0].name}: {checks[0].fact}"


def test_there_are_no_checks_of_other_things():
    with pytest.raises(InvalidInputError, match=r"checks of manifolds, retractions, .* got 3"):
        list_checks(3)


def test_the_error_says_which_fact_fails_by_how_much_and_where():
    name = "derivative_at_zero_is_the_identity"
    with pytest.raises(
        ConformanceError, match=rf"1 fails\n.*{name}: .* is 0\.0\d+, expected at most 1e-12\n.*the fact: "
    ) as caught:
        check_retraction(Longer(SPHERE), only=name, seeds=(3, 5))
    assert "Id" in str(caught.value)
    assert "at seed 3, x = [" in str(caught.value) or "at seed 5, x = [" in str(caught.value)
    assert [outcome.check.name for outcome in caught.value.report.failures] == [name]


def test_a_report_is_a_table_of_all_outcomes():
    report = check_manifold(
        SPHERE, only=["projection_is_symmetric", "random_points_differ"], skip={"random_points_differ": "one is enough"}
    )
    lines = str(report).splitlines()
    assert lines[0] == "Sphere(2): 1 holds, 1 skipped"
    assert "skipped" in lines[1]
    assert "random_points_differ: one is enough" in lines[1]
    assert "holds" in lines[2]
    assert "expected at most 1e-12" in lines[2]
    assert report.failures == ()


def test_an_error_on_the_way_is_a_fact_that_does_not_hold():
    @final
    class Broken(Retraction):
        manifold: Manifold

        def __call__(self, x, v):
            raise ZeroDivisionError("no such thing")

    report = check_retraction(Broken(SPHERE), only="zero_goes_to_the_base_point", throw=False)
    assert "ZeroDivisionError: no such thing" in report.failures[0].words


@pytest.mark.parametrize("option", [{"only": "no_such_check"}, {"skip": {"no_such_check": "why"}}], ids=["only", "skip"])
def test_an_unknown_name_is_refused(option):
    with pytest.raises(InvalidInputError, match="no check is named 'no_such_check'; the checks here are random_points"):
        check_manifold(SPHERE, **option)


def test_what_cannot_be_checked_is_refused():
    with pytest.raises(InvalidInputError, match="got order=3"):
        check_retraction(Projection(SPHERE), order=3)
    with pytest.raises(InvalidInputError, match="got no seed"):
        check_discretization_map(Midpoint(Projection(SPHERE)), seeds=())
    with pytest.raises(InvalidInputError, match="acts on a cotangent bundle, got one on Sphere"):
        check_cotangent_lift(Midpoint(Projection(SPHERE)))

    for reach in (0.0, float("inf"), float("nan")):
        with pytest.raises(InvalidInputError, match=f"reach is a length, positive and finite, got {reach}"):
            check_retraction(Projection(SPHERE), reach=reach)


@pytest.mark.parametrize(
    ("check", "subject", "kind"),
    [
        (check_retraction, Sphere(2), "Retraction"),
        (check_manifold, Exponential(Sphere(2)), "Manifold"),
        (check_lie_group, Sphere(2), "MatrixLieGroup"),
        (check_discretization_map, Sphere(2), "DiscretizationMap"),
        (check_cotangent_lift, Exponential(Sphere(2)), "DiscretizationMap"),
    ],
)
def test_the_checks_of_one_kind_refuse_another(check, subject, kind):
    with pytest.raises(InvalidInputError, match=rf"the checks of a {kind}, got .*Sphere.*; see list_checks"):
        check(subject)


def test_the_reach_asked_for_may_be_any_length():
    name = "domain_reaches_as_far_as_expected"
    assert not check_retraction(Projection(SPHERE), only=name, reach=100.0).failures
    assert not check_retraction(Exponential(SPHERE), only=name, reach=3.14).failures
    with pytest.raises(ConformanceError, match=rf"{name}: .* is 3.14, expected at least 3.15"):
        check_retraction(Exponential(SPHERE), only=name, reach=3.15)


def test_single_precision_is_refused():
    with jax.enable_x64(False), pytest.raises(InvalidInputError, match="double precision, got single"):
        check_manifold(SPHERE)


@given(x=strategies.points(SPHERE))
def test_drawn_points_are_points(x):
    assert SPHERE.contains(x, 1e-14)


@given(pair=strategies.tangent_vectors(SPHERE, longest=2.0), tiny=strategies.tiny_tangent_vectors(SPHERE))
def test_drawn_tangent_vectors_are_tangent_and_as_long_as_asked_for(pair, tiny):
    for (x, v), longest in ((pair, 2.0), (tiny, 1e-6)):
        assert SPHERE.is_tangent(x, v, 1e-14)
        assert jnp.linalg.norm(v) <= longest * (1 + 1e-12)


@given(pair=strategies.tangent_vectors_near_the_edge(Projection(SPHERE), longest=5.0))
def test_vectors_near_the_edge_are_in_the_domain(pair):
    x, v = pair
    assert Projection(SPHERE).domain(x, v)
    assert 4.4 < jnp.linalg.norm(v) < 5.0


@final
class Ring(Retraction):
    """The projection, said to be inverted for short and for long vectors, not between."""

    manifold: Manifold

    def __call__(self, x, v):
        return Projection(self.manifold)(x, v)

    def domain(self, x, v):
        return (v @ v < 1) | (v @ v > 4)


@given(pair=strategies.tangent_vectors_near_the_edge(Ring(SPHERE), longest=5.0))
def test_the_edge_of_a_domain_that_is_not_star_shaped_is_the_first(pair):
    x, v = pair
    assert Ring(SPHERE).domain(x, v)
    assert 0.89 < jnp.linalg.norm(v) < 1


@given(pair=strategies.covectors(SPHERE))
def test_drawn_covectors_are_tangent_representatives(pair):
    x, p = pair
    assert norm(x @ p) < 1e-14


def test_an_ambient_that_is_a_shape_is_refused_in_words():
    class Flat(Sphere):
        ambient = (3,)

    with pytest.raises(InvalidInputError, match="must consist of arrays without entries"):
        check_manifold(Flat(2))
