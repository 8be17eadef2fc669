"""Roots on tapes: those of ``find_root``, with its derivatives of every order."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.manifolds.numerics.root import find_root, known_root
from retrax.tape import NotTraceableError, Tape, roots
from retrax.tape.roots import EPS, SETTLED_STEP

RANDOM = np.random.default_rng(0)
A, B = RANDOM.uniform(0.5, 2.0, (2, 7)), RANDOM.uniform(0.5, 2.0, 7)


def pair(a: Array, b: Array) -> Array:
    """A root with a stop of a derivative among its equations, which changes nothing: it is a factor."""

    def residual(c: Array) -> Array:
        unit = 1 + jax.lax.stop_gradient(b) ** 2
        return jnp.stack([(c[0] ** 3 + a[0] * c[0] - b) / unit, 1e6 * (c[1] - jnp.sin(c[0] * a[1]))])

    root, converged = find_root(residual, jnp.ones(2))
    return jnp.where(converged, root, jnp.nan)


def nested(a: Array, b: Array) -> Array:
    """A root of an equation that has a root in it."""
    return find_root(lambda c: c + pair(a * (1 + c[0] ** 2), b)[:1] - b, jnp.zeros(1))[0]


def known(a: Array, b: Array) -> Array:
    return known_root(lambda c: c**2 - a * b, jnp.sqrt(a * b))


FUNCTIONS = {
    "pair": pair,
    "nested": nested,
    "known": known,
    "vmap": lambda a, b: jax.vmap(pair, (None, 0))(a, jnp.stack([b, 2 * b, b**2])),
    "vmap twice": lambda a, b: jax.vmap(jax.vmap(pair, (0, None)), (None, 0), 1)(
        jnp.stack([a, 1 + a]), jnp.stack([b, 2 * b, 3 * b])
    ),
    "derivative": lambda a, b: jax.jacrev(pair)(a, b),
}


def each(function, axis):
    return lambda a, b: np.moveaxis(np.asarray(jax.jit(jax.vmap(function, (1, 0)))(a, b)), 0, axis)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.usual(1)
def test_roots_have_the_values_and_derivatives_of_xla(name):
    function = FUNCTIONS[name]
    tape = Tape.trace(function, A[:, 0], B[0])
    np.testing.assert_allclose(tape(A, B), each(function, -1)(A, B), rtol=1e-12, atol=1e-13)

    def number(a: Array, b: Array) -> Array:
        return jnp.sum(function(a, b) ** 2) * a[0]

    tape = Tape.trace(number, A[:, 0], B[0])
    hessian = tape.hessian(0)
    np.testing.assert_allclose(hessian(A, B), each(jax.hessian(number), -1)(A, B), rtol=1e-10, atol=1e-11)
    third = np.reshape(hessian.jacobian(1)(A, B), (2, 2, -1))
    np.testing.assert_allclose(third, each(jax.jacfwd(jax.hessian(number), 1), -1)(A, B), rtol=1e-9, atol=1e-10)


def circle(a: Array) -> tuple[Array, Array]:
    """How far a point ``(1, 0)`` moves back to the unit circle where it moves sideways by ``a``: from 1 on nowhere."""
    return find_root(lambda c: (1 + c) ** 2 + a**2 - 1, jnp.zeros(1))


def test_what_converges_is_swept_through_the_edge_of_what_has_roots():
    """There are ever more steps of Newton's method nearer to the edge, and on a tape there are as many as are written
    out."""
    inside, outside = 1 - 10.0 ** np.arange(-6, 0), 1 + 10.0 ** np.arange(-12, 1)
    sideways = np.concatenate([np.linspace(0, 0.99, 50), inside])
    tape = Tape.trace(circle, np.zeros(()))
    root, converged = tape(sideways)
    assert np.all(converged == 1)
    np.testing.assert_allclose(root[0], np.sqrt(1 - sideways**2) - 1, rtol=1e-9)
    assert not np.any(tape(outside)[1])


def test_no_claim_of_convergence_is_false():
    """Random systems of quadratic equations, of which about half have a root that Newton's method finds."""
    found = 0
    for k in (1, 2, 3, 5):
        linear, quadratic = RANDOM.normal(size=(k, k)), RANDOM.normal(size=(k, k, k))

        def residual(c: Array, a: Array, linear=linear, quadratic=quadratic) -> Array:
            step = jnp.where(c[0] > a[1], 0.3, 0.0)
            return linear @ c + jnp.einsum("ijk,j,k->i", quadratic, c, c) * a[0] + jnp.sin(c * a[1]) + a[2] + step

        points = 2 * RANDOM.normal(size=(3, 200))
        tape = Tape.trace(
            lambda a, k=k, residual=residual: find_root(lambda c: residual(c, a), jnp.zeros(k)), points[:, 0]
        )
        root, converged = tape(points)
        off = np.max(np.abs(jax.vmap(residual, (1, 1), 1)(root, points)), axis=0)
        scale = (1 + np.max(np.abs(root), axis=0)) ** 2 * (1 + np.abs(points[0]))
        assert np.all(off[converged > 0] < 1e-9 * scale[converged > 0] * k**2)
        found += np.sum(converged)
    assert 200 < found < 700


