"""The numerical tools below the geometry: smooth series, Newton's method, ambient vectors."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics import series
from retrax.manifolds.numerics.compiler import known_options
from retrax.manifolds.numerics.differences import central_difference, central_nodes, slope
from retrax.manifolds.numerics.levenberg import APPROACH, RELATIVE_DAMPING, SHORTENING, levenberg
from retrax.manifolds.numerics.rank import null_space, numerical_rank
from retrax.manifolds.numerics.root import find_root

from tests.support.numerics import SEEDS, compiled, norm

ANGLES = st.one_of(st.floats(0.0, 3.1), st.sampled_from([0.0, 1e-200, 1e-9, 0.1, 1.0]))


@compiled
def _entire(s):
    functions = {"cosine": series.cosine, "sinc": series.sinc, "cosc": series.cosc}
    derivatives = {f"d {name}": jax.grad(f)(s) for name, f in functions.items()}
    backwards = {f"dd {name}": jax.jacrev(jax.jacrev(f))(s) for name, f in functions.items()}
    return {**{name: f(s) for name, f in functions.items()}, **derivatives, **backwards}


@compiled
def _arc(t):
    return series.angle_over_sine(jnp.sin(t) ** 2, jnp.cos(t))


@given(t=ANGLES)
def test_even_functions_of_an_angle(t):
    f = _entire(t * t)
    np.testing.assert_allclose(f["cosine"], np.cos(t), atol=3e-16, rtol=0)
    np.testing.assert_allclose(f["sinc"], np.sinc(t / np.pi), atol=3e-16, rtol=0)
    np.testing.assert_allclose(f["cosc"], 0.5 * np.sinc(t / 2 / np.pi) ** 2, atol=3e-16, rtol=0)


@given(t=ANGLES)
def test_even_functions_satisfy_their_differential_equations(t):
    # In s = t^2: 2 cosine' = -sinc, 2 s sinc' = cosine - sinc, 2 s cosc' = sinc - 2 cosc, and once more.
    s, f = t * t, _entire(t * t)
    np.testing.assert_allclose(2 * f["d cosine"], -f["sinc"], atol=1e-15)
    np.testing.assert_allclose(2 * s * f["d sinc"], f["cosine"] - f["sinc"], atol=2e-15)
    np.testing.assert_allclose(2 * s * f["d cosc"], f["sinc"] - 2 * f["cosc"], atol=2e-15)
    np.testing.assert_allclose(2 * f["dd cosine"], -f["d sinc"], atol=2e-15)
    np.testing.assert_allclose(2 * s * f["dd sinc"] + 2 * f["d sinc"], f["d cosine"] - f["d sinc"], atol=5e-15)
    np.testing.assert_allclose(2 * s * f["dd cosc"] + 2 * f["d cosc"], f["d sinc"] - 2 * f["d cosc"], atol=5e-15)


def test_even_functions_have_their_derivatives_at_zero():
    f = _entire(0.0)
    expected = {"d cosine": -1 / 2, "d sinc": -1 / 6, "d cosc": -1 / 24, "dd cosine": 1 / 12, "dd sinc": 1 / 60}
    for name, value in expected.items():
        np.testing.assert_allclose(f[name], value, rtol=1e-15)


@given(t=st.one_of(st.floats(0.0, np.pi - 1e-6), st.sampled_from([1e-9, 0.1, np.pi / 2, np.pi - 1e-6])))
def test_angle_over_sine(t):
    np.testing.assert_allclose(_arc(t), t / np.sin(t) if t > 0 else 1.0, rtol=2e-15)


@compiled
def _remainders(s):
    functions = {"sine": series.sine_remainder, "cotangent": series.cotangent_remainder}
    derivatives = {f"d {name}": jax.grad(f)(s) for name, f in functions.items()}
    twice = {f"dd {name}": jax.jacfwd(jax.grad(f))(s) for name, f in functions.items()}
    return {**{name: f(s) for name, f in functions.items()}, **derivatives, **twice}


def _cubic(c, a):
    """``c_i^3 + c_i + (sum c) / 10 = a_i``: one root for each ``a``."""
    return c**3 + c + jnp.sum(c) / 10 - a


@lru_cache
def _root():
    def solve(a):
        return find_root(lambda c: _cubic(c, a), jnp.zeros(2))

    def facts(a, direction):
        slopes = jax.jvp(lambda a: solve(a)[0], (a,), (direction,))[1]
        curved = jax.jvp(lambda a: jax.grad(lambda b: jnp.sum(jnp.sin(solve(b)[0])))(a), (a,), (direction,))[1]
        return *solve(a), slopes, jax.jacrev(lambda a: solve(a)[0])(a), curved

    return compiled(facts)


@given(seed=SEEDS)
@example(seed=231)
def test_find_root_solves_a_monotone_convex_equation_as_newtons_method_does(seed):
    # Newton's method from 0 overshoots once and then descends to the root, for every right-hand side.
    a, _ = np.random.default_rng(seed).standard_normal((2, 2))
    c, converged, *_ = _root()(a, a)
    assert converged
    np.testing.assert_allclose(_cubic(c, a), 0, atol=2e-14)


@pytest.mark.parametrize("start", [0.3, 1.0, 40.0])
@pytest.mark.usual(1)
def test_find_root_says_where_there_is_none(start):
    """``c^2 = a`` has a root for ``a > 0``, a double one for ``a = 0``, none below."""
    solve = compiled(jax.vmap(lambda a: find_root(lambda c: c**2 - a, jnp.array([start]))))
    sizes = np.array([1e-6, 1e-3, 0.1, 1.0, 1e3])
    root, converged = solve(sizes)
    assert converged.all()
    np.testing.assert_allclose(root[:, 0], np.sqrt(sizes), rtol=1e-13)
    assert not solve(-sizes)[1].any()


@given(seed=SEEDS)
def test_find_root_is_differentiated_by_the_implicit_function_theorem(seed):
    a, direction = np.random.default_rng(seed).uniform(-0.5, 0.5, (2, 2))
    c, converged, slopes, pulled, curved = _root()(a, direction)
    assert converged
    jacobian = np.linalg.inv(np.diag(3 * c**2 + 1) + 0.1)
    np.testing.assert_allclose(slopes, jacobian @ direction, atol=1e-13)
    np.testing.assert_allclose(pulled, jacobian, atol=1e-13)
    # d/da [J' cos c] = J' (-sin c dc) - J' diag(6 c dc) J' cos c, with dc = J direction.
    dc, weights = jacobian @ direction, jacobian.T @ np.cos(c)
    np.testing.assert_allclose(curved, jacobian.T @ (-np.sin(c) * dc - 6 * c * dc * weights), atol=1e-12)


@pytest.mark.parametrize("outer", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("inner", [jax.jacfwd, jax.jacrev])
@pytest.mark.slow
def test_second_derivatives_of_roots_in_a_loop_are_right_in_every_mode(outer, inner):
    """The first guess is the root, and its inverse Jacobian is off by a factor: the iterations know no derivative."""

    def twice(y):
        def step(y, _):
            root, _ = find_root(
                lambda c: jnp.stack([c[0] + c[0] ** 2, c[1] + c[0] * c[1]]) - y, 0 * y, inverse=0.7 * np.eye(2)
            )
            return root, None

        return jax.lax.scan(step, y, length=2)[0]

    # c0 = y0 - y0^2, c1 = y1 - y0 y1 to second order, and twice that.
    expected = np.zeros((2, 2, 2))
    expected[0, 0, 0], expected[1, 0, 1], expected[1, 1, 0] = -4, -2, -2
    np.testing.assert_allclose(outer(inner(twice))(jnp.zeros(2)), expected, atol=1e-14)
    np.testing.assert_allclose(jax.jit(jax.vmap(outer(inner(twice))))(jnp.zeros((3, 2)))[1], expected, atol=1e-14)


@compiled
def _scaled_square(scale):
    return find_root(lambda c: (c / scale) ** 2 - 2.0, jnp.array([scale]), scale)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_find_root_knows_the_size_of_its_unknowns(scale):
    c, converged = _scaled_square(scale)
    assert converged
    np.testing.assert_allclose(c, np.sqrt(2) * scale, rtol=1e-15)


@compiled
def _beside(size):
    """A root beside an unknown of a size, and one whose own is given as that."""
    both = find_root(
        lambda c: jnp.stack([c[0] - size, jnp.exp(c[1]) - 2]), jnp.array([0.0, 0.69]), jnp.stack([size, 1])
    )
    return both, find_root(lambda c: jnp.exp(c) - 2, jnp.array([0.69]), size)


@pytest.mark.long("1e-06", "0.01", "100.0", "1000000.0")
@pytest.mark.parametrize("size", 10.0 ** np.arange(-8, 9, 2))
def test_find_root_ends_where_the_roots_are_known_whatever_the_sizes_of_other_unknowns(size):
    """Of unknowns with sizes given too large, or beside one that is found at once, the small one is found to rounding
    as well."""
    (c, converged), (alone, found) = _beside(size)
    assert converged
    assert found
    assert abs(c[1] - np.log(2)) < 2e-16
    assert abs(alone[0] - np.log(2)) < 2e-16 * max(1.0, size)


@compiled
def _far_larger(a, size):
    def residual(c):
        return jnp.stack([c[0] - a * c[1] / 3, c[1] + jnp.sin(c[0]) / 10 - a, jnp.sum(c)])

    c, converged = find_root(residual, jnp.zeros(3), jnp.stack([size, 1.0, size]))
    return residual(c), converged


@pytest.mark.parametrize("size", 10.0 ** np.arange(-40, 1, 8))
@pytest.mark.parametrize("a", [0.3, 1.7, 5.539])
@pytest.mark.usual(3)
def test_find_root_ends_at_a_root_whose_unknowns_are_far_larger_than_their_sizes(size, a):
    """As those of a step from a point that is zero but for rounding: what moves them is the rounding of the root."""
    left, converged = _far_larger(a, size)
    assert converged
    assert norm(left) < 1e-14


@compiled
def _beside_noise(scale, start):
    def residual(c):
        noise = 1e-12 * jax.lax.stop_gradient(jnp.sin(1e15 * c[0]))
        return jnp.stack([jnp.exp(c[0]) - 3, scale * c[1] + noise])

    return find_root(residual, jnp.stack([start, 0.0]))


@pytest.mark.parametrize("scale", 10.0 ** np.arange(-40, 1, 10))
@pytest.mark.parametrize("start", [0.0, 1.05, 3.0])
@pytest.mark.usual(3)
def test_an_unknown_that_rounding_alone_decides_does_not_end_the_search_for_others(scale, start):
    c, converged = _beside_noise(scale, start)
    assert converged
    assert abs(c[0] - np.log(3)) < 1e-12


@pytest.mark.parametrize(
    "residual",
    [lambda c: c**2 + 1, lambda c: jnp.exp(c), lambda c: c * jnp.nan],
    ids=["no real root", "root at infinity", "NaN"],
)
def test_find_root_says_where_it_found_none(residual):
    assert not find_root(residual, jnp.array([0.5]))[1]


@pytest.mark.parametrize(
    ("damping", "values"),
    [
        (APPROACH, [0.1, 0.4, 0.1, 0.025]),
        (RELATIVE_DAMPING, [0.0, 1e-4, 0.0, 0.0]),
        (SHORTENING, [0.0, 2.0, 0.0, 0.0]),
    ],
    ids=["approach", "relative", "shortening"],
)
def test_a_damping_grows_after_a_step_that_is_not_taken_and_falls_after_one_that_is(damping, values):
    """Of numbers, and of arrays of NumPy and JAX alike."""
    for kind in (float, np.array, jnp.array):
        found = [kind(damping.first)]
        for better in (False, True, True):
            found.append(damping.after(found[-1], better))
        np.testing.assert_allclose(found, values, rtol=1e-15)
    assert damping.after(3 * damping.least + 1, False) == damping.grows * (3 * damping.least + 1)
    assert damping.after(3 * damping.least + 1, True) == (3 * damping.least + 1) / damping.falls


@pytest.mark.parametrize("damping", [APPROACH, RELATIVE_DAMPING], ids=["approach", "relative"])
def test_damped_steps_arrive_from_where_those_of_gauss_and_newton_go_ever_further(damping):
    def step(j, r, shift):
        return -jnp.linalg.solve(j.T @ j + shift * jnp.eye(1), j.T @ r)

    x, r = levenberg(jnp.arctan, jnp.array([3.0]), step, damping, 1e-3)
    assert jnp.max(jnp.abs(r)) <= 1e-3
    assert jnp.max(jnp.abs(x)) <= 1.001e-3


@given(seed=SEEDS)
def test_orthonormalise_keeps_the_span(seed):
    rng = np.random.default_rng(seed)
    frame = (jnp.asarray(rng.standard_normal((3, 2, 2))), jnp.asarray(rng.standard_normal((3, 3))))
    before, after = np.asarray(vec.flatten_frame(frame)), np.asarray(vec.flatten_frame(vec.orthonormalise(frame)))
    np.testing.assert_allclose(after @ after.T, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(before @ after.T @ after, before, atol=1e-12)


@compiled
def _of_complex(a, d, p, weight):
    """Of a function and of a map: pairings of the gradient and the pullback, and of the slopes; the map's value
    twice."""

    def height(z):
        return jnp.sum(jnp.real(weight * z * z) + jnp.abs(z) ** 4)

    def square(z):
        return weight * z * jnp.conj(z) + z * z

    value, pull = vec.pullback(square, a)
    slope, pushed = (jax.jvp(f, (a,), (d,))[1] for f in (height, square))
    pairings = vec.pairing(vec.gradient(height, a), d), vec.pairing(pull(p)[0], d)
    return pairings, (slope, vec.pairing(p, pushed)), value, square(a)


@given(seed=SEEDS)
def test_gradients_and_pullbacks_of_complex_arrays_are_covectors_in_the_real_pairing(seed):
    # The convention of JAX is the complex conjugate: <gradient, d> = Df d fails with it.
    drawn = np.random.default_rng(seed).standard_normal((4, 3, 2)) @ np.array([1, 1j])
    pairings, slopes, value, expected = _of_complex(*drawn)
    np.testing.assert_allclose(pairings, slopes, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(value, expected, rtol=1e-15)


@given(t=ANGLES)
def test_remainders_of_the_sine_and_of_the_cotangent(t):
    s, f = t * t, _remainders(t * t)
    np.testing.assert_allclose(f["sine"] * s, 1 - np.sinc(t / np.pi), atol=3e-16)
    half = t / 2
    np.testing.assert_allclose(f["cotangent"] * s, 1 - (half / np.tan(half) if half > 1e-100 else 1.0), atol=3e-16)


def test_remainders_have_their_values_and_derivatives_at_zero():
    f = _remainders(0.0)
    expected = {"sine": 1 / 6, "d sine": -1 / 120, "dd sine": 1 / 2520}
    expected |= {"cotangent": 1 / 12, "d cotangent": 1 / 720, "dd cotangent": 1 / 15120}
    for name, value in expected.items():
        np.testing.assert_allclose(f[name], value, rtol=1e-15)


@given(seed=SEEDS)
def test_components_are_coordinates_in_an_orthonormal_frame_and_combine_their_inverse(seed):
    rng = np.random.default_rng(seed)
    frame = vec.orthonormalise((jnp.asarray(rng.standard_normal((3, 2, 2))), jnp.asarray(rng.standard_normal((3, 3)))))
    c = jnp.asarray(rng.standard_normal(3))
    a = vec.combine(frame, c)
    np.testing.assert_allclose(vec.components(frame, a), c, atol=1e-14)
    np.testing.assert_allclose(vec.pairing(a, a), c @ c, rtol=1e-13)
    sizes = vec.coordinate_sizes(frame, a)
    assert np.all(np.abs(np.asarray(c)) <= np.asarray(sizes))


def test_a_frame_may_have_no_vectors():
    frame = jnp.zeros((0, 2)), jnp.zeros((0, 3, 3))
    assert vec.flatten_frame(frame).shape == (0, 11)
    assert [leaf.shape for leaf in vec.orthonormalise(frame)] == [(0, 2), (0, 3, 3)]


@pytest.mark.parametrize("batch", [1, 100, 10_000])
@pytest.mark.parametrize("shape", [(5,), (3, 3)])
def test_the_size_of_what_is_not_a_number_is_none(batch, shape):
    # Thousands of maxima at once are compiled otherwise than a few, and passed over the entries that are NaN.
    a = np.arange(batch * np.prod(shape), dtype=float).reshape(batch, *shape)
    size = jax.jit(jax.vmap(lambda a: vec.size({"a": a - 1.0, "b": jnp.zeros(2)})))
    np.testing.assert_array_equal(size(a), np.max(np.abs(a - 1.0), axis=tuple(range(1, a.ndim))))
    for broken in (np.full_like(a, np.nan), np.where(a % np.prod(shape) == 2, np.nan, a)):
        assert np.all(np.isnan(size(broken)))


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
@pytest.mark.parametrize("index", [1, slice(1, None), None, [2, 0], np.array([True, False, True])], ids=str)
def test_entries_are_taken_from_every_array_as_numpy_arrays(kind, index):
    tree = {"a": np.arange(3.0), "b": (np.arange(12.0).reshape(3, 4),)}
    found = vec.taken(jax.tree.map(kind, tree), index)
    for leaf, whole in zip(jax.tree.leaves(found), jax.tree.leaves(tree), strict=True):
        assert isinstance(leaf, np.ndarray | np.generic)
        np.testing.assert_array_equal(leaf, whole[index])


def test_trees_are_joined_along_their_axes_and_stacked_along_a_new_one():
    trees = [{"a": np.full((k, 2), k), "b": np.full(k, -k)} for k in (1, 2, 3)]
    joined, stacked = vec.joined(trees), vec.stacked(3 * trees[:1])
    np.testing.assert_array_equal(joined["b"], [-1, -2, -2, -3, -3, -3])
    assert joined["a"].shape == (6, 2)
    assert stacked["a"].shape == (3, 1, 2)
    assert vec.joined(trees[:1]) is trees[0]


@pytest.mark.parametrize(("order", "reach"), [(2, 1), (4, 3), (6, 3), (6, 4), (8, 4)])
def test_a_central_difference_is_exact_for_polynomials_of_its_order_and_of_no_higher_odd_degree(order, reach):
    h, places = 0.25, 0.25 * central_nodes(reach)
    for degree in range(order + 1):
        values = np.stack([places**degree, 2 * places**degree], axis=1)
        found = central_difference(values, h, order)
        np.testing.assert_allclose(found, (degree == 1) * np.array([1.0, 2.0]), atol=1e-13)
        np.testing.assert_array_equal(found, central_difference(values.T, h, order, 1))
    assert abs(central_difference(places ** (order + 1), h, order)) > 1e-3 * h**order


def test_the_slope_of_errors_is_that_of_those_above_rounding():
    t = 2.0 ** -np.arange(6)
    errors = np.maximum(3 * t**2, 0.02)
    assert slope(t, errors, 0.02) == pytest.approx(2, abs=1e-12)
    assert slope(t, errors, 0.1) == pytest.approx(2, abs=1e-12)
    assert slope(t, errors, 0.5) == np.inf
    assert slope(t, errors, 0.5, 2) == pytest.approx(2, abs=1e-12)


def test_a_rank_counts_singular_values_above_a_limit_relative_to_the_largest_or_to_a_unit():
    matrix = np.diag([1e-3, 1e-6, 1e-12]) @ np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    assert numerical_rank(matrix).rank == 2
    assert numerical_rank(matrix, limit=1e-10).rank == 3
    assert numerical_rank(matrix, limit=1e-8, unit=1e3).rank == 1
    assert numerical_rank(matrix, limit=1e-2).rank == 1


def test_a_null_space_is_one_of_complex_matrices_too():
    draw = np.random.default_rng(1).standard_normal((2, 2, 4))
    matrix = draw[0] + 1j * draw[1]
    basis = null_space(matrix, limit=1e-10)
    assert basis.shape == (4, 2)
    np.testing.assert_allclose(matrix @ basis, 0.0, atol=1e-14)
    np.testing.assert_allclose(basis.conj().T @ basis, np.eye(2), atol=1e-14)


def test_options_that_the_compiler_does_not_know_are_left_out():
    known = {"xla_backend_optimization_level": "1"}
    assert known_options(known) == known
    assert known_options({**known, "xla_a_wish_that_nobody_has": True}) == known
