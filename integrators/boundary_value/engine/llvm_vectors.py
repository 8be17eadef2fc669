"""Vectors of ``LANES`` numbers in compiled kernels: LLVM makes none of loops over rows that may overlap."""

from collections.abc import Callable
from typing import Any, final

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from ....kernels import kernel, kernel_part
from ....linked import view as view
from . import numpy_vectors
from .arrays import LANES

__all__: list[str] = []
__all__ += numpy_vectors.__all__  # one list for both

# Numba's own types do not know that it passes an intrinsic its first argument itself.
intrinsic: Any = extending.intrinsic

# None of these functions allocates: without counts of references they are a third shorter. A part that LLVM does not
# inline gets each field of its arrays on the stack, which takes longer than what it computes on a small one.
compiled = kernel(vectors=True, fastmath={"contract"})
inner = kernel_part(forceinline=True, fastmath={"contract"}, _nrt=False)

VECTOR = ir.VectorType(ir.DoubleType(), LANES)
PLACES = ir.VectorType(ir.IntType(64), LANES)
CONTRACT = ("contract",)


@final
class Lanes(types.Type):
    """The type of a vector."""


LANES_TYPE = Lanes(name="Lanes")


@extending.register_model(Lanes)
class _Model(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, VECTOR)


def _ordered(builder: Any, vector: Any, places: list[int]) -> Any:
    """The vector of the entries in these places."""
    return builder.shuffle_vector(vector, vector, ir.Constant(ir.VectorType(ir.IntType(32), LANES), places))


def _filled(builder: Any, value: Any, kind: Any = VECTOR) -> Any:
    """The vector of one number."""
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return _ordered(builder, first, [0] * LANES)


def _places(builder: Any, first: Any) -> Any:
    """The numbers from ``first`` on."""
    return builder.add(_filled(builder, first, PLACES), ir.Constant(PLACES, list(range(LANES))))


def _called(builder: Any, name: str, *values: Any) -> Any:
    kind = ir.FunctionType(VECTOR, [value.type for value in values])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}"), list(values))


def _sum(builder: Any, a: Any, b: Any) -> Any:
    return builder.fadd(a, b, flags=CONTRACT)


def _difference(builder: Any, a: Any, b: Any) -> Any:
    return builder.fsub(a, b, flags=CONTRACT)


def _product(builder: Any, a: Any, b: Any) -> Any:
    return builder.fmul(a, b, flags=CONTRACT)


