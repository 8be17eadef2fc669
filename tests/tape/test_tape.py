"""The tape as its users meet it: arguments, results, derivatives, exports, and what it refuses."""

import itertools
import os
import shutil
import subprocess
from ctypes import CDLL
from functools import cache

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute import threads
from retrax.manifolds import SE, SO, SU, Hyperbolic, InvalidInputError, Oblique, Sphere, Stiefel
from retrax.retractions import QR, Cayley, Exponential, Polar, Projection
from retrax.tape import NotTraceableError, Tape
from retrax.tape.arrays import column
from retrax.tape.instructions import NAMES
from retrax.tape.program import FUSED_SUMS, assemble

from tests.support.numerics import compiled

from .functions import run_alone

REMARKABLE = {
    "exponential of SO(3)": Exponential(SO(3)),
    "Cayley of SE(3)": Cayley(SE(3)),
    "Cayley of SU(4)": Cayley(SU(4)),
    "projection of S2": Projection(Sphere(2)),
    "exponential of H2": Exponential(Hyperbolic(2)),
    "exponential of SU(2)": Exponential(SU(2)),
    "oblique": Projection(Oblique(3, 2)),
    "QR of St(4, 2)": QR(Stiefel(4, 2)),
}
ROTOR = np.array([0.3, -0.2, 0.9])


def rotor(data):
    """A pytree in, a pytree out."""
    w, (inertia, step) = data
    return {"torque": jnp.cross(w, inertia * w) * step, "energy": w @ (inertia * w) / 2}


def sample(count):
    draw = np.random.default_rng(1).random
    return draw((3, count)), (1 + draw((3, count)), draw(count))


COUNTS = [0, 1, 2, 7, 8, 9, 64, 255, 256, 257, 520]


@cache
def rotors():
    """The values at the most points, by XLA."""
    return compiled(jax.vmap(rotor, ((-1, (-1, -1)),), -1))(sample(COUNTS[-1]))


@pytest.mark.parametrize("count", COUNTS)
def test_any_number_of_points(count):
    data, expected = (jax.tree.map(lambda a: a[..., :count].copy(), of) for of in (sample(COUNTS[-1]), rotors()))
    values = Tape.trace(rotor, (ROTOR, (ROTOR, 0.1)))(data)
    assert jax.tree.structure(values) == jax.tree.structure(expected)
    # Differences of products of numbers near one, whose rounding depends on whether a processor forms both at once.
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-15), values, expected)


@cache
def drawn(manifold):
    """A point and a short tangent vector there."""

    def draw(point, vector):
        x = manifold.random_point(point)
        return x, jax.tree.map(lambda a: 0.1 * a, manifold.random_tangent(vector, x))

    return compiled(draw)(jax.random.key(0), jax.random.key(1))


@pytest.mark.parametrize("name", REMARKABLE)
def test_instructions_in_groups_compute_the_same(name):
    """As many points at once, and as one; the number of changes from one instruction to another falls."""
    retraction = REMARKABLE[name]
    x, v = drawn(retraction.manifold)
    tape = Tape.trace(retraction, x, v)
    column = ca.vertcat(tape.graph.resolve_marks([tape.outputs])[0])
    plain, grouped = (assemble(tape.inputs, column, window=w) for w in (1, None))
    changes = [np.count_nonzero(np.diff(p.codes)) for p in (plain, grouped)]
    assert changes[1] < 0.75 * changes[0]
    parts = [part for a in map(np.asarray, (x, v)) for part in ((a.real, a.imag) if np.iscomplexobj(a) else (a,))]
    inputs = np.concatenate([part.ravel() for part in parts])
    values = [run_alone(p, inputs) for p in (plain, grouped)]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-14, atol=1e-15)
    expected = tape(*(np.asarray(a)[..., None] for a in (x, v)))
    halves = (expected.real, expected.imag) if np.iscomplexobj(expected) else (expected,)
    np.testing.assert_allclose(values[1], np.concatenate([h.ravel() for h in halves]), rtol=1e-14, atol=1e-15)


def test_sums_of_any_number_of_products():
    """The machine forms several at once: sums of each length, which have nothing in common, with any signs."""

    def sums(x, y):
        found = []
        for length, signs in itertools.product(range(1, 9), itertools.product((1, -1), repeat=3)):
            terms = [x[k] * y[len(found) + k] for k in range(length)]
            total = signs[0] * x[0] + y[len(found)] * signs[1] if length % 2 else terms.pop(0)
            for k, term in enumerate(terms):
                total = signs[k % 3] * term + total
            found.append(signs[2] * y[-1] * x[1] + (total + x[2]) if length % 3 else total)
        return jnp.stack(found)

    draw = np.random.default_rng(5).standard_normal
    x, y = draw((9, 20)), draw((80, 20))
    tape = Tape.trace(sums, x[:, 0], y[:, 0])
    names = {NAMES[code] for code in tape.program.codes}
    assert names >= {"MUL_ADD", "SUB_MUL", *FUSED_SUMS.values()}
    np.testing.assert_allclose(tape(x, y), jax.vmap(sums, (-1, -1), -1)(x, y), atol=1e-13)


