"""How checks are listed, run, skipped and reported."""

import re
from itertools import islice
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import (
    SO,
    SPD,
    EmbeddedMetric,
    Euclidean,
    InvalidInputError,
    LevelSet,
    Manifold,
    Power,
    Simplex,
    Sphere,
    Stiefel,
    TangentBundle,
)
from retrax.retractions import CotangentLift, Exponential, Midpoint, Projection, Retraction
from retrax.testing import (
    ConformanceError,
    check_cotangent_lift,
    check_discretization_map,
    check_lie_group,
    check_manifold,
    check_metric,
    check_retraction,
    list_checks,
    parametrize_with_checks,
    strategies,
)
from retrax.testing.sites import special_points

from tests.support.numerics import norm

from .wrong_spaces import MutantManifold

SPHERE, EAST = Sphere(2), jnp.array([0.0, 0.6, 0.8])


@final
class Longer(Retraction):
    """``R(x, 1.01 v)`` of the projection."""

    manifold: Manifold

    def retract(self, x, v):
        return Projection(self.manifold)(x, 1.01 * v)


@parametrize_with_checks({"R": Projection(SPHERE)}, order=2, skip={"inverse_is_tangent": "to see a skip"})
@pytest.mark.usual(7)
def test_each_check_is_a_test(check):
    check()


def test_checks_have_names_and_facts():
    for subject in (
        SPHERE,
        EmbeddedMetric(SPHERE),
        Projection(SPHERE),
        Midpoint(Projection(SPHERE)),
        CotangentLift(Midpoint(Projection(SPHERE))),
    ):
        checks = list_checks(subject)
        assert len({check.name for check in checks}) == len(checks)
        assert all(check.fact for check in checks)
        assert str(checks[0]) == f"{checks[0].name}: {checks[0].fact}"


def test_there_are_no_checks_of_other_things():
    with pytest.raises(InvalidInputError, match=r"checks of manifolds, metrics, retractions, .* got 3"):
        list_checks(3)


def test_the_error_says_which_fact_fails_by_how_much_and_where():
    name = "derivative_at_zero_is_the_identity"
    words = r"\S+, expected at most 1.0e-12; D_v R\(x, 0\) is 1.010 times the identity"
    with pytest.raises(ConformanceError, match=rf"1 fails\n.*{name}: .* is {words}\n.*the fact: ") as caught:
        check_retraction(Longer(SPHERE), only=name, seeds=(3, 5))
    assert "Id" in str(caught.value)
    assert any(f"at {place}, x = [" in str(caught.value) for place in ("seed 3", "seed 5", "a special point"))
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
    assert "expected at most 1.0e-12" in lines[2]
    assert report.failures == ()


def test_an_error_on_the_way_is_a_fact_that_does_not_hold():
    @final
    class Broken(Retraction):
        manifold: Manifold

        def retract(self, x, v):
            raise ZeroDivisionError("no such thing")

    report = check_retraction(Broken(SPHERE), throw=False)
    assert re.search(r"ZeroDivisionError at test_running_checks.py:\d+: no such thing$", report.failures[0].words)
    assert str(report).count("no such thing") == 1
    assert "for the same error: derivative_at_zero_is_the_identity, " in str(report)


def test_what_jax_cannot_trace_is_said_once_with_what_to_try():
    @final
    class WithNumPy(Retraction):
        manifold: Manifold

        def retract(self, x, v):
            return x + v if np.linalg.norm(v) < 1 else x

    words = str(check_retraction(WithNumPy(SPHERE), throw=False))
    assert words.count("TracerArrayConversionError at test_running_checks.py:") == 1
    assert "try functions written in jax.numpy" in words


@final
class Pinched(Manifold):
    """The sphere with a projection that has no derivative at one point."""

    @property
    def dimension(self):
        return 2

    @property
    def ambient(self):
        return SPHERE.ambient

    def projection(self, x, a):
        return SPHERE.projection(x, a) + 0 * jnp.sqrt(jnp.sum((x - EAST) ** 2))

    def basis(self, x):
        return SPHERE.basis(x)

    def restore(self, x):
        return SPHERE.restore(x)

    def violations(self, x):
        return SPHERE.violations(x)

    def random_point(self, key):
        return SPHERE.random_point(key)


def test_facts_are_measured_at_the_points_of_the_user():
    name = "derivative_of_the_projection_is_that_of_differences"
    manifold = Pinched()
    assert not check_manifold(manifold, only=name).failures
    with pytest.raises(ConformanceError, match=rf"{name}: .* is nan, .*\n.*\n.*at points\[1\], x = \[0.  0.6 0.8\]"):
        check_manifold(manifold, only=name, points=[jnp.array([0.8, 0.6, 0.0]), EAST])
    with pytest.raises(
        InvalidInputError, match=r"points\[0\] is not a point: .*, got \(2,\); try a list of points of Sphere"
    ):
        check_retraction(Projection(SPHERE), points=[jnp.ones(2)])


class Volume(LevelSet):
    """Matrices of determinant one, by another way than the group."""

    def constraint(self, x):
        return jnp.linalg.det(x) - 1.0


