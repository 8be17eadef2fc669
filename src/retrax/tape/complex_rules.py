"""Functions of complex numbers as pairs of real columns of scalars."""

import casadi as ca
import numpy as np

from .choice import select

Pair = tuple[ca.SX, ca.SX]
COMPLEX_ONE: Pair = ca.SX.ones(1), ca.SX.zeros(1)
LARGEST_PRODUCT = 64  # the exponent up to which a power is a product


def total(x: Pair, y: Pair) -> Pair:
    """Sum."""
    return x[0] + y[0], x[1] + y[1]


def product(x: Pair, y: Pair) -> Pair:
    """Product of complex numbers."""
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


def quotient(x: Pair, y: Pair) -> Pair:
    """Quotient of complex numbers."""
    square = y[0] * y[0] + y[1] * y[1]
    a, b = product(x, (y[0], -y[1]))
    return a / square, b / square


def whole_power(x: Pair, exponent: int) -> Pair:
    """The power with an exponent that is not negative."""
    value = None
    for bit in bin(exponent)[2:]:
        value = None if value is None else product(value, value)
        if bit == "1":
            value = x if value is None else product(value, x)
    return (ca.SX.ones(*x[0].shape), ca.SX.zeros(*x[0].shape)) if value is None else value


def size(x: Pair) -> ca.SX:
    """The absolute value of a pair, which has no derivative at zero, as in JAX."""
    square = x[0] * x[0] + x[1] * x[1]
    return select(square > 0, ca.sqrt(select(square > 0, square, 1.0)), square)


def _constant(x: ca.SX) -> ca.SX:
    """Numbers without derivatives: 2^600 times a number of at least 2^-548 is a whole number, which ``floor`` keeps."""
    return ca.floor(x * 2.0**600) * 2.0**-600


def exponential(x: Pair) -> Pair:
    """The exponential."""
    length = ca.exp(x[0])
    return length * ca.cos(x[1]), length * ca.sin(x[1])


def exponential_less_one(x: Pair) -> Pair:
    """``exp(x) - 1`` with all digits next to zero."""
    half = ca.sin(x[1] / 2)
    return ca.expm1(x[0]) * ca.cos(x[1]) - 2 * half * half, ca.exp(x[0]) * ca.sin(x[1])


def logarithm_of_one_more(x: Pair) -> Pair:
    """``log(1 + x)`` with all digits next to zero, and next to -1."""
    more = x[0] * (2 + x[0]) + x[1] * x[1]  # |1 + x|^2 - 1
    near = ca.fabs(more) < 0.5
    length = ca.hypot(select(near, 1.0, 1 + x[0]), select(near, 0.0, x[1]))
    return select(near, ca.log1p(select(near, more, 0.0)) / 2, ca.log(length)), ca.atan2(x[1], 1 + x[0])


def _magnitude(x: ca.SX) -> ca.SX:
    """The absolute value, with the derivative one at zero."""
    return select(x < 0, -x, x)


def logistic(x: Pair) -> Pair:
    """``1 / (1 + exp(-x))``; only the exponential of what is not positive is computed."""
    decay = ca.exp(-_magnitude(x[0]))
    a, b = decay * ca.cos(x[1]), decay * ca.sin(x[1])
    square = (1 + a) * (1 + a) + b * b
    return select(x[0] < 0, decay * decay + a, 1 + a) / square, b / square


def hyperbolic_tangent(x: Pair) -> Pair:
    """Both parts with numerator and denominator times ``4 exp(-2 |x|)``: nothing overflows, nothing cancels."""
    double = -2 * _magnitude(x[0])
    decay, less = ca.exp(double), ca.expm1(double)
    sine, cosine = ca.sin(x[1]), ca.cos(x[1])
    square = less * less + 4 * decay * cosine * cosine
    real = -less * (2 + less) / square
    return select(x[0] < 0, -real, real), 4 * decay * sine * cosine / square


def tangent(x: Pair) -> Pair:
    """``-i tanh(i x)``."""
    a, b = hyperbolic_tangent((-x[1], x[0]))
    return b, -a


def _root(x: Pair, below: ca.SX) -> Pair:
    """The root whose real part is not negative; on the negative real axis that below it, where this is asked for."""
    larger = ca.sqrt((ca.hypot(*x) + _magnitude(x[0])) / 2)
    smaller = select(larger > 0, x[1] / (2 * select(larger > 0, larger, 1.0)), larger)
    side = select(below, -1.0, 1.0)
    return select(x[0] < 0, side * smaller, larger), select(x[0] < 0, side * larger, smaller)


def root(x: Pair) -> Pair:
    """The square root, as XLA has it: a zero has no sign."""
    return _root(x, x[1] < 0)


def inverse_root(x: Pair) -> Pair:
    """One by the square root, as XLA has it: below the negative real axis where the imaginary part is -0."""
    a, b = _root(x, ca.atan2(x[1], x[0]) < 0)
    length = ca.hypot(*x)
    return a / length, -b / length


def complex_power(x: Pair, y: Pair) -> Pair:
    """``x`` to the power ``y``: a product, or its inverse, where the exponent is a small whole number that is known."""
    count = max(x[0].shape[0], y[0].shape[0])
    bases, exponents = ([(a[k], b[k]) for k in range(count)] for a, b in (_rows(x, count), _rows(y, count)))
    found = [_scalar_power(a, b) for a, b in zip(bases, exponents, strict=True)]
    return ca.vertcat(*(a for a, _ in found)), ca.vertcat(*(b for _, b in found))


def _rows(x: Pair, count: int) -> Pair:
    a, b = (part if part.shape[0] == count else ca.repmat(part, count, 1) for part in x)
    return a, b


def _scalar_power(x: Pair, y: Pair) -> Pair:
    if y[1].is_zero() and y[0].is_constant():
        exponent = float(y[0])
        if exponent.is_integer() and abs(exponent) <= LARGEST_PRODUCT:
            return whole_power(x if exponent >= 0 else quotient(COMPLEX_ONE, x), abs(int(exponent)))
    # exp(y log x); at zero the power of a real number or NaN, as JAX has it.
    zero = ca.logic_and(x[0] == 0, x[1] == 0)
    real, imag = select(zero, 1.0, x[0]), select(zero, 0.0, x[1])
    length, angle = ca.hypot(real, imag), ca.atan2(imag, real)
    value = length ** y[0] * ca.exp(-y[1] * angle)
    turn = y[0] * angle + y[1] * ca.log(length)
    at_zero = _power_of_zero(x, y, zero)
    return select(zero, at_zero[0], value * ca.cos(turn)), select(zero, at_zero[1], value * ca.sin(turn))


def _power_of_zero(x: Pair, y: Pair, zero: ca.SX) -> Pair:
    """The power where the base ``x`` is zero, each part by itself, with the derivatives of JAX for real powers.

    Elsewhere the base is one.
    """
    fixed = y[0] if y[0].is_constant() else _constant(y[0])
    real, imag = (select(zero, part, 1.0) ** fixed for part in x)
    exists = ca.logic_and(y[0] >= 0, y[1] == 0)
    return select(exists, real, np.nan), select(exists, select(fixed > 0, imag, 0.0), np.nan)
