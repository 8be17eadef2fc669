"""Programs of tapes on the compiled core."""

from ctypes import addressof, byref, c_char, c_void_p, cast, pointer
from typing import final

import numpy as np

from ...errors import InvalidInputError
from ..working_memory import scratch
from .library import (
    CODE,
    FLOAT,
    INSTRUCTION_REGISTERS,
    PLACE,
    REGISTER,
    address_of,
    best_instruction_set,
    library,
    require_ok,
)
from .structs import FunctionStruct, TapeDataStruct, TapeFunctionStruct, TapeStruct

VECTOR = 8  # lanes of the machine are a multiple of this, or 1

Ends = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@final
class MachineProgram:
    """A tape as the core runs it; the core has checked its layout.

    ``codes``, ``operands``, ``values``: those of each instruction, shapes ``(n,)``, ``(n, 8)`` and ``(n,)``;
    ``registers``: their number; ``instruction_set``: the processor's best by default, or a lesser one.
    """

    def __init__(
        self,
        codes: np.ndarray,
        operands: np.ndarray,
        values: np.ndarray,
        inputs: int,
        outputs: int,
        registers: int,
        instruction_set: int | None = None,
    ) -> None:
        count = len(codes)
        self._arrays = codes, operands, values  # C reads them
        self._set = instruction_set
        self._tape = TapeStruct(
            count,
            registers,
            inputs,
            outputs,
            address_of(codes, CODE, (count,), "codes of a program"),
            address_of(operands, REGISTER, (count, INSTRUCTION_REGISTERS), "operands of a program"),
            address_of(values, FLOAT, (count,), "values of a program"),
        )
        if instruction_set is not None and not 0 <= instruction_set <= best_instruction_set():
            raise InvalidInputError(
                f"instruction set {instruction_set}: this processor has 0 to {best_instruction_set()}; try None"
            )
        self._library = library()
        require_ok(self._library.retrax_tape_check(byref(self._tape)), "a program that the core cannot run")

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of inputs, outputs and registers."""
        return self._tape.inputs, self._tape.outputs, self._tape.registers

    def lanes(self, points: int) -> int:
        """Points that an instruction acts on at once where there are so many."""
        return self._library.retrax_tape_lanes(byref(self._tape), points)

    def as_function(
        self, registers: np.ndarray, lanes: int, instruction_set: int
    ) -> tuple[FunctionStruct, TapeFunctionStruct]:
        """The program as a function of the core that acts on so many lanes, and the context of that, which C reads.

        ``registers``: as many numbers as those of the lanes of the program; one thread uses them at a time.
        """
        place = address_of(registers, FLOAT, registers.shape, "registers")
        context = TapeFunctionStruct(pointer(self._tape), place, lanes, instruction_set)
        evaluate = cast(self._library.retrax_evaluate_tape, c_void_p)
        return FunctionStruct(evaluate, c_void_p(addressof(context))), context

    def run(self, points: range, ends: Ends, lanes: int | None = None) -> None:
        """Write the values at the points of a range.

        ``ends``: numbers that are read, and for each input where the number of point 0 stands and how far the next
        point is, shape ``(inputs, 2)``; numbers that are written, and the same for each output.
        """
        TapeCall(self, points, ends, self.lanes(len(points)) if lanes is None else lanes)(ends[2])

    def tape_data(self, points: range, ends: Ends, lanes: int) -> TapeDataStruct:
        """The arrays of ``run`` for C; raises ``InvalidInputError`` where points lie outside of them."""
        inputs, sources, outputs, targets = ends
        data = TapeDataStruct(
            address_of(inputs, FLOAT, (inputs.size,), "inputs of a program"),
            inputs.size,
            address_of(sources, PLACE, (self._tape.inputs, 2), "places of inputs"),
            address_of(outputs, FLOAT, (outputs.size,), "outputs of a program"),
            outputs.size,
            address_of(targets, PLACE, (self._tape.outputs, 2), "places of outputs"),
        )
        first, last = points.start, points.stop
        status = self._library.retrax_tape_check_data(byref(self._tape), byref(data), first, last, lanes)
        require_ok(status, f"a program at points {first} to {last}, {lanes} at once")
        return data

    def address_and_set(self) -> tuple[int, int]:
        """Where the tape is for C, and the instruction set."""
        return addressof(self._tape), best_instruction_set() if self._set is None else self._set


@final
class TapeCall:
    """A program at points whose places are checked once, as a function of the array that it writes.

    ``registers``: as many numbers as those of all lanes; one thread uses them at a time.
    """

    def __init__(
        self, program: MachineProgram, points: range, ends: Ends, lanes: int, registers: np.ndarray | None = None
    ) -> None:
        self._data = program.tape_data(points, ends, lanes)
        if registers is None:
            (registers,) = scratch(((program.sizes[-1], lanes),))
        room = address_of(registers, FLOAT, registers.shape, "registers")
        tape, instruction_set = program.address_and_set()
        self._kept = program, ends[0], ends[1], ends[3], registers  # C reads them
        # Numbers pass to C in half of the time that references take.
        self._arguments = tape, addressof(self._data), points.start, points.stop, room, lanes, instruction_set
        self._run = library().retrax_tape_run

    def __call__(self, outputs: np.ndarray) -> None:
        """Write the values to an array as large as the one that was checked."""
        self._data.outputs = addressof(c_char.from_buffer(outputs)) if outputs.size else 0  # pyright: ignore[reportArgumentType]
        self._run(*self._arguments)
