"""Phases, and what couples their ends, as the core has them."""

from collections.abc import Sequence
from ctypes import POINTER, byref, pointer
from typing import Any, NamedTuple, final

from ...errors import InvalidInputError
from ..working_memory import aligned_array
from .problem_functions import CallbackFunction
from .structs import FunctionStruct, LayoutStruct, LinkStruct, MultiphaseStruct
from .tape_machine import MachineProgram


class CoupledEnds(NamedTuple):
    """The coupling of the ends of phases, which ``retrax_core.h`` explains.

    ``program``: its function; ``equations``: their number beside links; ``links``: of each the end at which its
    covector stands, its equations and its numbers.
    """

    program: MachineProgram | CallbackFunction
    equations: int
    links: Sequence[tuple[int, int, int]]


@final
class Multiphase:
    """Phases, each a ``Transcription`` of its own or shared by phases of one problem; with ``coupled`` ends, or one
    alone."""

    def __init__(self, transcriptions: Sequence[Any], coupled: CoupledEnds | None = None) -> None:
        self.transcriptions, self._coupled, count = tuple(transcriptions), coupled, len(transcriptions)
        pointers = (POINTER(LayoutStruct) * count)(*[pointer(transcription.layout) for transcription in transcriptions])
        self._struct = MultiphaseStruct(count, pointers, 0, 0, None, FunctionStruct())
        self._kept = list[object]([pointers])
        self.multipliers = self.equations = 0
        if coupled is not None:
            self._couple(coupled)
        for transcription in transcriptions:
            transcription._problem.coupled = coupled is not None

    @property
    def address(self) -> Any:
        """The struct, as functions of the core take it."""
        return byref(self._struct)

    def _couple(self, coupled: CoupledEnds) -> None:
        program, links = coupled.program, (LinkStruct * len(coupled.links))(*coupled.links)
        self.equations = coupled.equations + sum(link[1] for link in coupled.links)
        self.multipliers = coupled.equations + sum(link[2] for link in coupled.links)
        if program.sizes[:2] != (expected := self._sizes()):
            raise InvalidInputError(
                f"a function of the ends of {len(self.transcriptions)} phases: got {program.sizes[0]} inputs and "
                f"{program.sizes[1]} outputs, expected {expected[0]} and {expected[1]}"
            )
        first = self.transcriptions[0]
        if isinstance(program, CallbackFunction):
            self._struct.function = program.as_function(first.failure)
        else:
            registers = aligned_array(program.sizes[2] * program.lanes(1))
            own = registers, program.lanes(1), first.instruction_set
            self._struct.function, context = program.as_function(*own)
            self._kept += [registers, context]
        self._struct.equations, self._struct.links, self._struct.link = coupled.equations, len(links), links
        self._kept += [links, program]

    def _sizes(self) -> tuple[int, int]:
        """The numbers that the function of the ends reads, and writes."""
        sizes = [transcription.sizes for transcription in self.transcriptions]
        numbers, z = (2 * sum(getattr(each, name) for each in sizes) for name in ("state_numbers", "state_size"))
        apart, r = self.multipliers - (self._coupled.equations if self._coupled else 0), self.equations
        read = numbers + sum(each.parameters for each in sizes) + self.multipliers
        return read, z * z + z + r * z + r + numbers + apart + 2 * len(sizes) + r