def test_threads_change_nothing(monkeypatch):
    data = sample(1000)
    tape = Tape.trace(rotor, (ROTOR, (ROTOR, 0.1)))
    alone = tape(data)
    monkeypatch.setattr(threads, "WORTH_A_THREAD", 1)
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    jax.tree.map(np.testing.assert_array_equal, tape(data), alone)


@pytest.mark.parametrize("name", REMARKABLE)
@pytest.mark.usual("projection of S2", "exponential of SO(3)", "Cayley of SE(3)")
def test_retractions_of_closed_form(name):
    retraction = REMARKABLE[name]
    manifold = retraction.manifold

    def chart(x, c):
        return retraction.chart(x, retraction.frame(x), c)

    x, _ = drawn(manifold)
    tape = Tape.trace(chart, x, np.zeros(manifold.dimension))
    c = 0.3 * np.random.default_rng(2).standard_normal((manifold.dimension, 4))
    expected = compiled(jax.vmap(chart, (None, -1), -1))(x, c)
    points = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[..., None], 4, -1), x)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-14), tape(points, c), expected)


def test_jacobian_is_of_all_values_by_all_arguments():
    tape = Tape.trace(lambda x, a: (jnp.outer(a, x), a * 2), np.ones(2), np.ones(2))
    x, a = np.array([1.0, 2.0]), np.array([3.0, 4.0])
    expected = np.zeros((6, 4))
    for i in range(2):
        for j in range(2):
            expected[2 * i + j, j], expected[2 * i + j, 2 + i] = a[i], x[j]
        expected[4 + i, 2 + i] = 2
    np.testing.assert_array_equal(tape.jacobian()(x[:, None], a[:, None])[..., 0], expected)


@jax.custom_jvp
def steep(x):
    """A sine with three times its derivative."""
    return jnp.sin(x)


@steep.defjvp
def _(primals, tangents):
    return steep(primals[0]), 3 * jnp.cos(primals[0]) * tangents[0]


def test_derivatives_go_through_derivatives_of_ones_own():
    """Of a function in a function, and beside what has the usual ones, in both modes and twice."""

    def values(x):
        return steep(x * steep(x)) + x**2

    def total(x):
        return jnp.sum(values(x))

    x, direction = np.array([0.3, -0.7, 1.1]), np.array([0.2, 1.0, -0.4])
    by_xla = compiled(lambda x, v: jax.jvp(values, (x,), (v,))[1])
    found = {
        "jacobian": (Tape.trace(values, x).jacobian()(x[:, None]), compiled(jax.jacfwd(values))(x)),
        "push": (Tape.trace(values, x).push(0)(x[:, None], direction[:, None]), by_xla(x, direction)),
        "gradient": (Tape.trace(total, x).gradient()(x[:, None]), compiled(jax.grad(total))(x)),
        "hessian": (Tape.trace(total, x).hessian()(x[:, None]), compiled(jax.hessian(total))(x)),
    }
    for name, (mine, expected) in found.items():
        np.testing.assert_allclose(mine[..., 0], expected, atol=1e-13, err_msg=name)


@pytest.mark.parametrize("size", [1, 2])
def test_derivatives_by_some_arguments(size):
    def function(x, a, z):
        return jnp.sum(a[0] * x**2) + jnp.sum(a[1] * x) + jnp.sum(jnp.abs(z) ** 2)

    x, a, z = np.arange(1.0, size + 1), (np.full(size, 3.0), np.full(size, 4.0)), np.full(size, 1 + 2j)
    data = jax.tree.map(lambda leaf: leaf[..., None], (x, a, z))
    tape = Tape.trace(function, x, a, z)
    value, slope, curvature = (part[..., 0] for part in tape.second_order(0)(*data))
    assert value == function(x, a, z)
    np.testing.assert_array_equal(slope, 2 * a[0] * x + a[1])
    np.testing.assert_array_equal(curvature, np.diag(2 * a[0]))
    np.testing.assert_array_equal(tape.gradient((0, 1))(*data)[..., 0], [*slope, *x**2, *x])
    np.testing.assert_array_equal(tape.gradient(2)(*data)[..., 0], [*2 * z.real, *2 * z.imag])
    np.testing.assert_array_equal(tape.jacobian(1)(*data)[..., 0], [[*x**2, *x]])
    assert tape.gradient()(*data).shape == (5 * size, 1)


