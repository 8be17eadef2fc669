"""Tangent and cotangent bundles, and the canonical forms."""

from functools import lru_cache

import jax
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import SO, CotangentBundle, Euclidean, Sphere, TangentBundle
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import BundleRetraction, Polar, Projection

from tests.support.cases import MANIFOLDS
from tests.support.numerics import CENTRAL_NODES, SEEDS, compiled, differences, draw_point, draw_tangent, flat, unflat

BASES = {"S2": Projection(MANIFOLDS["S2"]), "SO3": Polar(MANIFOLDS["SO3"])}
STEP = 4e-3

every_base = pytest.mark.parametrize("base", BASES)


def test_bundles_are_named_by_their_bases():
    assert str(CotangentBundle(SO(3) * Euclidean(3))) == "CotangentBundle(SO(3) x R^3)"


@lru_cache
def _forms(base: str):
    """Canonical forms at ``z``: matrices on a frame, and the one-form along a surface in the cotangent bundle."""
    bundle = CotangentBundle(MANIFOLDS[base])
    move, unravel = BundleRetraction(BASES[base]), unflat(bundle)

    def facts(z, a, b):
        z, a, b = map(unravel, (z, a, b))

        def theta_along(s, t):
            """``theta`` on both velocities of the surface ``R(z, s a + t b)``."""
            place, along_s = jax.jvp(lambda s: move(z, vec.add(vec.scale(s, a), vec.scale(t, b))), (s,), (1.0,))
            along_t = jax.jvp(lambda t: move(z, vec.add(vec.scale(s, a), vec.scale(t, b))), (t,), (1.0,))[1]
            return bundle.one_form(place, along_s), bundle.one_form(place, along_t)

        return {
            "two_form": bundle.two_form(z, a, b),
            "reversed": bundle.two_form(z, b, a),
            "one_form": bundle.one_form(z, a),
            "theta_s over t": jax.vmap(lambda t: theta_along(0.0, t)[0])(STEP * CENTRAL_NODES),
            "theta_t over s": jax.vmap(lambda s: theta_along(s, 0.0)[1])(STEP * CENTRAL_NODES),
        }

    return compiled(facts)


@lru_cache
def _matrix(base: str):
    bundle, unravel = CotangentBundle(MANIFOLDS[base]), unflat(CotangentBundle(MANIFOLDS[base]))

    def matrix(z):
        frame = bundle.spanning_frame(unravel(z))
        rows = jax.vmap(lambda a: jax.vmap(lambda b: bundle.two_form(unravel(z), a, b))(frame))(frame)
        return rows, vec.flatten_frame(frame), vec.flatten_frame(bundle.basis(unravel(z)))

    return compiled(matrix)


def draw(base: str, seed: int) -> tuple[np.ndarray, ...]:
    """A point of the cotangent bundle and two tangent vectors there."""
    z, other, basis = draw_point(CotangentBundle(MANIFOLDS[base]), seed)
    return z, draw_tangent(np.random.default_rng(seed), basis, 1.0), other


@every_base
@given(seed=SEEDS)
def test_one_form_pairs_the_covector_with_the_velocity_of_the_base_point(base, seed):
    z, a, b = draw(base, seed)
    (_, p), (dq, _) = np.split(z, 2), np.split(a, 2)
    np.testing.assert_allclose(_forms(base)(z, a, b)["one_form"], p @ dq, atol=1e-14)


@every_base
@given(seed=SEEDS)
def test_two_form_is_antisymmetric(base, seed):
    facts = _forms(base)(*draw(base, seed))
    assert abs(facts["two_form"]) > 0
    np.testing.assert_array_equal(facts["two_form"], -facts["reversed"])


@every_base
@given(seed=SEEDS)
def test_two_form_is_minus_the_exterior_derivative_of_the_one_form(base, seed):
    # On a surface sigma(s, t): d theta(sigma_s, sigma_t) = d_s theta(sigma_t) - d_t theta(sigma_s).
    facts = _forms(base)(*draw(base, seed))
    exterior = differences(facts["theta_t over s"], STEP) - differences(facts["theta_s over t"], STEP)
    np.testing.assert_allclose(facts["two_form"], -exterior, atol=1e-9)


