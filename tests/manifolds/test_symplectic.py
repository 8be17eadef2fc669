"""The Tulczyjew triple, lifted and pulled back forms, Lagrangian submanifolds."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import (
    CotangentBundle,
    Euclidean,
    Immersion,
    InvalidInputError,
    NotOnManifoldError,
    PresymplecticManifold,
    Product,
    Sphere,
    TangentBundle,
    TulczyjewTriple,
    form_matrix,
    is_lagrangian,
    pullback_form,
    tangent_lift,
)
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.symplectic import Phi, beta, beta_inverse, difference, graph, preimage
from retrax.manifolds.symplectic.lagrangian import lagrangian_subspace
from retrax.retractions import cotangent_lift

from tests.support.cases import MANIFOLDS
from tests.support.numerics import SEEDS, compiled, draw_bundle_tangent, flat, norm, unflat

BASES = ["S2", "SO3", "ellipsoid", "R2x3"]
every_base = pytest.mark.parametrize("base", BASES)

SPHERE = Sphere(2)
PHASE = CotangentBundle(SPHERE)
SYMPLECTIC = PresymplecticManifold(PHASE, PHASE.two_form)
# T*S^2 x R with the form of the first factor: its kernel is the direction of the second.
PRESYMPLECTIC = PresymplecticManifold(Product(PHASE, Euclidean(1)), lambda x, a, b: PHASE.two_form(x[0], a[0], b[0]))


def energy(z):
    """A Hamiltonian on any cotangent bundle of arrays."""
    q, p = flat(z[0]), flat(z[1])
    return jnp.sum(jnp.sin(q) * p) + p @ p + jnp.prod(q[:3])


@lru_cache
def _triple(base: str):
    """Facts at a point of TT*Q: the pulled back forms on a frame, the points, and a Hamiltonian vector field."""
    triple = TulczyjewTriple(MANIFOLDS[base])
    phase = CotangentBundle(MANIFOLDS[base])
    left, right = triple.lagrangian_side, triple.hamiltonian_side
    unravel = unflat(triple.middle)

    def facts(w):
        w = unravel(w)
        frame = triple.middle.spanning_frame(w)
        there, over = triple.alpha_inverse(*w), triple.beta(*w)
        slope = jax.grad(energy)(w[0])
        field, e = phase.sharp(w[0], slope), phase.basis(w[0])
        return {
            "d_T omega": form_matrix(tangent_lift(phase.two_form), w, frame),
            "alpha": form_matrix(pullback_form(lambda w: triple.alpha_inverse(*w), left.two_form), w, frame),
            "beta": form_matrix(pullback_form(lambda w: triple.beta(*w), right.two_form), w, frame),
            "back": (flat(triple.alpha(*there)), flat(triple.beta_inverse(*over))),
            "there": (there, over),
            "normal parts": (left.violations(there), right.violations(over)),
            "contraction": jax.vmap(lambda b: phase.two_form(w[0], field, b))(e) - vec.components(e, slope),
            "field": (w[0], field),
        }

    return compiled(facts)


def triple_facts(base: str, seed: int) -> dict:
    w = draw_bundle_tangent(MANIFOLDS[base], seed, 1.0)
    return {"w": w, **_triple(base)(w)}


@every_base
@given(seed=SEEDS)
@pytest.mark.usual(1)
def test_alpha_is_symplectic(base, seed):
    facts = triple_facts(base, seed)
    assert norm(facts["d_T omega"]) > 0.1
    np.testing.assert_allclose(facts["alpha"], facts["d_T omega"], atol=1e-11)


@every_base
@given(seed=SEEDS)
@pytest.mark.usual(1)
def test_beta_is_antisymplectic(base, seed):
    facts = triple_facts(base, seed)
    np.testing.assert_allclose(facts["beta"], -facts["d_T omega"], atol=1e-11)


@every_base
@given(seed=SEEDS)
def test_alpha_and_beta_are_invertible_and_stay_in_the_bundles(base, seed):
    facts = triple_facts(base, seed)
    for back in facts["back"]:
        np.testing.assert_allclose(back, facts["w"], atol=1e-12)
    for violation in jax.tree.leaves(facts["normal parts"]):
        assert violation < 1e-12


@every_base
@given(seed=SEEDS)
def test_sharp_gives_the_hamiltonian_vector_field(base, seed):
    facts = triple_facts(base, seed)
    np.testing.assert_allclose(facts["contraction"], 0, atol=1e-12)
    assert TangentBundle(CotangentBundle(MANIFOLDS[base])).contains(facts["field"], 1e-12)


def test_beta_is_that_of_hamiltons_equations():
    assert beta("q", "p", "qdot", jnp.array(2.0)) == ("q", "p", -2.0, "qdot")
    assert beta_inverse(*beta(1.0, 2.0, 3.0, 4.0)) == (1.0, 2.0, 3.0, 4.0)


@lru_cache
def _phi(base: str):
    manifold = MANIFOLDS[base]
    phase, ends = CotangentBundle(manifold), CotangentBundle(Product(manifold, manifold))
    unravel = unflat(phase)

    def facts(z0, z1):
        pair = unravel(z0), unravel(z1)
        frame = Product(phase, phase).basis(pair)
        pulled = pullback_form(lambda x: Phi(*x), ends.two_form)
        return form_matrix(pulled, pair, frame), form_matrix(difference(phase.two_form, phase.two_form), pair, frame)

    return compiled(facts)


@pytest.mark.parametrize("base", ["S2", "SO3"])
@given(seed=SEEDS)
def test_phi_makes_omega_twelve_of_the_canonical_form_on_manifolds(base, seed):
    ends = [np.split(draw_bundle_tangent(MANIFOLDS[base], seed + k, 1.0), 2)[0] for k in range(2)]
    pulled, omega = _phi(base)(*ends)
    assert norm(omega) > 0.1
    np.testing.assert_allclose(pulled, omega, atol=1e-13)


def bent(z):
    """A diffeomorphism of the cotangent bundle of a vector space that preserves no form."""
    q, p = z
    return q + jnp.sin(p) / 3, p + q**2 / 4


@compiled
def _lifted_pullback(y):
    phase = CotangentBundle(Euclidean(2))
    unravel = unflat(TangentBundle(phase))
    y = unravel(y)
    frame = TangentBundle(phase).basis(y)
    lifted = tangent_lift(pullback_form(bent, phase.two_form))
    pulled = pullback_form(lambda y: jax.jvp(bent, (y[0],), (y[1],)), tangent_lift(phase.two_form))
    return form_matrix(lifted, y, frame), form_matrix(pulled, y, frame)


@given(seed=SEEDS)
def test_the_tangent_lift_commutes_with_pullbacks(seed):
    # d_T(f* omega) = (Tf)* d_T omega, also where f* omega depends on the point.
    lifted, pulled = _lifted_pullback(np.random.default_rng(seed).standard_normal(8))
    np.testing.assert_allclose(lifted, pulled, atol=1e-13)


@lru_cache
def _points(space: PresymplecticManifold):
    return jax.jit(lambda seed: space.manifold.random_point(jax.random.key(seed)))


def draw(space: PresymplecticManifold, seed: int):
    return _points(space)(seed)


@pytest.mark.parametrize(("space", "rank", "nullity"), [(SYMPLECTIC, 4, 0), (PRESYMPLECTIC, 4, 1)])
@given(seed=SEEDS)
@pytest.mark.usual(1)
def test_rank_and_kernel_of_a_form(space, rank, nullity, seed):
    x = draw(space, seed)
    kernel = space.kernel(x)
    assert space.rank(x) == rank
    assert len(jax.tree.leaves(kernel)[0]) == nullity == space.manifold.dimension - rank
    if nullity:
        np.testing.assert_allclose(np.abs(kernel[1]), 1, atol=1e-12)
        assert norm(kernel[0]) < 1e-12


MATRIX = np.eye(3) + 0.3 * np.array([[0.0, 1.0, 0.2], [0.5, 0.1, -0.4], [-0.3, 0.6, 0.0]])


def lifted(matrix):
    """Cotangent lift of the diffeomorphism ``x -> A x / |A x|`` of the sphere."""
    return lambda z: cotangent_lift(lambda x: matrix @ x / jnp.linalg.norm(matrix @ x), SPHERE, SPHERE)(*z)


lifted_twist, lifted_untwist = lifted(MATRIX), lifted(np.linalg.inv(MATRIX))


def stretch(x):
    """A presymplectic diffeomorphism of ``T*S^2 x R``: the form does not see the second factor."""
    return lifted_twist(x[0]), x[1] ** 3 + x[1] + x[0][0][0]


GRAPH = graph(lifted_twist, SYMPLECTIC, SYMPLECTIC)
STRETCHED = graph(stretch, PRESYMPLECTIC, PRESYMPLECTIC)
DOUBLED = graph(lambda z: (z[0], 2 * z[1]), SYMPLECTIC, SYMPLECTIC)


@given(seed=SEEDS)
def test_the_graph_of_a_symplectic_map_is_lagrangian(seed):
    verdict = is_lagrangian(GRAPH, draw(SYMPLECTIC, seed))
    assert verdict, verdict.reason
    assert (verdict.dimension, verdict.rank, verdict.shared) == (4, 8, 0)


@given(seed=SEEDS)
def test_the_graph_of_a_presymplectic_map_is_lagrangian(seed):
    verdict = is_lagrangian(STRETCHED, draw(PRESYMPLECTIC, seed))
    assert verdict, verdict.reason
    assert (verdict.dimension, verdict.rank, verdict.shared) == (5, 8, 1)


@given(seed=SEEDS)
def test_the_graph_of_another_map_is_not_lagrangian(seed):
    verdict = is_lagrangian(DOUBLED, draw(SYMPLECTIC, seed))
    assert not verdict
    assert "not isotropic: the pulled back form is" in verdict.reason


def differential(q):
    """The closed one-form ``dS`` on the sphere: its image is a Lagrangian submanifold of ``T*S^2``."""
    return q, SPHERE.projection(q, jax.grad(lambda q: q[0] * q[1] + jnp.sin(2 * q[2]))(q))


def widened(x):
    """The same times the line in ``T*S^2 x R``."""
    return differential(x[0]), x[1]


CLOSED = Immersion(SPHERE, SYMPLECTIC, differential)
WIDE = Immersion(Product(SPHERE, Euclidean(1)), PRESYMPLECTIC, widened)


@lru_cache
def submanifold(name: str) -> Immersion:
    """The images of the one-forms, and their preimages, which are checked when they are made."""
    if name == "pulled dS":
        return preimage(CLOSED, lifted_twist, lifted_untwist, PHASE)
    if name == "pulled dS x R":
        there, back = lambda x: (lifted_twist(x[0]), 2 * x[1]), lambda x: (lifted_untwist(x[0]), x[1] / 2)
        return preimage(WIDE, there, back, PRESYMPLECTIC.manifold)
    return {"dS": CLOSED, "dS x R": WIDE}[name]


@lru_cache
def points_of(name: str):
    """The random points of its source by their seeds, compiled."""
    return jax.jit(lambda seed: submanifold(name).source.random_point(jax.random.key(seed)))


@pytest.mark.long("dS x R")
@pytest.mark.parametrize("name", ["dS", "dS x R", "pulled dS", "pulled dS x R"])
@given(seed=SEEDS)
@pytest.mark.long("pulled dS x R")
def test_closed_one_forms_and_their_preimages_are_lagrangian(name, seed):
    made = submanifold(name)
    verdict = is_lagrangian(made, points_of(name)(seed))
    assert verdict, verdict.reason
    assert verdict.dimension == made.source.dimension


AREA = PresymplecticManifold(SPHERE, lambda x, a, b: x @ jnp.cross(a, b))
MERIDIAN = Immersion(Euclidean(1), AREA, lambda t: jnp.stack([jnp.sin(t[0]), 0.0, jnp.cos(t[0])]))


def test_what_is_not_on_the_manifolds_is_not_certified():
    assert is_lagrangian(MERIDIAN, 0.3 * jnp.ones(1))
    with pytest.raises(NotOnManifoldError, match="y is not a point of the submanifold's source"):
        is_lagrangian(MERIDIAN, jnp.zeros(3))
    line = Immersion(Euclidean(1), AREA, lambda t: jnp.stack([t[0], 0.0, 1.0]))
    with pytest.raises(NotOnManifoldError, match="does not map y to a point of its target: not on"):
        is_lagrangian(line, 0.3 * jnp.ones(1))
    slanted = Immersion(Euclidean(1), AREA, lambda t: jnp.stack([t[0], 0.0, 1.0 + t[0]]))
    with pytest.raises(NotOnManifoldError, match="its tangent vectors have a normal part"):
        is_lagrangian(slanted, jnp.zeros(1))
    with pytest.raises(InvalidInputError, match="inverse is not the inverse of f"):
        preimage(CLOSED, lifted_twist, lambda z: z, PHASE)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: is_lagrangian(3, 0.0), "takes an Immersion, got 3"),
        (lambda: graph(lifted_twist, PHASE, PHASE), "expected a manifold with a two-form"),
        (lambda: graph(3, SYMPLECTIC, SYMPLECTIC), "expected a function of points, got 3"),
        (lambda: preimage(3, lifted_twist, lifted_untwist, PHASE), "takes an Immersion, got 3"),
        (lambda: Immersion(3, SYMPLECTIC, differential), "the source of an immersion is a manifold, got 3"),
    ],
)
def test_parts_of_another_kind_are_refused(call, message):
    with pytest.raises(InvalidInputError, match=message):
        call()


@pytest.mark.slow
def test_a_smaller_isotropic_submanifold_is_not_lagrangian():
    form = np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2))
    curve = lagrangian_subspace(form, np.eye(4)[:1])
    assert not curve
    assert "isotropic of dimension 1, expected rank / 2 + dim(TL and ker) = 4 / 2 + 0 = 2" in curve.reason
    assert lagrangian_subspace(form, np.eye(4)[:2])
    degenerate = np.zeros((5, 5))
    degenerate[:4, :4] = form
    assert lagrangian_subspace(degenerate, np.eye(5)[:2])
    assert lagrangian_subspace(degenerate, np.eye(5)[[0, 1, 4]])
    assert not lagrangian_subspace(degenerate, np.eye(5)[[0, 4]])
    assert "rank / 2 + dim(TL and ker) = 0 / 2 + 2 = 2" in lagrangian_subspace(np.zeros((2, 2)), np.eye(2)).reason
