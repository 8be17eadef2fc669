"""The suite of checks for each kind of object: to list them, and to run them from pytest one by one."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from ..manifolds import CotangentBundle, InvalidInputError, Manifold, MatrixLieGroup, Metric
from ..retractions import DiscretizationMap, Retraction
from . import checks as kit
from .properties import Facts, refuse_unknown
from .report import Check, ConformanceError, judge


class Suite(NamedTuple):
    """The measured facts of one kind of object, and the checks that read them."""

    facts: Callable[..., Facts]
    checks: tuple[Check, ...]


def suite_for(subject: Any) -> Suite:
    """The suite for a manifold, a metric, a retraction, a discretization map or a cotangent lift."""
    if isinstance(subject, DiscretizationMap):
        if isinstance(subject.manifold, CotangentBundle):
            return Suite(kit.CotangentLiftFacts, kit.COTANGENT_LIFT_CHECKS)
        return Suite(kit.DiscretizationFacts, kit.DISCRETIZATION_CHECKS)
    if isinstance(subject, Retraction):
        return Suite(kit.RetractionFacts, kit.RETRACTION_CHECKS)
    if isinstance(subject, Metric):
        return Suite(kit.MetricFacts, kit.METRIC_CHECKS)
    if isinstance(subject, MatrixLieGroup):
        return Suite(kit.LieGroupFacts, kit.LIE_GROUP_CHECKS)
    if isinstance(subject, Manifold):
        return Suite(kit.ManifoldFacts, kit.MANIFOLD_CHECKS)
    raise InvalidInputError(
        f"there are checks of manifolds, metrics, retractions, discretization maps and cotangent lifts, got {subject!r}"
    )


def list_checks(subject: Any) -> tuple[Check, ...]:
    """The checks for an object in the order in which they run, each with a ``name`` and a ``fact``.

    Parameters
    ----------
    subject : Manifold, Metric, Retraction or DiscretizationMap
        The object.

    Returns
    -------
    tuple of Check
        The checks.
    """
    return suite_for(subject).checks


def parametrize_with_checks(subjects: dict[str, Any], skip: dict[str, str] | None = None, **options: Any) -> Any:
    """A pytest decorator: one test for each check of each named object, as the argument ``check``.

    Parameters
    ----------
    subjects : dict of str to object
        The objects by name.
    skip : dict of str to str, optional
        Names of checks to skip, with reasons.
    **options
        Options of ``check_manifold``, ``check_retraction`` and the others.

    Returns
    -------
    decorator
        The decorator; ``check()`` raises ``ConformanceError`` if the fact does not hold.

    Notes
    -----
    The checks of one object share their measurements::

        @parametrize_with_checks({"mine": MyRetraction(MyManifold())}, order=2)
        def test_conforms(check):
            check()
    """
    import pytest

    def run(facts: Callable[[], Facts], check: Check) -> Callable[[], None]:
        def call() -> None:
            if check.name in (skip or {}):
                pytest.skip((skip or {})[check.name])
            outcome = judge(check, facts())
            if outcome.status in ("not applicable", "not decided"):
                pytest.skip(outcome.words)
            if outcome.status == "fails":
                raise ConformanceError(facts().report(outcome))

        return call

    items = []
    for name, subject in subjects.items():
        suite = suite_for(subject)
        refuse_unknown(skip or {}, suite.checks)
        facts = cache(lambda suite=suite, subject=subject: suite.facts(subject, **options))
        items += [pytest.param(run(facts, check), id=f"{name}-{check.name}") for check in suite.checks]
    return pytest.mark.parametrize("check", items)
