"""The library of the compiled core, called through ctypes: what ``src/core/retrax_core.h`` declares."""

import ctypes
from ctypes import POINTER, addressof, c_bool, c_char, c_char_p, c_int, c_size_t, c_ssize_t, c_void_p
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from ...errors import InvalidInputError, RetraxError
from .structs import (
    BlockSolutionStruct,
    BlockSystemStruct,
    CollocationSystemStruct,
    CondensedSystemStruct,
    FeasibilityStruct,
    IntegrationStruct,
    LayoutStruct,
    MethodStruct,
    MultiphaseStruct,
    OptionsStruct,
    ProblemStruct,
    SearchResultStruct,
    TapeDataStruct,
    TapeStruct,
)

FLOAT, PLACE, CODE, REGISTER = map(np.dtype, (np.float64, np.intp, np.uint8, np.uint32))  # of arrays that C reads

HEADER_VERSION = 7  # of the header that the structs below repeat
INSTRUCTION_REGISTERS = 8  # registers of an instruction: its result and at most seven arguments
OK = 0  # the status of a call of the core without an error
BYTES = 8  # of a number


class MissingCoreError(RetraxError, ImportError):
    """The compiled core is not installed, cannot be loaded, or is of another version."""

    def __init__(self, problem: str) -> None:
        super().__init__(f"{problem}; try: pip install --force-reinstall --no-deps retrax")


_CONDENSED = [POINTER(CollocationSystemStruct), POINTER(CondensedSystemStruct)]

# Result and arguments of the functions.
_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "retrax_core_version": (c_int, []),
    "retrax_status_message": (c_char_p, [c_int]),
    "retrax_best_instruction_set": (c_int, []),
    "retrax_tape_instruction_name": (c_char_p, [c_int]),
    "retrax_tape_check": (c_int, [POINTER(TapeStruct)]),
    "retrax_tape_check_data": (c_int, [POINTER(TapeStruct), POINTER(TapeDataStruct), *[c_ssize_t] * 3]),
    "retrax_tape_lanes": (c_ssize_t, [POINTER(TapeStruct), c_ssize_t]),
    "retrax_tape_run": (
        None,
        [c_void_p, c_void_p, c_ssize_t, c_ssize_t, c_void_p, c_ssize_t, c_int],
    ),
    "retrax_block_workspace": (c_size_t, [c_ssize_t] * 4),
    "retrax_block_eliminate": (
        None,
        [POINTER(BlockSystemStruct), POINTER(BlockSolutionStruct), c_void_p, c_int],
    ),
    "retrax_condensing_workspace": (c_size_t, [c_ssize_t] * 4),
    "retrax_condense": (None, [*_CONDENSED, c_ssize_t, c_ssize_t, c_void_p, c_int]),
    "retrax_condense_slope": (None, [*_CONDENSED, *[c_void_p] * 4]),
    "retrax_array_name": (c_char_p, [c_int]),
    "retrax_evaluate_tape": (None, [c_void_p, POINTER(TapeDataStruct), c_ssize_t]),
    "retrax_function_inputs": (c_ssize_t, [POINTER(ProblemStruct), c_int]),
    "retrax_function_outputs": (c_ssize_t, [POINTER(ProblemStruct), c_int]),
    "retrax_layout_memory": (c_size_t, [POINTER(ProblemStruct)]),
    "retrax_layout_make": (None, [POINTER(ProblemStruct), c_void_p, POINTER(LayoutStruct)]),
    "retrax_evaluate_trajectory": (None, [POINTER(LayoutStruct), c_void_p]),
    "retrax_assemble_system": (None, [POINTER(LayoutStruct), c_void_p, c_void_p, c_int]),
    "retrax_workspace": (c_size_t, [POINTER(ProblemStruct)]),
    "retrax_add_inequalities": (None, [POINTER(LayoutStruct), c_void_p]),
    "retrax_survey_trajectory": (None, [POINTER(LayoutStruct), c_void_p]),
    "retrax_search_memory": (c_size_t, [POINTER(MultiphaseStruct), c_ssize_t]),
    "retrax_search_make": (c_void_p, [POINTER(MultiphaseStruct), POINTER(OptionsStruct), c_int, c_void_p]),
    "retrax_search_trajectory": (c_void_p, [c_void_p, c_ssize_t]),
    "retrax_search_multipliers": (c_void_p, [c_void_p, c_bool]),
    "retrax_search_perturb": (c_bool, [c_void_p, c_void_p]),
    "retrax_search_restore": (FeasibilityStruct, [c_void_p, c_ssize_t]),
    "retrax_search_run": (c_int, [c_void_p]),
    "retrax_search_read": (SearchResultStruct, [c_void_p, c_ssize_t]),
    "retrax_write_right_sides": (None, [POINTER(LayoutStruct), c_void_p]),
    "retrax_integration_workspace": (c_size_t, [POINTER(MethodStruct)]),
    "retrax_integrate": (
        None,
        [POINTER(MethodStruct), POINTER(IntegrationStruct), c_ssize_t, c_ssize_t, c_void_p],
    ),
}


@cache
def library() -> ctypes.CDLL:
    """The library, whose functions know the types of their arguments; they run without Python's lock."""
    spec = find_spec("retrax._core")
    if spec is None or spec.origin is None:
        raise MissingCoreError(
            "the compiled core of retrax is not installed: expected the file _core beside the package's modules"
        )
    try:
        found = ctypes.CDLL(spec.origin)
    except OSError as error:
        raise MissingCoreError(f"the compiled core of retrax cannot be loaded: {error}") from error
    if found.retrax_core_version() != HEADER_VERSION:
        raise MissingCoreError(
            f"the compiled core has version {found.retrax_core_version()} of its interface, expected {HEADER_VERSION}"
        )
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(found, name)
        function.restype, function.argtypes = result, arguments
    return found


@cache
def best_instruction_set() -> int:
    """The best instruction set of the processor that the core knows."""
    return library().retrax_best_instruction_set()


def require_ok(status: int, what: str) -> None:
    """Raise ``InvalidInputError`` where a check of the core did not pass."""
    if status != OK:
        raise InvalidInputError(f"{what}: {library().retrax_status_message(status).decode()}")


def address_of(array: Any, kind: np.dtype, shape: tuple[int, ...], name: str) -> int:
    """The address of an array for C, 0 if it is empty; raises ``InvalidInputError`` unless it has this type and shape,
    in C order."""
    if not (isinstance(array, np.ndarray) and array.shape == shape and array.dtype == kind and array.flags.carray):
        got = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise InvalidInputError(
            f"{name}: got {got}, expected an array of {kind} of shape {shape}, in C order and writable; try "
            "numpy.array(..., order='C')"
        )
    # The buffer has an address in a quarter of the time that array.ctypes takes.
    return addressof(c_char.from_buffer(array.data)) if array.size else 0
