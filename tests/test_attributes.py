"""A subclass has an abstract attribute as a class attribute, a field or a property; without it there is no object."""

import jax
import numpy as np
import pytest
from retrax.manifolds import Manifold, MatrixLieGroup, Metric
from retrax.retractions import DiscretizationMap, Retraction

from .support.attributes import MADE, NILPOTENT, PLANE, SPHERE, Plane, PlaneByFields, Step, WithoutManifold

VALUES = {
    "dimension": 2, "ambient": PLANE, "algebra": NILPOTENT, "manifold": SPHERE, "theta": 0.5, "control_times": 0.5,
}  # fmt: skip


@pytest.mark.parametrize("thing", MADE, ids=lambda thing: type(thing).__name__)
def test_an_attribute_is_what_the_subclass_says(thing):
    names = {
        "PlaneB": ["dimension", "ambient"],
        "LineBy": ["algebra"],
        "StepBy": ["manifold"],
        "EndsBy": ["theta", "manifold"],
    }
    for name in names.get(type(thing).__name__[:6], ["manifold"]):
        assert (
            np.array_equal(getattr(thing, name), VALUES[name])
            if name == "algebra"
            else getattr(thing, name) == VALUES[name]
        )
    assert jax.tree.structure(thing) == jax.tree.structure(jax.tree.map(lambda a: a, thing))


def test_an_object_without_its_attributes_is_not_made():
    for kind, words in ((Plane, "ambient, dimension"), (Step, "manifold"), (WithoutManifold, "manifold")):
        with pytest.raises(TypeError, match=f"Can't instantiate abstract class {kind.__name__} with") as caught:
            kind()
        assert str(caught.value).replace("'", "").endswith(words)  # Python 3.12 and later quote each of them
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'ambient'"):
        PlaneByFields(2)


def test_what_an_attribute_is_can_be_read_in_its_class():
    for kind, name in (
        (Manifold, "dimension"),
        (MatrixLieGroup, "algebra"),
        (Retraction, "manifold"),
        (Metric, "manifold"),
    ):
        assert getattr(kind, name).__doc__
    assert "0 at its start" in DiscretizationMap.theta.__doc__