class Nowhere(LevelSet):
    """No point at all."""

    def constraint(self, x):
        return x @ x + 1.0


class Doubled(LevelSet):
    """The sphere, by an equation without a gradient on it, and one more equation."""

    def constraint(self, x):
        return jnp.stack([x[0] - 0.5, (x @ x - 1.0) ** 2])


class Vase(LevelSet):
    """A surface of revolution with waists, so that Newton's method from afar goes here or there by rounding."""

    def constraint(self, x):
        return x[0] ** 2 + x[1] ** 2 - (1 + 0.3 * jnp.sin(2 * x[2])) ** 2


def test_where_rounding_decides_what_is_reached_no_inverse_is_wrong():
    assert not check_retraction(Projection(Vase(shape=(3,))), only="inverse_is_NaN_outside_the_image").failures


def test_a_level_set_without_points_is_reported_as_one():
    report = check_manifold(Nowhere(shape=(3,)), throw=False)
    words = (
        r"random_points_are_on_the_manifold: it could not be measured: InvalidInputError: no point of "
        r"Nowhere\(\(3,\)\) was found from 20 random starts; check its equations$"
    )
    assert re.search(words, str(report).splitlines()[1])
    assert "Callback" not in str(report)
    assert "for the same error: random_points_differ, " in str(report)


def test_the_square_of_an_equation_is_reported_before_what_follows_from_it():
    only = "restore_makes_errors_second_order"
    words = (
        r"rank lost by the constraint's Jacobian is 1 on Doubled\(\(3,\)\): the gradient of equation 1 is \S+ at "
        r"random points, and \S+ at a distance of 0.01 from them; expected .* instead of its square$"
    )
    report = check_manifold(Doubled(shape=(3,)), only=only, throw=False)
    assert len(report.failures) == 1
    assert re.search(words, str(report).splitlines()[1])
    assert check_manifold(Volume(shape=(2, 2)), only=only).reason == ""


@pytest.mark.slow
def test_zero_is_not_said_to_be_a_kink_where_an_equation_is_missing():
    volume, names = Volume(shape=(2, 2)), ["random_tangents_are_tangent", "restore_is_the_identity_on_the_manifold"]
    lacking, kink = "try adding the equation that excludes it", "try jnp.where"
    for power in (0, 1, 2):  # from the equation itself to one that holds at zero, too
        mutant = MutantManifold(
            volume, violations=lambda x, k=power: {"det": jnp.abs(jnp.linalg.det(x) ** k * volume.constraint(x))}
        )
        failures = check_manifold(mutant, only=names, throw=False).failures
        assert len(failures) == (2 if power else 0)
        assert all(lacking in outcome.words and "at a special point, x = [0. " in outcome.where for outcome in failures)
    (gone,) = check_manifold(
        MutantManifold(volume, violations=lambda x: {"none": 0 * jnp.abs(x[0, 0])}),
        only="equations_see_normal_displacements",
        throw=False,
    ).failures
    assert "every equation" in gone.words  # what random points say comes before what zero says
    assert gone.where.startswith("at seed")
    assert lacking not in gone.words

    sharp = MutantManifold(
        SPHERE, projection=lambda x, a: SPHERE.projection(x, a) + 0 * jnp.sqrt(x[1] ** 2 + x[2] ** 2)
    )
    words = (
        check_manifold(sharp, only="derivative_of_the_projection_is_that_of_differences", throw=False).failures[0].words
    )
    assert kink in words


@pytest.mark.parametrize(
    ("manifold", "points"),
    [
        (SO(3), [np.eye(3)]),
        (Euclidean(2), [np.zeros(2), np.array([1.0, 0.0])]),
        (Sphere(2), [np.eye(3)[0], np.eye(3)[2]]),
        (SPD(2), [np.eye(2)]),
        (SPD(3), [np.eye(3)]),
        (Euclidean(0), [np.zeros(0)]),
        (Stiefel(3, 2), [np.eye(3, 2)]),
        (Simplex(2), [np.full(3, 1 / 3)]),
        (SO(3) * Euclidean(2), [(np.eye(3), np.zeros(2)), (np.eye(3), np.array([1.0, 0.0]))]),
        (Power(Sphere(2), 2), [np.stack([np.eye(3)[0]] * 2), np.stack([np.eye(3)[2]] * 2)]),
        (TangentBundle(SO(2)), [(np.eye(2), np.zeros((2, 2)))]),
    ],
    ids=str,
)
def test_special_points_are_the_identity_zero_poles_and_barycentres(manifold, points):
    found = list(islice(special_points(manifold), 2))
    assert len(found) == len(points)
    for x, expected in zip(found, points, strict=True):
        assert all(np.allclose(a, b) for a, b in zip(jax.tree.leaves(x), jax.tree.leaves(expected), strict=True))


@pytest.mark.parametrize(
    "option", [{"only": "no_such_check"}, {"skip": {"no_such_check": "why"}}], ids=["only", "skip"]
)
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
        (check_metric, Sphere(2), "Metric"),
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

    def retract(self, x, v):
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
