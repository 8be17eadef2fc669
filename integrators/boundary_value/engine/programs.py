"""The tapes of a compiled pass in one vector, which the kernel takes."""

from typing import Any

import numpy as np

from ....aligned import LINE
from .fields import Fields


def joined(programs: list[Any]) -> tuple[np.ndarray, np.ndarray, int]:
    """All programs in one vector, where their parts stand there, and the size of the memory that they need.

    The last part is a table: for each program the begin and the end of its instructions, of its sources, and of its
    targets; the begin and the size of what it reads, and of what it writes; the begin and the shape of its registers.
    """
    ends, rows, memory, written, parts = np.zeros(3, int), [], 0, 0, []
    for own in programs:
        code = own.code
        parts.append((code.codes, code.registers, code.values, own.sources, own.targets))
        after = ends + np.array([len(code.codes), len(own.sources), len(own.targets)])
        read, memory = memory, memory + -(-own.numbers[0] // LINE) * LINE
        (reads, writes), registers = own.numbers, own.registers
        rows.append([*np.ravel((ends, after), "F"), read, reads, written, writes, memory, *registers])
        memory, written, ends = memory + registers[0] * registers[1], written + writes, after
    found = [*map(np.concatenate, zip(*parts, strict=True)), np.array(rows)]
    sizes = {str(k): (-(-part.nbytes // 8),) for k, part in enumerate(found)}
    fields = Fields(sizes)
    vector = np.zeros(fields.size, int)
    for name, part in zip(sizes, found, strict=True):
        begin = fields.begins[name]
        vector[begin : begin + sizes[name][0]].view(np.uint8)[: part.nbytes] = part.ravel().view(np.uint8)
    return vector, fields.rows(zip(sizes, (part.shape for part in found), strict=True)), memory
