"""The functions of a problem as C source."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ....compute.binding.tape_machine import MachineProgram
from ....compute.binding.transcription import FunctionName
from ....tape.c_source import c_function, c_head
from ....tape.program import Program

Programs = Mapping[FunctionName, Any]  # tapes: a problem with callbacks is not exported


def functions_text(programs: Programs) -> str:
    """The definitions of all functions."""
    return "\n".join([c_head(), *(c_function(_program(function), _name(key)) for key, function in programs.items())])


def table_text(programs: Programs) -> str:
    """The entries of the table of functions."""
    rows = []
    for key in FunctionName:
        if key in programs:
            inputs, outputs, _ = programs[key].sizes
            rows.append(f"    {{{_name(key)}, {inputs}, {outputs}}},")
        else:
            rows.append("    {NULL, 0, 0},")
    return "\n".join(rows)


def most_numbers(programs: Programs) -> tuple[int, int]:
    """The largest numbers of inputs and of outputs."""
    sizes = np.array([program.sizes for program in programs.values()]).max(axis=0)
    return int(sizes[0]), int(sizes[1])


def _name(key: FunctionName) -> str:
    return f"evaluate_{key.name.lower()}"


def _program(own: MachineProgram) -> Program:
    (codes, operands, values), (inputs, outputs, registers) = own._arrays, own.sizes
    return Program(codes, operands, values, inputs, outputs, registers)