def test_casadi_function_is_the_same_function():
    function = Tape.trace(rotor, (ROTOR, (ROTOR, 0.1))).to_casadi("rotor")
    energy, torque = (np.array(part).ravel() for part in function(ROTOR, 1 + ROTOR, 0.5))
    expected = rotor((ROTOR, (1 + ROTOR, 0.5)))
    np.testing.assert_allclose(energy, expected["energy"], rtol=1e-15)
    np.testing.assert_allclose(torque, expected["torque"], rtol=1e-15)


def test_casadi_computes_once_what_several_values_share():
    tape = Tape.trace(lambda x: jnp.stack([jnp.sin(x[0]) * x[1], jnp.sin(x[0]) + x[2]]), ROTOR)
    function = tape.to_casadi()
    sines = [k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_SIN]
    assert len(sines) == 1


def test_c_code_compiles_and_gives_the_same_values(tmp_path):
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    source = tmp_path / "rotor.c"
    source.write_text(Tape.trace(rotor, (ROTOR, (ROTOR, 0.1))).c_code("rotor"))
    assert "int rotor(const casadi_real** arg" in source.read_text()
    if compiler:
        subprocess.run([compiler, "-shared", "-fPIC", "-o", tmp_path / "rotor.so", source, "-lm"], check=True)
        assert CDLL(str(tmp_path / "rotor.so")).rotor_n_in() == 3
        energy, _ = ca.external("rotor", str(tmp_path / "rotor.so"))(ROTOR, 1 + ROTOR, 0.5)
        assert float(energy) == pytest.approx(float(rotor((ROTOR, (1 + ROTOR, 0.5)))["energy"]), rel=1e-15)


@jax.custom_jvp
def turned(z):
    return 1j * z


turned.defjvp(lambda primals, tangents: (turned(*primals), 1j * tangents[0]))


# By the names of the primitives, and what else is said.
UNTRACEABLE = {
    "eigh": lambda x: jnp.linalg.eigh(jnp.outer(x, x))[0],
    "while": lambda x: jax.lax.while_loop(lambda c: c[0] < 3, lambda c: c * 2, x),
    "svd": lambda x: jnp.linalg.svd(jnp.outer(x, x), compute_uv=False),
    "sort": jnp.sort,
    "pure_callback": lambda x: jax.pure_callback(np.sin, x, x),
    "erfc": jax.scipy.special.erfc,
    "scan": lambda x: jax.lax.fori_loop(0, 5000, lambda i, c: c * x, x),
    "cholesky": lambda x: jnp.linalg.cholesky(jnp.eye(20) * x[0]),
    "cholesky of complex numbers": lambda x: jnp.linalg.cholesky(jnp.eye(3) + jnp.outer(1j * x, -1j * x)),
    "qr with pivoting": lambda x: jax.scipy.linalg.qr(jnp.eye(3) + jnp.outer(x, x), pivoting=True)[1],
    "while with more than 1000 iterations": lambda x: jax.lax.while_loop(
        lambda c: c[0] < 1001, lambda c: (c[0] + 1, c[1] * x), (0, x)
    )[1],
    "asin which has no rule for complex numbers": lambda x: jnp.arcsin(1j * x),
    "reduce_max of complex numbers": lambda x: jnp.max(1j * x),
    "cummax of complex numbers": lambda x: jax.lax.cummax(1j * x),
    "custom_jvp_call of complex numbers": lambda x: turned(1j * x),
    "and on the bits of whole numbers": lambda x: (3 * x).astype(int) & 1,
}


@pytest.mark.parametrize("name", UNTRACEABLE)
def test_what_is_not_scalars_is_refused_by_the_name_of_the_primitive(name):
    primitive, _, more = name.partition(" ")
    with pytest.raises(NotTraceableError, match=f"traced to scalars.*{more}") as caught:
        Tape.trace(UNTRACEABLE[name], np.ones(3))
    assert caught.value.primitive == primitive


def test_a_complex_number_that_becomes_a_real_one_loses_its_imaginary_part():
    def real(x):
        return jax.lax.convert_element_type((1 + 2j) * x, float) + x

    with pytest.warns(np.exceptions.ComplexWarning, match="discards the imaginary part"):
        tape = Tape.trace(real, np.ones(3))
    np.testing.assert_allclose(tape(np.full((3, 2), 1.5)), 3.0)


def test_complex_numbers_stay_complex():
    table = jnp.array([1 + 2j, 3j, -1.0])

    def values(x):
        return table, table[0], 1j * x[0], table[jnp.argmax(x)]

    points = np.random.default_rng(2).normal(size=(3, 4))
    tape = Tape.trace(values, points[:, 0])
    for found, expected in zip(tape(points), jax.vmap(values, -1, -1)(points), strict=True):
        assert np.iscomplexobj(found)
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(InvalidInputError, match="of a real array, got a complex one"):
        tape(points + 1j)
    with pytest.raises(TypeError, match="expected a real array, got a complex one"):
        column(np.array([1.0, 1j]))


