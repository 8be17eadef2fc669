"""Compiled functions that call others by their addresses.

Numba optimises a function again, with all that it calls in turn, wherever it is called: the kernels of an iteration
would be compiled twice, and that takes seconds. Called by its address a kernel is compiled once. Each array that comes
from Python takes its time to compile too: those that lie in one piece of memory are views that the kernel makes.
"""

from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.errors import TypingError

# Numba's own types do not know that it passes an intrinsic its first argument itself.
intrinsic: Any = extending.intrinsic


def array(axes: int, kind: Any = types.float64) -> Any:
    """The type of an array in the order of C."""
    return types.Array(kind, axes, "C")


def address(kernel: Any, signature: Any) -> int:
    """Where the kernel stands that is compiled for these types, or read from the disk now."""
    kernel.compile(signature.args)
    found = kernel.overloads[signature.args]
    if found.signature.return_type != signature.return_type:
        raise TypeError(f"{kernel.__name__} returns {found.signature.return_type}, expected {signature.return_type}")
    return found.library.get_pointer_to_function(found.fndesc.llvm_func_name)


def called(signature: Any) -> Any:
    """``call(address, (arguments...))``, to be used in a compiled function, of a kernel with this signature."""
    result, expected = signature.return_type, signature.args

    def typed(context: Any, place: Any, arguments: Any) -> Any:
        given = [types.unliteral(kind) for kind in arguments.types]
        wrong = [(k, a, b) for k, (a, b) in enumerate(zip(given, expected, strict=True)) if a != b]
        if wrong:
            raise TypingError(f"arguments of other types (place, given, expected): {wrong}")

        def generate(context: Any, builder: Any, call: Any, values: Any) -> Any:
            kinds = [*call.args[1].types]
            own = [builder.extract_value(values[1], k) for k in range(len(kinds))]
            own = [context.cast(builder, v, a, b) for v, a, b in zip(own, kinds, expected, strict=True)]
            form = context.call_conv.get_function_type(result, expected)
            function = builder.inttoptr(values[0], form.as_pointer())
            status, found = context.call_conv.call_function(builder, function, result, expected, own)
            with cgutils.if_unlikely(builder, status.is_error):
                context.call_conv.return_status_propagate(builder, status)
            return found

        return result(place, arguments), generate

    return intrinsic(typed)


@intrinsic
def view(typing: Any, numbers: Any, first: Any, shape: Any) -> Any:
    """``numbers.ravel()[first : first + size].reshape(shape)``, where that is known to fit."""
    kind = array(len(shape.types), numbers.dtype)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        source = context.make_array(signature.args[0])(context, builder, values[0]).data
        lengths = [builder.extract_value(values[2], k) for k in range(kind.ndim)]
        return _filled(context, builder, kind, builder.gep(source, [values[1]]), lengths)

    return kind(numbers, types.intp, types.UniTuple(types.intp, kind.ndim)), generate


def _filled(context: Any, builder: Any, kind: Any, data: Any, lengths: list[Any]) -> Any:
    """An array of this type with data that lie somewhere: a value, where Numba's own way goes by the stack."""
    model = context.data_model_manager[kind]
    itemsize = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    strides, step, count = [], itemsize, context.get_constant(types.intp, 1)
    for length in reversed(lengths):
        strides.insert(0, step)
        step, count = builder.mul(step, length), builder.mul(count, length)
    own = {
        "meminfo": context.get_constant_null(types.voidptr),
        "parent": context.get_constant_null(types.voidptr),
        "nitems": count,
        "itemsize": itemsize,
        "data": data,
        "shape": cgutils.pack_array(builder, lengths),
        "strides": cgutils.pack_array(builder, strides),
    }
    found = ir.Constant(model.get_value_type(), ir.Undefined)
    for name, value in own.items():
        found = builder.insert_value(found, value, model.get_field_position(name))
    return found


LONGEST = 6  # numbers in a row of places


def laid(form: Any, first: int = 0) -> Any:
    """``arrays(numbers, places)``, to be used in a compiled function: arrays that lie in a vector.

    ``form``: their types, in tuples of tuples, as which they come; row ``first + k`` of ``places``, shape (arrays,
    ``LONGEST``): where the k-th begins, then its lengths. A form of few arrays takes less time to compile than
    the same arrays in one of many, of which Numba moves all wherever one is used.
    """

    def kind_of(form: Any) -> Any:
        return types.Tuple([kind_of(part) for part in form]) if isinstance(form, tuple) else form

    def typed(context: Any, numbers: Any, places: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            data, rows = (
                context.make_array(t)(context, builder, value).data
                for t, value in zip(signature.args, values, strict=True)
            )
            entries = iter(range(first * LONGEST, (first + leaves(form)) * LONGEST))

            def entry() -> Any:
                return builder.load(builder.gep(rows, [context.get_constant(types.intp, next(entries))]))

            def made(form: Any) -> Any:
                if isinstance(form, tuple):
                    return context.make_tuple(builder, kind_of(form), [made(part) for part in form])
                begin, *lengths = [entry() for _ in range(LONGEST)]
                place = builder.bitcast(builder.gep(data, [begin]), context.get_data_type(form.dtype).as_pointer())
                return _filled(context, builder, form, place, lengths[: form.ndim])

            return made(form)

        return kind_of(form)(numbers, places), generate

    return intrinsic(typed)


def leaves(form: Any) -> int:
    """How many arrays a form has."""
    return sum(map(leaves, form)) if isinstance(form, tuple) else 1


@intrinsic
def put(typing: Any, to: Any, at: Any, numbers: Any, first: Any, count: Any) -> Any:
    """Copy ``count`` numbers of an array from ``first`` on to a vector from ``at`` on; where the next ones go."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        target, source = (context.make_array(signature.args[k])(context, builder, values[k]).data for k in (0, 2))
        places = builder.gep(target, [values[1]]), builder.gep(source, [values[3]])
        cgutils.raw_memcpy(builder, *places, values[4], context.get_constant(types.intp, 8))
        return builder.add(values[1], values[4])

    return types.intp(to, types.intp, numbers, types.intp, types.intp), generate
