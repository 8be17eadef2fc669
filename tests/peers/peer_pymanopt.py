"""pymanopt's own test files, unmodified, on our classes.

The files come from pymanopt's source distribution, unpacked in the folder that PYMANOPT_SOURCE names. In each loaded
module the names of pymanopt's manifolds are bound to ``to_pymanopt(*from_pymanopt(...))``: the same constructor, our
code behind it.
"""

import importlib.util
import os
from pathlib import Path

import pymanopt.manifolds
from retrax.interop import from_pymanopt, to_pymanopt

TESTS = Path(os.environ["PYMANOPT_SOURCE"]) / "tests" / "manifolds"

# File, names rebound in it, test classes run.
FILES = {
    "sphere": (["Sphere"], ["TestSphereManifold"]),
    "euclidean": (["Euclidean"], ["TestEuclideanManifold"]),
    "group": (["SpecialOrthogonalGroup", "UnitaryGroup"], ["TestSpecialOrthogonalGroup", "TestUnitaryGroup"]),
    "fixed_rank": (["FixedRankEmbedded"], ["TestFixedRankEmbeddedManifold"]),
    "positive_definite": (
        ["SymmetricPositiveDefinite"],
        ["TestSingleSymmetricPositiveDefiniteManifold", "TestMultiSymmetricPositiveDefiniteManifold"],
    ),
    "stiefel": (["Stiefel"], ["TestSingleStiefelManifold", "TestMultiStiefelManifold"]),
    "grassmann": (["Grassmann"], ["TestSingleGrassmannManifold", "TestMultiGrassmannManifold"]),
    "oblique": (["Oblique"], ["TestObliqueManifold"]),
    "product": (["Euclidean", "Sphere", "Grassmann", "Product"], ["TestProductManifold"]),
}


def ours(name):
    """The constructor of a pymanopt manifold, with our manifold as its value."""
    return lambda *arguments, **options: to_pymanopt(
        *from_pymanopt(getattr(pymanopt.manifolds, name)(*arguments, **options))
    )


def loaded(file, rebound):
    """A test file as a module, with names bound to our constructors."""
    spec = importlib.util.spec_from_file_location(f"pymanopt_{file}", TESTS / f"test_{file}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name in rebound:
        setattr(module, name, ours(name))
    return module


for file, (rebound, classes) in FILES.items():
    module = loaded(file, rebound)
    globals().update({name: getattr(module, name) for name in classes})