@every_base
@given(seed=SEEDS)
def test_two_form_has_determinant_one_in_a_frame_and_its_dual(base, seed):
    z, _, _ = draw(base, seed)
    matrix, _, _ = _matrix(base)(z)
    np.testing.assert_allclose(np.linalg.det(matrix), 1, atol=1e-12)


@every_base
@given(seed=SEEDS)
def test_spanning_frame_spans_the_tangent_space(base, seed):
    z, _, _ = draw(base, seed)
    _, frame, e = _matrix(base)(z)
    np.testing.assert_allclose(frame @ e.T @ e, frame, atol=1e-12)
    assert np.linalg.matrix_rank(frame, tol=1e-8) == len(e) == 2 * MANIFOLDS[base].dimension


@every_base
@given(seed=SEEDS)
def test_spanning_frame_holds_velocities_of_curves_in_the_bundle(base, seed):
    # Their violations of the bundle's equations are of second order.
    z, _, _ = draw(base, seed)
    bundle, unravel = CotangentBundle(MANIFOLDS[base]), unflat(CotangentBundle(MANIFOLDS[base]))
    frame = _matrix(base)(z)[1]
    for distance in (1e-3, 1e-4):
        for row in frame:
            point = unravel(z + distance * row)
            assert bundle.contains(point, 20 * distance**2 * (1 + np.max(np.abs(row))) ** 2)


def test_bundles_over_one_manifold_are_one_set_with_different_names():
    tangent, cotangent = TangentBundle(Sphere(2)), CotangentBundle(Sphere(2))
    assert tangent != cotangent
    z = unflat(tangent)(draw("S2", 3)[0])
    assert tangent.contains(z)
    assert cotangent.contains(z)
    verdict = tangent.contains((z[0], z[0]))
    assert not verdict
    assert "relative normal part of the fibre" in verdict.reason
    verdict = tangent.contains((2 * z[0], z[1]))
    assert "base point: ||x|^2 - 1|" in verdict.reason
    np.testing.assert_array_equal(flat(z), draw("S2", 3)[0])


@pytest.mark.parametrize("base", [Sphere(2), SO(3)], ids=str)
@pytest.mark.usual(1)
def test_the_basis_of_a_bundle_does_not_jump_with_rounding(base):
    """Gram-Schmidt by Householder's reflections had signs that came from entries which are zero but for rounding."""
    bundle = CotangentBundle(base)

    @jax.jit
    @jax.vmap
    def change(key):
        first, second = jax.random.split(key)
        z = bundle.random_point(first)
        moved = vec.add(z, vec.scale(1e-14, bundle.random_tangent(second, z)))
        return vec.size(vec.subtract(bundle.basis(moved), bundle.basis(z)))

    assert np.max(change(jax.random.split(jax.random.key(0), 200))) < 1e-12


@every_base
def test_the_parts_of_a_covector_pair_with_what_is_lifted(base):
    """``<c, lift(a, b)> = <s, a> + <t, b>``, with ``s`` and ``t`` tangent, for a covector that is not."""
    manifold, draw = MANIFOLDS[base], np.random.default_rng(0)
    bundle = TangentBundle(manifold)
    x, v, frame = draw_point(manifold, 0)
    x, v, a, b = map(unflat(manifold), (x, v, draw_tangent(draw, frame, 1.0), draw_tangent(draw, frame, 1.0)))
    covector = tuple(unflat(manifold)(draw.standard_normal(flat(x).size)) for _ in range(2))
    s, t = bundle.parts((x, v), covector)
    np.testing.assert_allclose([flat(manifold.projection(x, w)) for w in (s, t)], [flat(s), flat(t)], atol=1e-14)
    paired = vec.pairing(covector, bundle.lift((x, v), a, b))
    np.testing.assert_allclose(paired, vec.pairing(s, a) + vec.pairing(t, b), rtol=1e-12)
