"""Points and vectors as NumPy arrays, which have no ``at``: every public method of every manifold and retraction takes
them."""

import inspect
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pytest
from retrax.manifolds import Manifold

from tests.support.cases import MANIFOLDS, QUICK, RETRACTIONS

POINTS = ("x", "y", "x0", "x1", "z", "v", "a", "b", "p", "w", "xi", "u")
COORDINATES = ("c", "mu")
OTHERS = ("lift", "one_form", "two_form", "from_apex")  # whose arguments are of other kinds
VERDICTS = ("contains", "is_tangent", "inverse")  # they judge values, by methods that are here


def drawn(shapes: Any) -> Any:
    """NumPy arrays of these shapes; what is traced of a method does not depend on their values."""
    draw = np.random.default_rng(0).standard_normal
    return jax.tree.map(lambda s: draw(s.shape).astype(s.dtype), shapes)


def calls(subject: Any, manifold: Manifold) -> Iterator[tuple[str, list[Any]]]:
    """Public methods whose arguments are points, vectors and coordinates, with these."""
    for name, method in inspect.getmembers(type(subject), inspect.isfunction):
        if name in VERDICTS + OTHERS or name.startswith("_"):
            continue
        needed = [k for k, p in inspect.signature(method).parameters.items() if p.default is p.empty and k != "self"]
        if needed and all(k in POINTS + COORDINATES for k in needed):
            shape = jax.ShapeDtypeStruct((manifold.dimension,), float)
            yield name, [drawn(manifold.ambient if k in POINTS else shape) for k in needed]


@pytest.mark.parametrize(
    "name",
    [*MANIFOLDS, *(name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in RETRACTIONS)],
)
def test_public_methods_take_numpy_arrays(name):
    subject = {**MANIFOLDS, **RETRACTIONS}[name]
    manifold = subject if isinstance(subject, Manifold) else subject.manifold
    found = []
    for method, given in calls(subject, manifold):
        with np.errstate(all="ignore"):
            jax.eval_shape(lambda method=method, given=given: getattr(subject, method)(*given))
        found.append(method)
    wanted = (
        {"projection", "basis", "restore", "violations"} if subject is manifold else {"retract", "preimage", "domain"}
    )
    assert wanted <= set(found)