def ring(count: int) -> Callable[[Array], Array]:
    """Equations each of which has two of the unknowns."""
    return lambda a: find_root(lambda c: c + c**3 / 9 + 0.1 * jnp.roll(c, 1) - a, jnp.zeros(count))[0]


@pytest.mark.parametrize("count", [1, 6, 7, 15, 16])
@pytest.mark.usual(1)
def test_systems_of_all_sizes_have_the_roots_of_xla(count):
    a = RANDOM.normal(size=(count, 3))
    expected = jax.vmap(ring(count), 1, 1)(a)
    np.testing.assert_allclose(Tape.trace(ring(count), a[:, 0])(a), expected, rtol=1e-12, atol=1e-13)


def test_large_systems_are_left_to_xla():
    with pytest.raises(
        NotTraceableError, match="it calls implicit_root, here of 17 unknowns, where a tape has at most 16"
    ):
        Tape.trace(ring(17), np.zeros(17))


@pytest.mark.slow
def test_very_many_roots_are_left_to_xla():
    """Swept through the decision: as many as there are, they are those of XLA, or all are left to it."""
    traced = []
    for count in (20, 60, 160):
        a = RANDOM.normal(size=(count, 4, 2))
        function = jax.vmap(ring(4))
        try:
            tape = Tape.trace(function, a[..., 0])
        except NotTraceableError:
            traced.append(False)
        else:
            traced.append(True)
            np.testing.assert_allclose(tape(a), jax.vmap(function, 2, 2)(a), rtol=1e-12, atol=1e-13)
    with pytest.raises(
        NotTraceableError,
        match=r"it calls implicit_root, here of .* instructions for a step, where a tape has at most 10000",
    ):
        Tape.trace(jax.vmap(ring(4)), np.zeros((160, 4)))
    assert traced == sorted(traced, reverse=True)
    assert traced[0]
    assert not traced[-1]


def test_a_root_does_not_depend_on_the_points_that_it_is_computed_with():
    """Some converge in fewer steps than others, and the loop ends with the last of them."""
    sideways = np.concatenate([[0.0], 1 - 10.0 ** np.arange(-6, 0), RANDOM.uniform(0, 1.2, 60)])
    tape = Tape.trace(circle, np.zeros(()))
    together = tape(sideways)
    for k in range(len(sideways)):
        for one, all_of_them in zip(tape(sideways[k : k + 1]), together, strict=True):
            np.testing.assert_array_equal(one[..., 0], all_of_them[..., k])


@pytest.mark.parametrize("settled", [0.0, EPS, 8 * EPS, SETTLED_STEP, 1e3 * EPS])
def test_where_a_loop_ends_changes_no_root_and_no_claim(settled, monkeypatch):
    """It is that of all the steps that there may be, from no step that leaves rounding to a thousand times as long
    ones; those of a tenth lose digits."""
    sideways = np.concatenate([[0.0], 1 - 10.0 ** np.arange(-6, 0), 1 + 10.0 ** np.arange(-12, 1)])
    several = RANDOM.normal(size=(3, 40))

    def found(least: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        monkeypatch.setattr(roots, "SETTLED_STEP", least)
        own = Tape.trace(ring(3), several[:, 0])(several)
        return *Tape.trace(circle, np.zeros(()))(sideways), own

    (root, claimed, others), (least, all_claimed, least_others) = found(settled), found(0.0)
    np.testing.assert_array_equal(claimed, all_claimed)
    at = claimed > 0
    np.testing.assert_allclose(root[0, at], least[0, at], rtol=1e-9)  # the edge is that near
    np.testing.assert_allclose(others, least_others, rtol=1e-14, atol=1e-15)
    early = found(0.1)
    assert np.max(np.abs(early[2] - least_others)) > 1e-9


def test_an_expansion_has_no_derivatives_through_roots():
    tape = Tape.trace(lambda d, a: (circle(a + d[0])[0][0], jnp.zeros(0)), np.zeros(1), np.zeros(()))
    sideways = np.linspace(0.0, 0.8, 5)
    curvature, slope, *_ = tape.expansion()(sideways)
    np.testing.assert_allclose(slope[0], -sideways / np.sqrt(1 - sideways**2), atol=1e-13)
    np.testing.assert_allclose(curvature[0, 0], -((1 - sideways**2) ** -1.5), rtol=1e-12)
    with pytest.raises(ValueError, match="an expansion has no derivatives through roots"):
        tape.expansion().jacobian(0)
    both = Tape.trace(lambda d, a, b: (d[0] * b**2 * circle(a)[0][0], d), np.zeros(1), np.zeros(()), np.zeros(()))
    slope = both.expansion().jacobian(1)(sideways, 1 + sideways)
    np.testing.assert_allclose(slope[1, 0], 2 * (1 + sideways) * (np.sqrt(1 - sideways**2) - 1), atol=1e-13)


def test_complex_numbers_are_left_to_xla():
    with pytest.raises(NotTraceableError, match="it calls implicit_root, here of complex numbers"):
        Tape.trace(lambda z: find_root(lambda c: c**2 - jnp.real(z) - 1, jnp.ones(1))[0], 1j * np.ones(()))
