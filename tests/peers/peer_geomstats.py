"""geomstats' own test cases, unmodified, on our classes.

They ship in geomstats' wheel as classes that want a ``space`` and data. Every test of them that draws its data is
activated here: once (``trials = 1``), and it fails where something is not implemented. The spaces are geomstats' own
through both doors, ``to_geomstats(*from_geomstats(...))``; in the comparisons the original stands beside ours.
"""

import inspect

from geomstats.geometry.euclidean import Euclidean
from geomstats.geometry.grassmannian import Grassmannian
from geomstats.geometry.hyperboloid import Hyperboloid
from geomstats.geometry.hypersphere import Hypersphere
from geomstats.geometry.nfold_manifold import NFoldManifold
from geomstats.geometry.product_manifold import ProductManifold
from geomstats.geometry.spd_matrices import SPDMatrices
from geomstats.geometry.special_euclidean import SpecialEuclidean
from geomstats.geometry.special_orthogonal import SpecialOrthogonal
from geomstats.geometry.stiefel import Stiefel
from geomstats.test.data import TestData
from geomstats.test.parametrizers import DataBasedParametrizer
from geomstats.test.random import RandomDataGenerator
from geomstats.test_cases.geometry.euclidean import EuclideanTestCase
from geomstats.test_cases.geometry.hypersphere import HypersphereExtrinsicTestCase
from geomstats.test_cases.geometry.manifold import ManifoldTestCase
from geomstats.test_cases.geometry.mixins import ProjectionTestCaseMixins
from geomstats.test_cases.geometry.nfold_manifold import NFoldManifoldTestCase
from geomstats.test_cases.geometry.product_manifold import ProductManifoldTestCase
from geomstats.test_cases.geometry.riemannian_metric import RiemannianMetricComparisonTestCase
from geomstats.test_cases.geometry.spd_matrices import SPDMatricesTestCase
from geomstats.test_cases.geometry.special_orthogonal import SpecialOrthogonalMatricesTestCase
from geomstats.test_cases.geometry.stiefel import StiefelCanonicalMetricTestCase, StiefelTestCase
from retrax.interop import from_geomstats, to_geomstats


class Space(ProjectionTestCaseMixins, ManifoldTestCase):
    """The test cases of a space with a projection, for spaces that have no file of their own."""


# A space of geomstats, and the class of its own test file.
SPACES = {
    "Euclidean": (Euclidean(3), EuclideanTestCase),
    "Hypersphere": (Hypersphere(3), HypersphereExtrinsicTestCase),
    "SpecialOrthogonal": (SpecialOrthogonal(3), SpecialOrthogonalMatricesTestCase),
    "SpecialEuclidean": (SpecialEuclidean(2), Space),
    "Stiefel": (Stiefel(4, 2), StiefelTestCase),
    "Grassmannian": (Grassmannian(4, 2), Space),
    "SPDMatrices": (SPDMatrices(3), SPDMatricesTestCase),
    "Hyperboloid": (Hyperboloid(2), Space),
    "Product": (ProductManifold([Hypersphere(2), Euclidean(2)]), ProductManifoldTestCase),
    "NFold": (NFoldManifold(SpecialOrthogonal(3), 2), NFoldManifoldTestCase),
}
# What a test draws, by the names of its arguments; those that want other values are called by these.
DRAWN = {
    ("n_points",): TestData.generate_random_data,
    ("n_reps",): TestData.generate_vec_data,
    ("n_points", "n_times"): TestData.generate_random_data_with_time,
    ("n_reps", "n_times"): TestData.generate_vec_data_with_time,
}


# The cases of a metric; those of the Stiefel metric test a retraction and its inverse too.
METRICS = {"Metric": StiefelCanonicalMetricTestCase, "Comparison": RiemannianMetricComparisonTestCase}


class NearbyData(RandomDataGenerator):
    """Random data; the points to project are near the manifold, where ``projection`` is defined.

    With a ``radius`` the points lie in a geodesic ball, for a logarithm that is not defined between any two points.
    """

    def __init__(self, space, radius=None):
        super().__init__(space)
        self.radius, self.centre = radius, space.random_point()

    def random_point(self, n_points=1):
        """Random points, in the ball if there is one."""
        point = self.space.random_point(n_points)
        if self.radius is None:
            return point
        direction = self.space.to_tangent(point, self.centre)
        return self.space.metric.exp(self.radius * self.space.metric.normalize(direction, self.centre), self.centre)

    def point_to_project(self, n_points=1):
        """A random point, a tenth of a random tangent vector away."""
        point = self.random_point(n_points)
        return point + 0.1 * self.space.random_tangent_vec(point)


def drawn_data(case):
    """Test data for every test of a case that draws its own."""
    methods = {"trials": 1, "fail_for_not_implemented_errors": True}
    for name, function in inspect.getmembers(case, inspect.isfunction):
        arguments = tuple(a for a in inspect.getfullargspec(function).args if a not in ("self", "atol"))
        if name.startswith("test_") and arguments in DRAWN:
            methods[f"{name[5:]}_test_data"] = DRAWN[arguments]
    return type("DrawnData", (TestData,), methods)()


def of(name, suffix, case):
    """A test class of geomstats for one of our spaces."""
    theirs = SPACES[name][0]
    manifold, retraction, metric, conventions = from_geomstats(theirs)
    radius = 0.5 if name == "Stiefel" and suffix else None
    ours = to_geomstats(manifold, retraction, metric, conventions)
    body = {
        "space": ours,
        "other_space": theirs,
        "data_generator": NearbyData(ours, radius),
        "testing_data": drawn_data(case),
    }
    return DataBasedParametrizer(f"Test{name}{suffix}", (case,), body)


for name, (_, own) in SPACES.items():
    for suffix, case in {"": own, **METRICS}.items():
        globals()[f"Test{name}{suffix}"] = of(name, suffix, case)