def _larger(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _higher(builder: Any, a: Any, b: Any) -> Any:
    is_larger, is_none = builder.fcmp_ordered(">", b, a), builder.fcmp_unordered("uno", b, b)
    return builder.select(builder.or_(is_larger, is_none), b, a)


def _folded(join: Callable[..., Any]) -> Callable[..., Any]:
    """All lanes joined into one number, half after half."""

    def fold(builder: Any, vector: Any) -> Any:
        width = LANES
        while width > 1:
            width //= 2
            kind = ir.VectorType(ir.IntType(32), width)
            halves = ir.Constant(kind, list(range(width))), ir.Constant(kind, list(range(width, 2 * width)))
            vector = join(builder, *(builder.shuffle_vector(vector, vector, half) for half in halves))
        return builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    return fold


def _inverse(builder: Any, x: Any) -> Any:
    one = ir.Constant(VECTOR, [1.0] * LANES)
    return builder.select(builder.fcmp_ordered(">", x, ir.Constant(VECTOR, None)), builder.fdiv(one, x), one)


def _within(builder: Any, x: Any, j: Any, first: Any, last: Any) -> Any:
    places, low, high = _places(builder, j), _filled(builder, first, PLACES), _filled(builder, last, PLACES)
    inside = builder.and_(builder.icmp_signed(">=", places, low), builder.icmp_signed("<", places, high))
    return builder.select(inside, x, ir.Constant(VECTOR, None))


def _without(builder: Any, x: Any, j: Any, r: Any) -> Any:
    there = builder.icmp_signed("==", _places(builder, j), _filled(builder, r, PLACES))
    return builder.select(there, ir.Constant(VECTOR, None), x)


def _sought(builder: Any, x: Any, f: Any) -> Any:
    """The first lane of that number, or ``LANES``."""
    bits = builder.bitcast(builder.fcmp_ordered("==", x, _filled(builder, f)), ir.IntType(LANES))
    wide = builder.or_(builder.zext(bits, ir.IntType(64)), ir.Constant(ir.IntType(64), 1 << LANES))
    return builder.cttz(wide, ir.Constant(ir.IntType(1), 1))


def _operation(make: Callable[..., Any], *kinds: Any, result: Any = LANES_TYPE) -> Any:
    """What ``make`` makes of operands of these kinds, as a function in kernels."""
    typed = result(*kinds), lambda context, builder, signature, values: make(builder, *values)
    functions: dict[int, Any] = {
        1: lambda typing, a: typed,
        2: lambda typing, a, b: typed,
        3: lambda typing, a, b, c: typed,
        4: lambda typing, a, b, c, d: typed,
    }
    return intrinsic(functions[len(kinds)])


FLOAT, INTEGER, LINE = types.float64, types.intp, LANES_TYPE
filled = _operation(_filled, FLOAT)
plus = _operation(_sum, LINE, LINE)
minus = _operation(_difference, LINE, LINE)
times = _operation(_product, LINE, LINE)
scaled = _operation(lambda b, f, x: _product(b, _filled(b, f), x), FLOAT, LINE)
over = _operation(lambda b, x, f: b.fdiv(x, _filled(b, f)), LINE, FLOAT)
add = _operation(lambda b, y, f, x: _sum(b, y, _product(b, _filled(b, f), x)), LINE, FLOAT, LINE)
subtract = _operation(lambda b, y, f, x: _difference(b, y, _product(b, _filled(b, f), x)), LINE, FLOAT, LINE)
larger = _operation(_larger, LINE, LINE)
higher = _operation(_higher, LINE, LINE)  # what is not a number stays
magnitude = _operation(lambda b, x: _called(b, f"fabs.v{LANES}f64", x), LINE)
root = _operation(lambda b, x: _called(b, f"sqrt.v{LANES}f64", x), LINE)
inverse = _operation(_inverse, LINE)  # ones where there is none
within = _operation(_within, LINE, INTEGER, INTEGER, INTEGER)  # of the vector from j on, what is in a range
without = _operation(_without, LINE, INTEGER, INTEGER)  # the vector from j on without the entry in a place
sought = _operation(_sought, LINE, FLOAT, result=INTEGER)
highest = _operation(_folded(_larger), LINE, result=FLOAT)
total = _operation(_folded(_sum), LINE, result=FLOAT)


def _place(context: Any, builder: Any, kind: Any, array: Any, row: Any, column: Any) -> tuple[Any, Any]:
    """Where the vector begins that stands in a row of an array from a column on, and how long the row is."""
    value = context.make_array(kind)(context, builder, array)
    width = builder.extract_value(value.shape, 1)
    place = builder.gep(value.data, [builder.add(builder.mul(row, width), column)])
    return builder.bitcast(place, VECTOR.as_pointer()), width


@intrinsic
def vector(typing: Any, x: Any, i: Any, j: Any) -> Any:
    """``x[i, j : j + LANES]``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load(_place(context, builder, signature.args[0], *values)[0], align=8)

    return LINE(x, INTEGER, INTEGER), generate


def _masked(context: Any, builder: Any, kind: Any, *place: Any) -> tuple[Any, Any, Any]:
    """Where the vector begins, how it is aligned, and which of its lanes are within the row."""
    pointer, width = _place(context, builder, kind, *place)
    inside = builder.icmp_signed("<", _places(builder, place[2]), _filled(builder, width, PLACES))
    return pointer, ir.Constant(ir.IntType(32), 8), inside


@intrinsic
def part(typing: Any, x: Any, i: Any, j: Any) -> Any:
    """``x[i, j : j + LANES]`` of a row that is not padded: zero after its end."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = _masked(context, builder, signature.args[0], *values)
        return _called(builder, f"masked.load.v{LANES}f64.p0", *place, ir.Constant(VECTOR, None))

    return LINE(x, INTEGER, INTEGER), generate


@intrinsic
def put_part(typing: Any, y: Any, i: Any, j: Any, x: Any) -> Any:
    """``y[i, j : j + LANES] = x`` in a row that is not padded, up to its end."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = _masked(context, builder, signature.args[0], *values[:3])
        kind = ir.FunctionType(ir.VoidType(), [VECTOR, *(value.type for value in place)])
        name = f"llvm.masked.store.v{LANES}f64.p0"
        builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [values[3], *place])
        return context.get_dummy_value()

    return types.void(y, INTEGER, INTEGER, LINE), generate


@intrinsic
def put(typing: Any, y: Any, i: Any, j: Any, x: Any) -> Any:
    """``y[i, j : j + LANES] = x``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        builder.store(values[3], _place(context, builder, signature.args[0], *values[:3])[0], align=8)
        return context.get_dummy_value()

    return types.void(y, INTEGER, INTEGER, LINE), generate


@intrinsic
def entry(typing: Any, x: Any, i: Any, j: Any) -> Any:
    """``x[i, j]``: Numba asks of each index whether it counts from the end, and LLVM then computes each place anew."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = _place(context, builder, signature.args[0], *values)[0]
        return builder.load(builder.bitcast(place, ir.DoubleType().as_pointer()))

    return FLOAT(x, INTEGER, INTEGER), generate


@intrinsic
def put_entry(typing: Any, y: Any, i: Any, j: Any, f: Any) -> Any:
    """``y[i, j] = f``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = _place(context, builder, signature.args[0], *values[:3])[0]
        builder.store(values[3], builder.bitcast(place, ir.DoubleType().as_pointer()))
        return context.get_dummy_value()

    return types.void(y, INTEGER, INTEGER, FLOAT), generate


def _plain_loop(branch: Any) -> None:
    """Tell LLVM that a loop is short: unrolled it is more to compile, and slower for what it keeps on the stack."""
    module = branch.function.module
    word = module.add_metadata([ir.MetaDataString(module, "llvm.loop.unroll.disable")])
    loop = module.add_metadata([word])
    loop.operands = (loop, word)
    branch.set_metadata("llvm.loop", loop)


def _explained(builder: Any, begun: list, f: Any, step: Any, x: Any, width: Any, count: Any) -> list:
    """``begun[i][j] - sum_s f[s step + i] x[s width + j : + LANES]``, so many terms: a row of vectors for each i."""
    index = count.type
    before = builder.block
    loop, after = builder.append_basic_block("terms"), builder.append_basic_block("done")
    builder.cbranch(builder.icmp_signed(">", count, ir.Constant(index, 0)), loop, after)
    builder.position_at_end(loop)
    starts = [count, f, x, *(vector for row in begun for vector in row)]
    phis = [builder.phi(start.type) for start in starts]
    left, f, x = phis[:3]
    vectors, found = [], []
    for j in range(len(begun[0])):
        place = builder.bitcast(builder.gep(x, [ir.Constant(index, LANES * j)]), VECTOR.as_pointer())
        vectors.append(builder.load(place, align=8))
    for i in range(len(begun)):
        number = _filled(builder, builder.load(builder.gep(f, [ir.Constant(index, i)])))
        for vector in vectors:
            found.append(_difference(builder, phis[3 + len(found)], _product(builder, number, vector)))
    left = builder.sub(left, ir.Constant(index, 1))
    ends = [left, builder.gep(f, [step]), builder.gep(x, [width]), *found]
    for phi, start, end in zip(phis, starts, ends, strict=True):
        phi.add_incoming(start, before)
        phi.add_incoming(end, loop)
    _plain_loop(builder.cbranch(builder.icmp_signed(">", left, ir.Constant(index, 0)), loop, after))
    builder.position_at_end(after)
    results = []
    for start, end in zip(starts[3:], found, strict=True):
        result = builder.phi(VECTOR)
        result.add_incoming(start, before)
        result.add_incoming(end, loop)
        results.append(result)
    return [results[i * len(begun[0]) : (i + 1) * len(begun[0])] for i in range(len(begun))]


def _subtraction(rows: int, vectors: int) -> Any:
    """``subtract(y, i, j, f, t, x, k, count)``: ``y[i, j:] -= sum_s f[t + s, i] * x[k + s, j:]`` for so many rows from
    i on, vectors from j on, and terms."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        (y, i, j, f, t, x, k, count), kinds, double = values, signature.args, ir.DoubleType().as_pointer()
        of = [builder.add(i, ir.Constant(i.type, a)) for a in range(rows)]
        columns = [builder.add(j, ir.Constant(j.type, LANES * b)) for b in range(vectors)]
        places = [[_place(context, builder, kinds[0], y, row, column)[0] for column in columns] for row in of]
        begun = [[builder.load(place, align=8) for place in row] for row in places]
        factor, step = _place(context, builder, kinds[3], f, t, i)
        row, width = _place(context, builder, kinds[5], x, k, j)
        factor, row = builder.bitcast(factor, double), builder.bitcast(row, double)
        found = _explained(builder, begun, factor, step, row, width, count)
        for to, values_of in zip(places, found, strict=True):
            for place, value in zip(to, values_of, strict=True):
                builder.store(value, place, align=8)
        return context.get_dummy_value()

    def typed(typing: Any, y: Any, i: Any, j: Any, f: Any, t: Any, x: Any, k: Any, count: Any) -> Any:
        return types.void(y, INTEGER, INTEGER, f, INTEGER, x, INTEGER, INTEGER), generate

    return intrinsic(typed)


three_by_two, three_by_one, one_by_one = (_subtraction(*size) for size in ((3, 2), (3, 1), (1, 1)))


def _look(vectors: int) -> Any:
    """``look(y, i, j, f, t, x, k, count, left)``: subtract from row i, and the largest size of what is left there but
    for the diagonal where the first row of ``left`` is 1, lane for lane; the sizes stand in its second row."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        (y, i, j, f, t, x, k, count, left), kinds, double = values, signature.args, ir.DoubleType().as_pointer()
        columns = [builder.add(j, ir.Constant(j.type, LANES * b)) for b in range(vectors)]
        places = [_place(context, builder, kinds[0], y, i, column)[0] for column in columns]
        begun = [[builder.load(place, align=8) for place in places]]
        factor, step = _place(context, builder, kinds[3], f, t, i)
        row, width = _place(context, builder, kinds[5], x, k, j)
        factor, row = builder.bitcast(factor, double), builder.bitcast(row, double)
        (found,) = _explained(builder, begun, factor, step, row, width, count)
        most = None
        for place, value, column in zip(places, found, columns, strict=True):
            builder.store(value, place, align=8)
            mask, to = (_place(context, builder, kinds[8], left, ir.Constant(i.type, a), column)[0] for a in range(2))
            none = ir.Constant(VECTOR, None)
            there = builder.fcmp_ordered(">", _without(builder, builder.load(mask, align=8), column, i), none)
            size = builder.select(there, _called(builder, f"fabs.v{LANES}f64", value), none)
            builder.store(size, to, align=8)
            most = _larger(builder, size, ir.Constant(VECTOR, None) if most is None else most)
        return most

    def typed(typing: Any, y: Any, i: Any, j: Any, f: Any, t: Any, x: Any, k: Any, count: Any, left: Any) -> Any:
        return LINE(y, INTEGER, INTEGER, f, INTEGER, x, INTEGER, INTEGER, left), generate

    return intrinsic(typed)


look_at_three, look_at_two, look_at_one = (_look(vectors) for vectors in (3, 2, 1))


@intrinsic
def add_vector(typing: Any, y: Any, i: Any, j: Any, f: Any, x: Any, k: Any, l: Any) -> Any:  # noqa: E741
    """``y[i, j : j + LANES] += f * x[k, l : l + LANES]`` in one vector: LLVM makes none of a loop whose rows may
    overlap."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = signature.args
        to, of = (_place(context, builder, kinds[first], *values[first : first + 3])[0] for first in (0, 4))
        product = builder.fmul(_filled(builder, values[3]), builder.load(of, align=8), flags=("contract",))
        builder.store(builder.fadd(builder.load(to, align=8), product, flags=("contract",)), to, align=8)
        return context.get_dummy_value()

    return types.void(y, types.intp, types.intp, types.float64, x, types.intp, types.intp), generate
