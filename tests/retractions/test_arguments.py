"""What retractions are made of and given: anything else is refused in words."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.manifolds import (
    SO,
    SPD,
    ComplexStiefel,
    EmbeddedMetric,
    FixedRank,
    Hyperbolic,
    InvalidInputError,
    LeftInvariantMetric,
    Sphere,
    Stiefel,
)
from retrax.retractions import (
    QR,
    Addition,
    Cayley,
    DifferentiatedRetraction,
    Exponential,
    GroupCayley,
    Orthographic,
    Polar,
    RestoredAfter,
    Retraction,
    SecondOrder,
    StiefelCanonicalExponential,
    StiefelPolar,
    Translated,
    differential_adjoint,
    differentiated,
    measured_order,
)
from scipy.spatial.transform import Rotation

SPHERE, ROTATIONS = Exponential(Sphere(2)), Exponential(SO(3))
POINTS = np.eye(3)
ZEROS = np.zeros((3, 3))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: SPHERE(POINTS, ZEROS), r"a point of Sphere\(2\) has shape \(3,\), got \(3, 3\).*jax.vmap"),
        (lambda: SPHERE(POINTS[0], np.zeros(1)), r"a tangent vector of Sphere\(2\) has shape \(3,\), got \(1,\)"),
        (lambda: SPHERE(POINTS[0], 0.0), r"a tangent vector of Sphere\(2\) has shape \(3,\), got float"),
        (lambda: SPHERE.inverse(POINTS, POINTS), r"a base point of Sphere\(2\) has shape \(3,\), got \(3, 3\)"),
        (lambda: jax.jit(lambda v: SPHERE(POINTS[0], v))(ZEROS), r"a tangent vector of .* got \(3, 3\)"),
        (lambda: SPHERE([1.0, 0.0, 0.0], POINTS[1]), r"float\]; a list or a tuple is no array, try jax.numpy.array"),
        (lambda: differentiated(SPHERE, POINTS[0], ZEROS[0], ZEROS), r"a direction of Sphere\(2\) .* got \(3, 3\)"),
        (lambda: differential_adjoint(ROTATIONS, POINTS, ZEROS, ZEROS[0]), r"a covector of SO\(3\) .*, got \(3,\)"),
        (
            lambda: ROTATIONS(Rotation.identity(), ZEROS),
            r"a point of SO\(3\) .*, got Rotation; try its as_matrix\(\)",
        ),
    ],
)
def test_one_point_and_one_vector_of_the_shapes_of_the_manifold(call, words):
    with pytest.raises(InvalidInputError, match=words):
        call()


def test_arguments_by_their_names_are_checked_too():
    assert np.array_equal(SPHERE(v=ZEROS[0], x=POINTS[0]), POINTS[0])
    with pytest.raises(InvalidInputError, match=r"a tangent vector of Sphere\(2\) has shape \(3,\), got \(3, 3\)"):
        SPHERE(v=ZEROS, x=POINTS[0])


def test_a_retraction_of_ones_own_is_given_the_shapes_of_its_manifold():
    @final
    class Rescaling(Retraction):
        manifold: Sphere

        def retract(self, x, v):
            return (x + v) / jnp.linalg.norm(x + v)

    rescaling = Rescaling(Sphere(2))
    assert np.allclose(rescaling(POINTS[0], POINTS[1]), [0.5**0.5, 0.5**0.5, 0.0])
    with pytest.raises(InvalidInputError, match=r"a point of Sphere\(2\) has shape \(3,\), got \(3, 3\).*jax.vmap"):
        rescaling(POINTS, ZEROS)


@pytest.mark.parametrize("inherited", [Retraction, DifferentiatedRetraction])
def test_a_class_that_would_leave_out_the_check_of_shapes_is_told_what_to_write(inherited):
    words = r"Unchecked defines __call__, expected retract\(self, x, v\), which .* try the other name"
    with pytest.raises(InvalidInputError, match=words):

        class Unchecked(inherited):
            manifold: Sphere

            def __call__(self, x, v):
                return x + v


def test_batches_by_vmap():
    reached = jax.vmap(SPHERE)(POINTS, jnp.roll(POINTS, 1, axis=0) * np.pi / 2)
    assert np.allclose(reached, np.roll(POINTS, 1, axis=0), atol=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: StiefelPolar(SPD(3)), r"StiefelPolar takes a Stiefel, got SPD"),
        (
            lambda: StiefelCanonicalExponential(ComplexStiefel(3, 2)),
            r"takes real frames, got ComplexStiefel",
        ),
        (lambda: Addition(Sphere(2)), r"Addition takes a Euclidean, got Sphere"),
        (lambda: GroupCayley(Sphere(2)), r"GroupCayley takes a MatrixLieGroup, got Sphere"),
        (lambda: Orthographic(FixedRank(3, 2, 1), 3), r"Orthographic takes a Submanifold, got FixedRank"),
        (lambda: RestoredAfter(SO(3)), r"RestoredAfter takes a Retraction, got SO"),
        (lambda: SecondOrder(QR(SO(3)), EmbeddedMetric(SO(4))), r"expected a metric of SO\(3\), got .*SO\(n=4\)"),
        (
            lambda: measured_order(Cayley(SO(3)), EmbeddedMetric(SO(4))),
            r"expected a metric of SO\(3\), got .*SO\(n=4\)",
        ),
        (lambda: Translated(SO(3), lambda a: jnp.eye(3) + a), r"its values in the group, it misses it by 0.0"),
    ],
)
def test_made_of_what_the_annotations_say(make, words):
    with pytest.raises(InvalidInputError, match=words):
        make()


@pytest.mark.parametrize("distance", [1.0, 8.0, 9.0, 10.0])
def test_the_logarithm_of_the_hyperboloid_from_far_out_is_no_error(distance):
    """From far out the base point has rounding errors of relative size ``exp(2 d) eps``: 5e-8 at d = 10."""
    exponential, base = Exponential(Hyperbolic(2)), np.eye(3)[0]
    far = exponential(base, distance * np.array([0.0, 0.6, 0.8]))
    v = exponential.inverse(far, base)
    size = np.sqrt(v[1] ** 2 + v[2] ** 2 - v[0] ** 2)
    assert float(size) == pytest.approx(distance, abs=1e-13 * np.exp(2 * distance))


@pytest.mark.slow
def test_the_canonical_logarithm_of_square_frames_is_that_of_rotations():
    frames = Stiefel(3, 3)
    exponential, x = StiefelCanonicalExponential(frames), frames.random_point(jax.random.key(0))
    v = x @ np.cross(np.eye(3), np.array([0.3, -0.5, 0.4]))
    assert np.allclose(exponential.inverse(x, exponential(x, v)), v, atol=1e-14)


def test_the_domain_of_the_exponential_of_definite_matrices_ends_where_it_overflows():
    exponential = Exponential(SPD(2))
    assert exponential.domain(np.eye(2), 700 * np.eye(2))
    assert not exponential.domain(np.eye(2), 800 * np.eye(2))


@pytest.mark.parametrize("inertia", [[1.0, 2.0, 3.0], [1.0, 1.0, 2.0]])
@pytest.mark.usual(1)
def test_methods_of_what_holds_arrays_can_be_compiled(inertia):
    """Two metrics of one shape in turn: a program compiled for the first is not used for the second."""
    x, v = jnp.eye(3), SO(3).hat(jnp.array([0.1, -0.2, 0.3]))
    metric = LeftInvariantMetric(SO(3), jnp.array(inertia))
    found = jax.jit(metric.inner_product)(x, v, v)
    assert found == pytest.approx(float(jnp.array(inertia) @ jnp.array([0.01, 0.04, 0.09])))
    assert hash(metric) == hash(LeftInvariantMetric(SO(3), jnp.array(inertia)))
    retraction = SecondOrder(Cayley(SO(3)), metric)
    np.testing.assert_allclose(jax.jit(retraction.retract)(x, v), retraction(x, v), atol=1e-14)


def test_shapes_of_methods_of_what_holds_arrays_are_known_under_jit():
    """Twice: the second time, JAX compares the method with the one it knows."""
    metric, x = LeftInvariantMetric(SO(3), jnp.array([1.0, 2.0, 3.0])), jnp.eye(3)
    found = jax.jit(lambda y: y * sum(jax.eval_shape(metric.inner_product, x, x, x).size for _ in range(2)))
    assert found(3.0) == 6.0


@pytest.mark.parametrize("family", [QR, Polar, Cayley, Exponential])
@pytest.mark.usual(1)
def test_complex_frames_are_refused_in_words(family):
    retraction = family(Stiefel(3, 2))
    x = jnp.eye(3, 2, dtype=complex)
    for call in (retraction, retraction.inverse):
        with pytest.raises(InvalidInputError, match=r"of Stiefel\(3, 2\) has real entries, .*: ComplexStiefel"):
            call(x, x)
    assert ComplexStiefel(3, 2).is_tangent(x, 1j * family(ComplexStiefel(3, 2))(x, 0 * x))
    with pytest.raises(InvalidInputError, match="has real entries, got complex ones"):
        retraction.manifold.projection(x, x)
