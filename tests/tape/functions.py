"""Functions that together use every primitive of the tape, with points at which naive rules divide by zero."""

import jax
import jax.numpy as jnp
import numpy as np
from retrax.compute.binding.tape_machine import MachineProgram
from retrax.manifolds.numerics.matrices import exponential

ZERO = np.zeros(3)
TABLE = jnp.array([0.2j, 0.5 + 1.0j, 0.3 - 2.0j])
SIDES = np.array([-1.0, 0.5, 2.0])
TIES = np.array([0.0, 1.0, -1.0])

# Smooth where they are sampled: compared with XLA in value, gradient and Hessian, at random points of (0, 1)^3.
SMOOTH = {
    "trigonometric": lambda x: jnp.sin(x) * jnp.cos(2 * x) + jnp.tan(x) / 3,
    "inverse trigonometric": lambda x: jnp.arcsin(x / 2) + jnp.arccos(x / 3) * jnp.arctan(x) + jnp.arctan2(x, 1 + x**2),
    "hyperbolic": lambda x: jnp.sinh(x) + jnp.cosh(x) * jnp.tanh(x),
    "inverse hyperbolic": lambda x: jnp.arcsinh(x) + jnp.arccosh(2 + x) * jnp.arctanh(x / 2),
    "exponential": lambda x: jnp.exp(x) * jnp.log(1 + x) + jnp.exp2(x) + jnp.expm1(x) * jnp.log1p(x),
    "logarithms": lambda x: jnp.log2(1 + x) * jnp.real(jnp.log2(1 + _pair(x)[0])),
    "roots": lambda x: jnp.sqrt(1 + x) + jax.lax.rsqrt(2 + x) + jnp.cbrt(1 + x) + jnp.square(x),
    "powers": lambda x: x**3 + (1 + x) ** 2.5 + x**-2 + (1 + x) ** x[0],
    "polynomials": lambda x: (
        jnp.polyval(jnp.array([2.0, 0.0, -1.0, 3.0]), x) * jnp.polyval(x, x[0])
        + jnp.polyval(jnp.array([3.0]), x)
        + jnp.real(jnp.polyval(_pair(x), 1 + 2j * x))
    ),
    "error function": jax.scipy.special.erf,
    "logistic": lambda x: jax.nn.sigmoid(x) + jax.nn.softplus(x) + jax.nn.silu(x) + jax.nn.softmax(x),
    "log-sum-exp": lambda x: jax.scipy.special.logsumexp(x) + jnp.logaddexp(x[0], x[1]),
    "sinc": jnp.sinc,
    "clip": lambda x: (
        jnp.clip(x, 0.2, 0.7) + jnp.minimum(x, 0.5) + jnp.maximum(x[0], x[1]) + jax.lax.clamp(0.1, x, 0.9)
    ),
    "rounding": lambda x: (
        x * (jnp.floor(3 * x) + jnp.ceil(3 * x) + jnp.round(3 * x) + jnp.trunc(3 * x) + jnp.sign(x - 0.5))
    ),
    "rounding away from zero": lambda x: x * jax.lax.round(3 * x, jax.lax.RoundingMethod.AWAY_FROM_ZERO),
    "remainder": lambda x: jnp.fmod(3 * x, 0.7) * x + jnp.remainder(-3 * x, 0.7),
    "choice": lambda x: jnp.where((x > 0.4) & ~(x >= 0.9) | (x[0] <= 0.1), x**2, jnp.sin(x)),
    "equal to one of them": lambda x: jnp.where(x == x[1], x**2, x) + jnp.where(x != x[2], jnp.sin(x), x),
    "switch": lambda x: jax.lax.switch((3 * x[0]).astype(int), [jnp.sin, jnp.cos, jnp.exp], x),
    "branch": lambda x: jax.lax.cond(x[0] != x[1], lambda x: x * x[2], jnp.sin, x),
    "is finite": lambda x: jnp.where(jnp.isfinite(x) & ~jnp.isnan(x) & jnp.logical_xor(x < 2, x == 2), x**2, 0.0),
    "scan": lambda x: (
        jax.lax.scan(lambda c, a: (c * a + 1, c), x[0], x)[1] + jax.lax.fori_loop(0, 3, lambda i, c: c * x[i], 1.0)
    ),
    "associative": lambda x: jnp.cumsum(x) * jnp.cumprod(1 + x) + jax.lax.cummax(x) * jax.lax.cummin(x),
    "indices": lambda x: x[::-1] * x[jnp.array([2, 0, 0])] + x.at[1].set(x[0]).at[2].add(x[1]).at[0].multiply(3.0),
    "indices of each row": lambda x: (
        jax.vmap(lambda row, i: row[i])(jnp.outer(x, x), jnp.array([2, 0, 1]))
        + jax.vmap(lambda row, i, a: row.at[i].set(a))(jnp.outer(x, x), jnp.array([2, 0, 1]), x)[1]
    ),
    "indices outside": lambda x: (
        x.at[jnp.array([0, 5, 1])].get(mode="fill", fill_value=2.0) * x.at[jnp.array([0, 7])].set(x[:2])
        + x.at[jnp.array([2, 7])].add(x[:2]) * x.at[jnp.array([0, 7])].set(x[1:], mode="clip")
    ),
    "updates where the input says": lambda x: (
        x.at[jnp.argmax(x)].set(x[1] ** 2) * x.at[jnp.argmin(x)].multiply(3 * x[0])
        + x.at[(4 * x[0]).astype(int)].add(x[2])
        + x.at[jnp.stack([jnp.argmin(x), jnp.argmax(x)])].max(0.3) * x.at[(4 * x[1]).astype(int)].set(0.1, mode="clip")
        + jnp.outer(x, x).at[jnp.argmax(x), jnp.argmin(x)].add(x[1] ** 3)[0]
    ),
    "indices of what is known": lambda x: (
        x * jax.lax.fori_loop(0, 3, lambda i, c: c.at[i].add(i + 1.0).at[0].multiply(2.0).at[1].max(c[0]), jnp.ones(3))
    ),
    "no indices": lambda x: x * (1 + jnp.sum(jax.vmap(lambda i: jnp.outer(x, x)[i])(jnp.zeros(0, int)), axis=0)),
    "extrema": lambda x: (
        x.at[0].min(x[1]).at[1].max(x[2]) + x[jnp.argmax(x)] * x[jnp.argmin(x)] + jnp.max(x) * jnp.min(x)
    ),
    "shapes": lambda x: jnp.pad(x, 1)[1:-1] * jnp.roll(x, 1) + jnp.tile(x, 2)[3:] + jnp.stack([x, x**2]).T[:, 1],
    "precision": lambda x: jax.lax.reduce_precision(jnp.stack(jnp.unstack(x)[::-1]), 11, 52) * x,
    "pieces": lambda x: jnp.concatenate([*jnp.split(x, 3)][::-1]) + jnp.array([*x])[::-1] + jnp.repeat(x, 2)[::2],
    "dynamic": lambda x: (
        jax.lax.dynamic_slice(x, ((2 * x[0]).astype(int),), (2,))[0] * jax.lax.dynamic_update_slice(x, x[:1], (2,))
        + jax.lax.dynamic_update_slice(x, x[:2] ** 2, ((2 * x[1]).astype(int),))
    ),
    "sums": lambda x: jnp.sum(jnp.outer(x, x), 0) * jnp.prod(x) + jnp.mean(x) + jnp.var(x),
    "truth": lambda x: (
        jnp.where(jnp.all(x > 0) | jnp.any(x < 0), x, -x) * x + jnp.where(jnp.array([True, False, True]), x, 0.0)
    ),
    "truth of numbers": lambda x: jnp.where(jax.lax.convert_element_type(jnp.floor(2 * x), bool), x, x**2),
    "products": lambda x: (
        jnp.einsum("i,ij,jk->k", x, jnp.outer(x, x), jnp.eye(3) * x) + jnp.cross(x, x**2) * jnp.dot(x, x)
    ),
    "batched products": lambda x: jnp.einsum(
        "bij,bj->i", jnp.stack([jnp.outer(x, x), jnp.eye(3)]), jnp.stack([x, x**2])
    ),
    "norm": lambda x: x / jnp.linalg.norm(x),
    "interpolation": lambda x: jnp.interp(3 * x, jnp.arange(4.0), jnp.array([0.0, 1.0, -1.0, 2.0])) * x,
    "solve": lambda x: jnp.linalg.solve(_matrix(x), x) + jnp.linalg.inv(_matrix(x))[0],
    "batched solve": lambda x: jnp.linalg.solve(jnp.stack([_matrix(x), _matrix(-x)]), jnp.stack([x, x**2])[..., None])[
        0, :, 0
    ],
    "determinant": lambda x: (
        jnp.linalg.det(_matrix(x)) * jnp.linalg.det(jnp.eye(4) + jnp.outer(jnp.tile(x, 2)[:4], jnp.ones(4)))
    ),
    "cholesky": lambda x: jnp.linalg.cholesky(jnp.eye(3) + jnp.outer(x, x))[2],
    "triangular": lambda x: jax.scipy.linalg.solve_triangular(_matrix(x), x, trans=1) + _right_sided(x),
    "qr": lambda x: jnp.linalg.qr(_matrix(x)[:, :2], mode="complete")[0][2] + jnp.linalg.qr(_matrix(x))[1][0],
    "stopped": lambda x: jax.lax.stop_gradient(x**2) * x,
    "gradient inside": lambda x: (
        jax.grad(lambda y: jnp.sum(y * y[0]) + jnp.sum(y**3) + jnp.sum(jnp.arcsin(y / 2)))(x)
        * jnp.searchsorted(x, 0.5, side="right")
        * (1 + jnp.searchsorted(x, 0.6))
    ),
    "own rule of a root": lambda x: _root(x) * x,
    "remat": lambda x: jax.checkpoint(jnp.sin)(x) * x,
    "relu": lambda x: jax.nn.relu(x - 0.5) + jax.nn.leaky_relu(x),
    "own rule": lambda x: _squared(x) + _cubed(x),
    "own rule without a slope": lambda x: _steps(x[0]) * x + _steps(x),
    "products of what is known": lambda x: (
        jnp.tensordot(jnp.arange(12.0).reshape(2, 2, 3), jnp.arange(12.0).reshape(3, 2, 2), ((2, 1), (0, 2)))[0, 0] * x
    ),
    "sums of what is known": lambda x: (
        x * jnp.sum(jnp.arange(6.0).reshape(2, 3), axis=0) / jnp.max(jnp.arange(4.0))
        + jnp.where(jnp.any(jnp.arange(3) > 1), jnp.min(jnp.arange(1.0, 5.0)) / 3.0, 0.0) * x**2
        + jnp.where(jnp.all(jnp.arange(3) > 1), 1.0, 2.0) * x**3
    ),
    "own rule of what is known": lambda x: (
        x * jax.lax.fori_loop(0, 3, lambda i, c: c + _squared(i + 1.0) / (i + 2.0) ** 2, 0.0)
    ),
    "whole numbers": lambda x: x * ((5 * x).astype(int) // 2 + (7 * x).astype(int) % 3),
    "complex": lambda x: _complex(x),
    "complex roots": lambda x: _both(jnp.sqrt(_around(x)) + jax.lax.rsqrt(_around(x)[::-1])),
    "roots of negative numbers": lambda x: jnp.imag(jnp.sqrt((x - 2).astype(complex))),
    "complex trigonometric": lambda x: _both(
        jnp.sin(_around(x)) * jnp.cos(2 * _around(x)) + jnp.tan(1 - _around(x)[::-1])
    ),
    "complex hyperbolic": lambda x: _both(
        jnp.sinh(_around(x)) * jnp.cosh(2 * _around(x)) + jnp.tanh(1 - _around(x)[::-1])
    ),
    "complex exponentials": lambda x: _both(
        jnp.expm1(_around(x)) * jnp.log1p(2 * _around(x)) + jnp.exp2(_around(x)) * jax.nn.sigmoid(3 * _around(x))
    ),
    "complex sums and products": lambda x: (
        _both(jnp.cumsum(_pair(x)) * jnp.cumprod(_around(x)) + jnp.prod(_around(x)))
        + _both(jax.lax.cumsum(_pair(x), reverse=True) * jax.lax.cumprod(_around(x), reverse=True))
        + _both(jnp.prod(_around(x)[:, None] * jnp.outer(_pair(x), _around(x)), axis=0))
    ),
    "complex with a number as part": lambda x: jnp.real(
        jnp.outer(jax.lax.complex(x, 0.0), 1j * x) @ jax.lax.complex(x, 2.0)
    ),
    "complex entries": lambda x: jnp.real(
        _pair(x)[(2 * x[0]).astype(int)] * jnp.concatenate([_pair(x), x, 1j * x])[2:5] * jax.lax.stop_gradient(_pair(x))
    ),
    "loops over known complex numbers": lambda x: (
        _both(jax.lax.scan(lambda c, k: (c + k * x, c), x + 0j, TABLE)[1][-1])
        + _both(jax.lax.scan(lambda c, k: (c * k + 1, c), 1j, TABLE)[0]) * x
        + _both(jax.lax.map(lambda k: k * k, TABLE)) * x**2
        + _both(jax.lax.fori_loop(0, 3, lambda k, c: c * TABLE[k] + x, x + 0j))
    ),
    "known complex polynomials": lambda x: (
        _both(jnp.polyval(TABLE, x)) + _both(jnp.polyval(TABLE, (1 + 2j) * x)) + _both(jnp.polyval(TABLE, 1j)) * x
    ),
    "interpolation of complex numbers": lambda x: _both(jnp.interp(2 * x, jnp.arange(3.0), TABLE)),
    "known complex entries where the input says": lambda x: (
        _both(jnp.take(TABLE, _place(x)) + TABLE[jnp.argmax(x)]) * x
        + _both(jax.lax.dynamic_slice(TABLE, (_place(x),), (2,))[1]) * x**2
        + _both(TABLE[jnp.stack([_place(x), 1, jnp.argmin(x)])] * jnp.outer(TABLE, TABLE)[_place(x)]) * x
    ),
    "known complex choices": lambda x: (
        _both(jax.lax.switch(_place(x), [lambda: TABLE, lambda: 1j * TABLE, lambda: TABLE**2])) * x
        + _both(jnp.where(x > 0.5, TABLE, TABLE**2) * jnp.where(x < 0.3, TABLE, 1j * x))
    ),
    "updates of known complex numbers": lambda x: (
        _both(jax.lax.dynamic_update_slice(TABLE, 3 * TABLE[:1], (_place(x),))) * x
        + _both(jax.lax.dynamic_update_slice(TABLE, 3j * x[:1], (_place(x),)))
        + _both(TABLE.at[_place(x)].set(4j) + TABLE.at[_place(x)].add(1j * x[1])) * x
    ),
    "loops over known whole numbers": lambda x: (
        x * jax.lax.scan(lambda c, k: (c, k - 1), 0, jnp.array([0, 1, 5], jnp.uint8))[1] / 255
        + x**2 * jax.lax.scan(lambda c, k: (c ^ k, (k & 6) | ~c), 3, jnp.array([2, 9, 5]))[1]
        + x**3 * jax.lax.map(lambda k: (k << 2) >> 1, jnp.array([2, 1, 3]))
    ),
    "loops over known numbers": lambda x: x * jax.lax.map(jax.lax.lgamma, jnp.array([2.5, 0.3, 4.0])),
    "complex powers": lambda x: _both(
        _around(x) ** 0.5 + _around(x) ** _pair(x) + (1 + 2j) ** _around(x) + _around(x) ** (x - 0.5)
    ),
    "whole complex powers": lambda x: _both(
        _around(x) ** jnp.array([0.0, 2.0, -3.0]) + _around(x) ** jnp.array([1, 2, 70])
    ),
    "complex solve": lambda x: jnp.real(jnp.linalg.solve(_matrix(x) + 1j * jnp.eye(3), x * (1 + 2j))),
}

# Where x^2/|x| and the like would divide by zero, and where functions have kinks, as many times as JAX gives
# derivatives there.
SPECIAL = {
    "zero of sinc": (jnp.sinc, ZERO),
    "zero of logistic": (lambda x: jax.nn.sigmoid(x) + jax.nn.softplus(x), ZERO),
    "far logistic": (lambda x: jax.nn.sigmoid(1e3 * x), TIES),
    "kinks": (lambda x: jnp.abs(x) + jnp.maximum(x, -x) + jnp.minimum(x, 1.0) + jax.nn.relu(x), TIES),
    "zero of a complex size": (lambda x: jnp.abs(_complex(x)) ** 3 + x, ZERO),
    "zero of a complex root": (lambda x: _both(jnp.sqrt(jnp.sum(_pair(x)))) * jnp.ones(3), ZERO),
    "complex roots on the real axis": (
        lambda x: _both(jnp.sqrt(_on_the_axis(x)) + jax.lax.rsqrt(_on_the_axis(x)) ** 2 * x),
        SIDES,
    ),
    "complex numbers next to zero": (
        lambda x: 1e9 * _both(jnp.expm1(_small(x)) + jnp.log1p(2 * _small(x)) + jnp.tanh(_small(x)) * x),
        SIDES,
    ),
    "complex logarithm next to zero": (lambda x: _both(jnp.log1p(_small(x) - 1)), SIDES),
    "far complex tangents": (
        lambda x: _both(jnp.tanh(1e3 * _pair(x)) + jnp.tan(2e3 * _pair(x)) + jax.nn.sigmoid(1e3 * _pair(x))),
        1 / SIDES,
    ),
    "zero of complex tangents": (lambda x: _both(jnp.tanh(_pair(x)) + jnp.tan(_pair(x)) + jnp.sinh(_pair(x))), ZERO),
    "zero powers": (lambda x: x**2 + x**3 + x**0 + x**2.0, ZERO),
    "zero to a power that varies": (lambda x: x ** (2.5 + x[::-1]) + 0.0 ** (1 + x) + (1 + x) ** x, ZERO),
    "zero of complex powers": (lambda x: _both(_pair(x) ** 2.5 + jax.lax.pow(_pair(x), jnp.full(3, 3.0 + 0j))), ZERO),
    "complex powers on the real axis": (lambda x: _both(_on_the_axis(x) ** 1.5 + _on_the_axis(x) ** (0.5 + 1j)), SIDES),
    "several that are equal": (
        lambda x: x * jnp.max(x) + jnp.linalg.norm(x, jnp.inf) + jnp.min(jnp.stack([x, 1 + x, x * x, x, x]), axis=0),
        0.1 + 0 * ZERO,
    ),
    "between limits that are equal": (
        lambda x: jax.lax.clamp(-1.0, x, 1.0) + x * jax.lax.clamp(x[::-1], x**2, 2 * x) + jax.lax.clamp(3.0, x, -x),
        TIES,
    ),
    "guarded": (lambda x: jnp.where(x == 0, 1.0, jnp.sin(jnp.where(x == 0, 1.0, x)) / jnp.where(x == 0, 1.0, x)), ZERO),
    "guarded norm": (lambda x: x * jnp.where(x @ x == 0, 0.0, jnp.sqrt(jnp.where(x @ x == 0, 1.0, x @ x))), ZERO),
    "pivots": (lambda x: jnp.linalg.solve(jnp.array([[0.0, 1.0, 0.0], [1.0, 0, 0], [0, 0, 1]]) + x[0], 1 + x), ZERO),
    "NaN in the entries of what is known": (lambda x: _turned(x), SIDES),
    "zero or infinite": (lambda x: jnp.where(x < 3, 0.0, -jnp.inf) * x**2 + x * jnp.where(x > 3, jnp.inf, 0.0), SIDES),
    "NaN in the branch that is not taken": (lambda x: jnp.where(x > 0, jnp.log(x), 0.0) * x[::-1] ** 2, SIDES),
    "truth as a factor": (lambda x: (x > 0) * jnp.log(x) * x[::-1] ** 2, SIDES),
    "triangular qr": (lambda x: jnp.linalg.qr(jnp.triu(_matrix(x)))[1][0], ZERO),
}


def _both(z):
    """A real number that shows either part of a complex one."""
    return jnp.real(z) + 2 * jnp.imag(z)


def _turned(x):
    """A derivative of the exponential of a skew matrix, which is NaN, also on the diagonal, if this is too large."""

    def turn(x):
        a = jnp.outer(x, x[::-1] ** 2)[:2, :2]
        return exponential(a - a.T)

    return jax.jvp(turn, (x,), (x[::-1],))[1].reshape(-1)[:3]


def _place(x):
    return (3 * x[0]).astype(int)


def _matrix(x):
    return jnp.eye(3) * 2 + jnp.outer(x, x[::-1]) + jnp.array([[0.0, 1.0, -1.0], [0.5, 0.0, 0.3], [0.2, 0.1, 0.0]])


def _right_sided(x):
    return jax.lax.linalg.triangular_solve(_matrix(x), x[None], left_side=False, lower=True, unit_diagonal=True)[0]


def _root(x):
    """The roots ``y`` of ``y + y^3 = x``, whose derivatives are those of the implicit function theorem."""

    def solve(f, y):
        return jax.lax.stop_gradient(jax.lax.fori_loop(0, 9, lambda i, y: y - f(y) / (1 + 3 * y**2), y))

    return jax.lax.custom_root(lambda y: y + y**3 - x, x, solve, lambda g, y: y / g(jnp.ones_like(y)))


def _pair(x):
    return jax.lax.complex(x, x[::-1])


def _around(x):
    """Complex numbers around zero."""
    return 2 * _pair(x) - (1 + 0.9j)


def _on_the_axis(x):
    return jax.lax.complex(x, (x - SIDES)[::-1])


def _small(x):
    return 2.0**-30 * _pair(x)


def _complex(x):
    z = _pair(x)
    w = jnp.conj(z) * jnp.exp(z) / (1 + z**2) - jnp.square(z) + z**-1 + jnp.log(2 + z)
    turned = jnp.where(x > 0.5, w, -z) @ jnp.outer(z, jnp.conj(z))
    return (
        jnp.real(turned) * jnp.imag(jnp.sum(w)) + jnp.abs(z) + jnp.angle(1 + z) * (z != w) + jnp.where(z == z, x, 0.0)
    )


@jax.custom_jvp
def _squared(x):
    return x * x


@_squared.defjvp
def _squared_jvp(primals, tangents):  # a rule that asks for the function itself, and has a slope of its own
    (x,), (t,) = primals, tangents
    return _squared(x), 3 * t * jnp.sqrt(_squared(x))


@jax.custom_vjp
def _cubed(x):
    return x**3


_cubed.defvjp(lambda x: (x**3, x), lambda x, t: (3 * t * x**2,))


@jax.custom_jvp
def _steps(x):
    return jnp.floor(3 * x)


_steps.defjvp(lambda primals, tangents: (_steps(*primals), jnp.zeros_like(*primals)))


def run_alone(program, inputs):
    """The values of a program at one point, by the core."""
    arrays = program.codes, program.registers, program.values
    own, values = MachineProgram(*arrays, program.inputs, program.outputs, program.size), np.zeros(program.outputs)
    sources, targets = (np.stack([np.arange(n), np.zeros(n, int)], axis=1) for n in (inputs.size, values.size))
    own.run(range(1), (inputs, sources, values, targets), 1)
    return values