def test_a_loop_is_written_out_as_long_as_its_length_is_known():
    # The number of iterations of one loop grows from those that are written out to those that are not.
    def powers(count):
        return lambda x: jax.lax.fori_loop(0, count, lambda i, c: c * x, jnp.ones(3))

    for count in (1, 999, 1000):
        np.testing.assert_allclose(Tape.trace(powers(count), np.ones(3))(np.ones((3, 1)) * 1.001)[:, 0], 1.001**count)
    with pytest.raises(NotTraceableError, match="1001 iterations"):
        Tape.trace(powers(1001), np.ones(3))
    known = Tape.trace(
        lambda x: jax.lax.while_loop(lambda c: c[0] < 5, lambda c: (c[0] + 1, c[1] * x), (0, x))[1], np.ones(3)
    )
    np.testing.assert_allclose(known(np.full((3, 1), 2.0)), 2.0**6)


def test_arguments_of_other_shapes_are_refused():
    tape = Tape.trace(rotor, (ROTOR, (ROTOR, 0.1)))
    with pytest.raises(InvalidInputError, match="points"):
        tape((ROTOR, (ROTOR, 0.1)))
    with pytest.raises(InvalidInputError, match="of one length"):
        tape((np.ones((3, 2)), (np.ones((3, 2)), np.ones(3))))
    with pytest.raises(InvalidInputError, match=r"got arguments of shapes \(\(3, 2\),\)"):
        tape(np.ones((3, 2)))
    with pytest.raises(InvalidInputError, match="arrays of numbers as arguments, got one of object"):
        tape((np.ones((3, 2)), (np.ones((3, 2)), np.array([None, None]))))
    with pytest.raises(InvalidInputError, match="jacobian"):
        tape.gradient()
    with pytest.raises(InvalidInputError, match="argument 0 has 3 arrays"):
        tape.push(0)


def test_arrays_of_all_kinds_of_numbers_are_taken():
    tape = Tape.trace(lambda x: 2 * x, jnp.ones(2, jnp.bfloat16))
    for kind in (jnp.bfloat16, np.float32, np.int8, np.uint64, bool):
        np.testing.assert_array_equal(tape(jnp.ones((2, 3)).astype(kind)), np.full((2, 3), 2.0))


def test_parts_of_complex_numbers_do_not_mix():
    found = Tape.trace(lambda x: jax.lax.complex(x, 1 / x), 1.0)(np.array([0.0, 2.0]))
    np.testing.assert_array_equal([found.real, found.imag], [[0.0, 2.0], [np.inf, 0.5]])


def test_places_of_arguments_are_those_of_jax():
    def power(x, y):
        return y * (x @ x)

    tape, at = Tape.trace(power, np.zeros(3), 0.0), (np.ones((3, 1)), np.array([2.0]))
    for places in (0, 1, -1, -2, np.int64(1), [-1], (0, 1), (1, -2)):
        sides = sorted({np.arange(2)[k] for k in np.ravel(places)})
        expected = jax.grad(power, sides)(np.ones(3), 2.0)
        np.testing.assert_array_equal(tape.gradient(places)(*at)[:, 0], np.hstack(expected))
    np.testing.assert_array_equal(tape.push(-1)(*at, at[1]), [[6.0]])
    for wrong in (2, -3, (0, 7), "x", 0.5, [None]):
        with pytest.raises(InvalidInputError, match="argnums must be the place of one of 2 arguments"):
            tape.jacobian(wrong)


@pytest.mark.parametrize(
    ("function", "example", "words"),
    [
        (
            lambda x: np.sin(x),
            1.0,
            r"in line \d+ of .*test_tape.py \(TracerArrayConversionError\); try functions written",
        ),
        (lambda x: x if x > 0 else -x, 1.0, "jnp.where instead of if"),
        (lambda x: x[x > 0], np.ones(2), "NonConcreteBooleanIndexError"),
        (3, 1.0, "of a function, got 3"),
        (lambda x: x, "a", "arrays of numbers as arguments"),
    ],
)
def test_what_jax_cannot_trace_is_refused_in_words(function, example, words):
    with pytest.raises(InvalidInputError, match=words):
        Tape.trace(function, example)


@pytest.mark.slow
def test_a_polar_retraction_of_frames_names_what_decided():
    with pytest.raises(NotTraceableError, match="svd"):
        Tape.trace(Polar(Stiefel(4, 2)), *(np.eye(4)[:, :2],) * 2)
