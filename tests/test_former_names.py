"""Former public names and fields work with a ``DeprecationWarning``."""

from operator import attrgetter

import numpy as np
import pytest
import retrax as rx
from retrax import integrators, retractions


@pytest.mark.parametrize("module", [integrators, retractions])
def test_former_names_are_the_present_objects(module):
    for former, present in module.FORMER.items():
        assert former not in dir(module)
        with pytest.warns(DeprecationWarning, match=rf"{former} is deprecated; use {present}") as caught:
            assert getattr(module, former) is attrgetter(present)(module)
        assert caught[0].filename == __file__


@pytest.mark.parametrize("module", [integrators, retractions])
def test_names_that_never_were_are_missing(module):
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing


def test_former_fields_are_the_present_fields():
    plane = rx.Euclidean(1)
    problem = rx.OptimalControlProblem(plane, lambda q, u: u, lambda q, u: u @ u / 2, 1)
    iterations = []
    found = rx.solve(
        problem, 0.0, 1.0, 1.0, method=rx.Midpoint(rx.retractions.Addition(plane)), steps=4, callback=iterations.append
    )
    for owner, former, present in (
        (found.checks, "gap", "defect"),
        (found.checks, "constraint", "manifold_violation"),
        (iterations[-1], "gap", "defect"),
    ):
        with pytest.warns(DeprecationWarning, match=f"{former} is deprecated; use {present}") as caught:
            assert np.array_equal(getattr(owner, former), getattr(owner, present))
        assert caught[0].filename == __file__
