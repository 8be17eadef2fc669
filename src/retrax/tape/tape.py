"""Functions of a point as straight lines of scalar operations, evaluated on many points at once."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, Self, final

import casadi as ca
import jax
import numpy as np

from ..compute.binding.tape_machine import VECTOR, MachineProgram
from ..compute.threads import in_threads
from ..errors import InvalidInputError
from .arrays import Entries, column, is_complex, parts, scalars
from .graph import Graph, Loop
from .packing import Argnums, Leaf, argument_places, pack, require_numbers, unpack
from .program import Program, assemble
from .trace import Flat, flat, readable, trace


@final
class Tape:
    """A function of arrays as a list of scalar instructions, with exact derivatives; ``Tape.trace`` makes one.

    Parameters
    ----------
    graph, values, arguments, structure
        The scalar operations; the entries of the values; the arrays and the structure of the arguments; the structure
        of the values.

    Notes
    -----
    A tape takes arrays of many points, with the axis of the points last, in double precision. The compiled core runs
    the instructions: no code is compiled for a function, which runs some milliseconds after the trace.
    """

    def __init__(self, graph: Graph, values: list[Entries], arguments: tuple[list[Leaf], Any], structure: Any) -> None:
        self.graph, self.structure = graph, structure
        self._leaves, self._arguments = arguments
        self._values = values
        self._results = [Leaf(tuple(v.shape), is_complex(v)) for v in values]

    @classmethod
    def trace(cls, function: Callable[..., Any], *examples: Any) -> Self:
        """The tape of a JAX function of pytrees of arrays, whose result is a pytree of arrays.

        Parameters
        ----------
        function : callable
            The function.
        *examples : pytree of arrays
            Arguments, of which only the shapes count.

        Raises
        ------
        NotTraceableError, InvalidInputError
            If it calls an operation without scalar form, such as LAPACK; if JAX cannot trace it.
        """
        if not callable(function):
            raise InvalidInputError(f"a tape is of a function, got {function!r}")
        for leaf in jax.tree.leaves(examples):
            require_numbers(np.asarray(leaf))
        with readable():
            return cls.read(flat(function, *examples))

    @classmethod
    def read(cls, function: Flat) -> Self:
        """The tape of a function that JAX has traced.

        Parameters
        ----------
        function : Flat
            The traced function, made by ``retrax.tape.trace.flat``.

        Raises
        ------
        NotTraceableError
            If an operation of the function has no scalar form.
        """
        leaves, structure = jax.tree.flatten(function.examples)
        graph, values = trace(function)
        owners = [k for k, part in enumerate(function.examples) for _ in jax.tree.leaves(part)]
        kinds = [Leaf(np.shape(a), np.iscomplexobj(a), k) for a, k in zip(leaves, owners, strict=True)]
        return cls(graph, values, (kinds, structure), function.result)

    def __call__(self, *arguments: Any) -> Any:
        """The values of the function at many points.

        Parameters
        ----------
        *arguments : pytree of arrays
            The arguments; each array has the shape of its example, and the axis of the points last.

        Returns
        -------
        pytree of arrays
            The values, with the axis of the points last.
        """
        inputs = pack(arguments, self._leaves, self._arguments)
        rows = np.empty((sum(leaf.rows for leaf in self._results), inputs.shape[1]))
        ends = inputs.ravel(), _rows(*inputs.shape), rows.reshape(-1), _rows(*rows.shape)
        self.run(inputs.shape[1], ends)
        return jax.tree.unflatten(self.structure, unpack(rows, self._results))

    @property
    def instructions(self) -> int:
        """The number of instructions."""
        return len(self.program.codes)

    @property
    def size(self) -> int:
        """The number of scalar operations in the graph, repeated operations included.

        The time to make the instructions grows with this number.
        """
        (outputs,), loops = self._scheduled
        return ca.n_nodes(ca.vertcat(outputs, *(part for loop in loops for part in (loop.first, loop.given))))

    @cached_property
    def inputs(self) -> ca.SX:
        """The symbols of the arguments, one column."""
        return ca.vertcat(*self.graph.inputs)

    @cached_property
    def outputs(self) -> ca.SX:
        """The scalars of the values, one column."""
        return ca.vertcat(ca.SX(0, 1), *(column(half) for v in self._values for half in _halves(v)))

    @property
    def expansion_size(self) -> int:
        """An estimate of the number of scalar operations of ``expansion``.

        The estimate counts the gradient once for each direction. If every second derivative needs all operations, the
        number is up to three times as large.
        """
        marks = [ca.vertcat(m.first, m.given) if isinstance(m, Loop) else m.value for m in self.graph.marks]
        return self.graph.inputs[0].numel() * ca.n_nodes(ca.vertcat(self._slope, self.outputs, *marks))

    @cached_property
    def _slope(self) -> ca.SX:
        """The gradient of the first value with respect to the first argument."""
        first = jax.tree.unflatten(self.structure, self._values)[0]
        return self.graph.gradient(column(first), self.graph.inputs[0])

    @cached_property
    def _scheduled(self) -> tuple[list[ca.SX], list[Loop]]:
        """The outputs without marks, and the loops that they need."""
        return self.graph.schedule([self.outputs])

    @cached_property
    def program(self) -> Program:
        """The instructions."""
        (outputs,), loops = self._scheduled
        return assemble(self.inputs, outputs, loops)

    @cached_property
    def on_core(self) -> MachineProgram:
        """The instructions for the compiled core."""
        return self.program.on_core()

    def __getstate__(self) -> dict[str, Any]:
        """The state of a copy, without addresses in this process."""
        return {name: value for name, value in vars(self).items() if name != "on_core"}

    def jacobian(self, argnums: Argnums = None) -> "Tape":
        """The derivatives of all values with respect to arguments, as a tape of a matrix.

        Parameters
        ----------
        argnums : int or sequence of int, optional
            The places of the arguments, back from the last if negative; all arguments by default.
        """
        matrix = self.graph.jacobian(self.outputs, self._by(argnums))
        return self._of((matrix, matrix.shape))

    def push(self, argnum: int) -> "Tape":
        """The derivatives of all values along a direction in one argument, as a tape with the direction as its last.

        Parameters
        ----------
        argnum : int
            The place of the argument, one real array; back from the last if negative.

        Raises
        ------
        InvalidInputError
            If the argument has several arrays, or a complex one.
        """
        by, places = self._by(argnum), argument_places(argnum, self._arguments)
        leaves = [leaf for leaf in self._leaves if leaf.argument in places]
        if len(leaves) != 1 or leaves[0].complex:
            raise InvalidInputError(
                f"a direction is that of one real array, argument {argnum} has {len(leaves)} arrays or is complex"
            )
        direction = ca.SX.sym("direction", by.shape[0])
        column = self.graph.push(self.outputs, by, direction)
        graph = Graph([*self.graph.inputs, direction], self.graph.marks)
        arguments = jax.tree.unflatten(self._arguments, [0] * self._arguments.num_leaves)
        kinds = [*self._leaves, Leaf(leaves[0].shape, False, len(arguments))]
        structure = jax.tree.structure((*arguments, 0))
        return Tape(graph, [scalars(column, column.shape[:1])], (kinds, structure), jax.tree.structure(0))

    def gradient(self, argnums: Argnums = None) -> "Tape":
        """The derivatives of a function with one value with respect to arguments, as a tape of a flat array.

        Parameters
        ----------
        argnums : int or sequence of int, optional
            As in ``jacobian``.
        """
        column = self.graph.gradient(self._only(), self._by(argnums))
        return self._of((column, column.shape[:1]))

    def hessian(self, argnums: Argnums = None) -> "Tape":
        """The matrix of second derivatives of a function with one value, as a tape.

        Parameters
        ----------
        argnums : int or sequence of int, optional
            As in ``jacobian``.
        """
        matrix = self.graph.hessian(self._only(), self._by(argnums))
        return self._of((matrix, matrix.shape))

    def second_order(self, argnums: Argnums = None) -> "Tape":
        """The value, gradient and Hessian of a function with one value, as one tape with shared operations.

        Parameters
        ----------
        argnums : int or sequence of int, optional
            As in ``jacobian``.
        """
        value, by = self._only(), self._by(argnums)
        slope, curvature = self.graph.gradient(value, by), self.graph.hessian(value, by)
        return self._of((value, ()), (slope, slope.shape[:1]), (curvature, curvature.shape))

    def expansion(self) -> "Tape":
        """The expansion of a function of real arrays at zero in the first argument, which the tape no longer has.

        The function has the values ``(scalar, vectors, *others)``, where ``vectors`` is an array or a tuple of them;
        the tape has the Hessian and gradient of the scalar, the Jacobians of the vectors, the vectors and the others.
        It has derivatives of its own, but none through roots.
        """
        d, (_, vectors, *others) = self.graph.inputs[0], jax.tree.unflatten(self.structure, self._values)
        several, width = [column(v) for v in jax.tree.leaves(vectors)], d.numel()
        slope, directions = self._slope, ca.DM.eye(width)
        # Both along the same directions, in forward mode, so that they share what they compute; each second derivative
        # once.
        curvature, jacobian = (
            self.graph.push(of, d, ca.SX(directions)) for of in (slope, ca.vertcat(ca.SX(0, 1), *several))
        )
        curvature = ca.tril2symm(ca.tril(curvature))
        cuts = [0, *itertools.accumulate(v.numel() for v in several)]
        rows = [jacobian[a:b, :] for a, b in itertools.pairwise(cuts)]
        flat = [ca.vec(ca.densify(m).T) for m in (curvature, slope.T, *rows)]
        there, graph = self.graph.at_zero([*flat, *several, *(column(v) for v in others)])
        shapes = [(width,) * 2, (width,), *((v.numel(), width) for v in several)]
        shapes += [leaf.shape for leaf in self._results[1:]]
        results: list[Entries] = [scalars(v, shape) for v, shape in zip(there, shapes, strict=True)]
        leaves = [replace(leaf, argument=leaf.argument - 1) for leaf in self._leaves[1:]]
        arguments = leaves, jax.tree.structure((0,) * len(leaves))
        return Tape(graph, results, arguments, jax.tree.structure((0,) * len(results)))

    @cached_property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the values."""
        return [leaf.shape for leaf in self._results]

    def to_casadi(self, name: str = "f") -> ca.Function:
        """The function in CasADi, with a column for each array and entries in C order.

        Parameters
        ----------
        name : str
            The name of the function.

        Notes
        -----
        A complex array has two columns, the real and the imaginary parts.
        """
        outputs = [column(half) for v in self._values for half in _halves(v)]
        return ca.Function(name, self.graph.inputs, self.graph.resolve_marks(outputs), {"cse": True})

    def c_code(self, name: str = "f") -> str:
        """The function as a C program, with the interface of CasADi's generated code.

        Parameters
        ----------
        name : str
            The name of the function.
        """
        generator = ca.CodeGenerator(f"{name}.c")
        generator.add(self.to_casadi(name))
        return generator.dump()

    def _of(self, *values: tuple[ca.SX, tuple[int, ...]]) -> "Tape":
        """The tape of expressions of the same inputs, with their shapes; a tuple of arrays for several expressions."""
        results: list[Entries] = [scalars(ca.vec(ca.densify(v).T), shape) for v, shape in values]
        structure = jax.tree.structure(0 if len(values) == 1 else (0,) * len(values))
        return Tape(self.graph, results, (self._leaves, self._arguments), structure)

    def _by(self, argnums: Argnums) -> ca.SX:
        """The symbols of some arguments, one column."""
        wanted = argument_places(argnums, self._arguments)
        owners = [leaf.argument for leaf in self._leaves for _ in range(1 + leaf.complex)]
        return ca.vertcat(
            *(symbols for symbols, owner in zip(self.graph.inputs, owners, strict=True) if owner in wanted)
        )

    def _only(self) -> ca.SX:
        if self.outputs.numel() != 1:
            raise InvalidInputError(
                f"a gradient is of a function with one value, got {self.outputs.numel()}; try jacobian()"
            )
        return self.outputs

    def run(self, count: int, ends: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Write all values at ``count`` points.

        Parameters
        ----------
        count : int
            The number of points.
        ends : tuple of four arrays
            The numbers that are read, their places, the numbers that are written, and their places. Places have shape
            ``(rows, 2)``, a row for each real number of the arguments or values in C order: the place of the number at
            the first point, and the distance to the number at the next point.
        """
        if count:
            in_threads(lambda part: self.on_core.run(part, ends), count, self.program.work, VECTOR)


def _halves(a: Entries) -> tuple[Any, ...]:
    """The real and imaginary parts of complex entries, or the real entries."""
    return parts(a) if is_complex(a) else (a,)


def _rows(count: int, points: int) -> np.ndarray:
    """The places of numbers in an array with a row for each number and a column for each point."""
    return np.stack([points * np.arange(count), np.ones(count, int)], axis=1)
