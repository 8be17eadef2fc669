"""Elementary functions as generators of a field, in which an expression is a quotient of polynomials and zero is known.

Exponentials of rational functions are generators without relations where the exponents are linearly independent over
the rationals [Ax, On Schanuel's conjectures, 1971]; so are logarithms of different irreducible polynomials. Sines and
cosines satisfy ``s^2 + c^2 = 1``, roots of an irreducible polynomial ``r^n = b``, and nothing else.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import sympy

from ....manifolds import InvalidInputError

Expression = Any
HIGHEST = 60  # power of a generator: cancelling takes too long beyond


class UntreatableError(InvalidInputError):
    """An expression outside of what exact algebra treats here."""

    def __init__(self, expression: str) -> None:
        super().__init__(
            f"exact algebra met {expression}; it treats rational functions of states and controls, and exp, log, sin, "
            "cos and rational powers of these; classify it without symbolic=True"
        )


@dataclass(frozen=True)
class Field:
    """Generators for the functions in some expressions.

    ``inside``: the functions by generators; ``outside``: the generators by functions; ``relations``: pairs of a
    generator and a monic polynomial that it is a root of; ``circles``: pairs of generators that are a cosine and a
    sine.
    """

    inside: dict[Expression, Expression]
    outside: dict[Expression, Expression]
    relations: tuple[tuple[Expression, Expression], ...]
    circles: tuple[tuple[Expression, Expression], ...]

    def fraction(self, expression: Expression) -> tuple[Expression, Expression]:
        """Numerator and denominator of an expression, polynomials in variables and generators without a common
        factor."""
        numerator, denominator = sympy.fraction(sympy.cancel(sympy.together(expression.xreplace(self.inside))))
        if not self.relations:
            return numerator, denominator
        return sympy.fraction(sympy.cancel(self._reduce(numerator) / self._reduce(denominator)))

    def _reduce(self, polynomial: Expression) -> Expression:
        for generator, relation in self.relations:
            polynomial = sympy.rem(sympy.expand(polynomial), relation, generator)
        return sympy.expand(polynomial)

    def never_zero(self, polynomial: Expression) -> bool:
        """Whether a polynomial is known to vanish nowhere where the functions are smooth: roots of zero are not."""
        roots = [g for g, f in self.outside.items() if f.is_Pow and f.exp.is_Rational]
        symbols = polynomial.free_symbols
        if polynomial.is_zero is False or polynomial in roots or not polynomial.xreplace(self.outside).free_symbols:
            return True
        if len(symbols) != 1:
            return False
        (symbol,) = symbols
        low, high = (
            (0, None)
            if symbol.is_positive
            else (-1, 1)
            if any(symbol in pair for pair in self.circles)
            else (None, None)
        )
        return sympy.Poly(polynomial, symbol).count_roots(low, high) == 0

    def exponent_where_zero(self, polynomial: Expression) -> Expression | None:
        """``a - log c`` for a multiple of ``exp(a) - c``, else None."""
        if len(polynomial.free_symbols) != 1:
            return None
        (symbol,) = polynomial.free_symbols
        if not symbol.is_positive or sympy.degree(polynomial, symbol) != 1:
            return None
        return self.outside[symbol].args[0] - sympy.log(-polynomial.coeff(symbol, 0) / polynomial.coeff(symbol, 1))

    def point(self, values: dict[Expression, Expression]) -> dict[Expression, Expression]:
        """Numbers for the generators where the variables have these: any that satisfy the relations, so not too
        large."""
        free = [g for g in self.outside if not any(g == r for r, _ in self.relations)]
        chosen = values | {g: sympy.Rational(3 * i + 5, 2 * i + 7) for i, g in enumerate(free)}
        for t, (cosine, sine) in enumerate(self.circles, 2):
            chosen |= {cosine: sympy.Rational(t**2 - 1, t**2 + 1), sine: sympy.Rational(2 * t, t**2 + 1)}
        for generator, function in self.outside.items():
            if function.is_Pow:
                chosen[generator] = function.xreplace(values)
        return chosen


def field_of(*expressions: Expression) -> Field:
    """Generators for the functions in these expressions. Raises ``UntreatableError`` for those that have none."""
    atoms = sorted(set().union(*(_functions(e) for e in expressions)), key=sympy.default_sort_key)
    for f in atoms:
        if not f.args[0].is_rational_function():
            raise UntreatableError(f"{f}, a function of what is not rational")
    exponents, angles = (
        [f.args[0] for f in atoms if isinstance(f, kinds)] for kinds in (sympy.exp, (sympy.sin, sympy.cos))
    )
    inside, outside, relations, circles = {}, {}, [], []
    _add_exponentials(list(dict.fromkeys(exponents)), inside, outside)
    _add_circles(list(dict.fromkeys(angles)), inside, outside, relations, circles)
    _add_logarithms([f for f in atoms if isinstance(f, sympy.log)], inside, outside)
    _add_roots([f for f in atoms if f.is_Pow], inside, outside, relations)
    return Field(inside, outside, tuple(relations), tuple(circles))


def _functions(expression: Expression) -> set[Expression]:
    """The largest subexpressions that are not rational in what they are made of."""
    if not expression.args:
        if expression in (sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
            raise UntreatableError(f"{expression}, which is not finite")
        return set()
    treated = isinstance(expression, sympy.exp | sympy.log | sympy.sin | sympy.cos)
    if treated or (expression.is_Pow and expression.exp.is_Rational and not expression.exp.is_Integer):
        return {expression}
    rational = expression.is_Add or expression.is_Mul or (expression.is_Pow and expression.exp.is_Integer)
    if not rational:
        raise UntreatableError(str(expression))
    return set().union(*map(_functions, expression.args))


def _basis(arguments: list[Expression]) -> tuple[list[Expression], list[list[Any]]]:
    """Elements of which each argument is a sum of whole multiples, linearly independent over the rationals, and the
    multiples."""
    parts = [sympy.fraction(sympy.cancel(sympy.together(a))) for a in arguments]
    common = reduce(sympy.lcm, (denominator for _, denominator in parts), sympy.Integer(1))
    terms = [sympy.expand(sympy.cancel(a * common)).as_coefficients_dict() for a in arguments]
    monomials = list(dict.fromkeys(m for coefficients in terms for m in coefficients))
    columns = sympy.Matrix([[coefficients.get(m, 0) for coefficients in terms] for m in monomials])
    echelon, pivots = columns.rref()
    multiples = [[echelon[i, j] for i in range(len(pivots))] for j in range(len(arguments))]
    units = [sympy.ilcm(1, *(row[i].q for row in multiples)) for i in range(len(pivots))]
    whole = [[int(c * unit) for c, unit in zip(row, units, strict=True)] for row in multiples]
    if any(sum(map(abs, row)) > HIGHEST for row in whole):
        raise UntreatableError(f"functions of {', '.join(map(str, arguments))}, of too different frequencies")
    return [arguments[j] / unit for j, unit in zip(pivots, units, strict=True)], whole


def _add_exponentials(exponents: list[Expression], inside: dict, outside: dict) -> None:
    basis, multiples = _basis(exponents) if exponents else ([], [])
    generators = [sympy.Dummy("e", positive=True) for _ in basis]
    outside.update(zip(generators, map(sympy.exp, basis), strict=True))
    for exponent, powers in zip(exponents, multiples, strict=True):
        inside[sympy.exp(exponent)] = sympy.Mul(*(g**k for g, k in zip(generators, powers, strict=True)))


def _add_circles(angles: list[Expression], inside: dict, outside: dict, relations: list, circles: list) -> None:
    basis, multiples = _basis(angles) if angles else ([], [])
    pairs = [(sympy.Dummy("c", real=True), sympy.Dummy("s", real=True)) for _ in basis]
    for angle, (c, s) in zip(basis, pairs, strict=True):
        outside.update({c: sympy.cos(angle), s: sympy.sin(angle)})
        relations.append((s, s**2 + c**2 - 1))
    circles.extend(pairs)
    for angle, powers in zip(angles, multiples, strict=True):
        turned = sympy.Mul(
            *((c + sympy.sign(k) * sympy.I * s) ** abs(k) for (c, s), k in zip(pairs, powers, strict=True))
        )
        real, imaginary = sympy.expand(turned).as_real_imag()
        inside.update({sympy.cos(angle): real, sympy.sin(angle): imaginary})


def _add_logarithms(logarithms: list[Expression], inside: dict, outside: dict) -> None:
    rows = [_factors(f.args[0]) for f in logarithms]
    if _rank(rows) < len(rows):
        raise UntreatableError(f"{', '.join(map(str, logarithms))}, which depend on each other")
    inside.update({f: sympy.Dummy("l", real=True) for f in logarithms})
    outside.update({inside[f]: f for f in logarithms})


def _add_roots(powers: list[Expression], inside: dict, outside: dict, relations: list) -> None:
    bases = list(dict.fromkeys(f.base for f in powers))
    rows = [_factors(base) for base in bases]
    for i, (base, row) in enumerate(zip(bases, rows, strict=True)):
        own = [k for f, k in row.items() if not any(f in other for j, other in enumerate(rows) if j != i)]
        if not any(abs(k) == 1 for k in own):
            raise UntreatableError(f"roots of {', '.join(map(str, bases))}, which depend on each other")
        found = [f for f in powers if f.base == base]
        degree, root = sympy.ilcm(1, *(f.exp.q for f in found)), sympy.Dummy("r", real=True)
        inside.update({f: root ** int(f.exp * degree) for f in found})
        outside[root] = base ** sympy.Rational(1, degree)
        relations.append((root, root**degree - base))


def _factors(function: Expression) -> dict[Expression, int]:
    """Irreducible polynomials and primes of a rational function, with their powers."""
    factors: dict[Expression, int] = {}
    for part, sign in zip(sympy.fraction(sympy.cancel(function)), (1, -1), strict=True):
        constant, polynomials = sympy.factor_list(part)
        primes: Any = sympy.factorrat(abs(constant)) if constant.is_Rational else {constant: 1}
        for factor, k in [*polynomials, *primes.items()]:
            factors[factor] = factors.get(factor, 0) + sign * k
    return factors


def _rank(rows: list[dict[Expression, int]]) -> int:
    columns = list(dict.fromkeys(f for row in rows for f in row))
    return sympy.Matrix([[row.get(f, 0) for f in columns] for row in rows]).rank() if rows and columns else 0


def normal_form(expression: Expression) -> Expression:
    """An expression in its normal form, in which a function that vanishes is 0; raises ``UntreatableError`` outside
    the treated functions."""
    if expression.is_rational_function() and expression.is_finite is not False:
        return sympy.cancel(expression)
    field = field_of(expression)
    numerator, denominator = field.fraction(expression)
    return (numerator / denominator).xreplace(field.outside)
