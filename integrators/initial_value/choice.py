"""What computes the steps outside JAX's transformations: the tape where it can, else XLA."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import working_precision
from .integrator import Integrator

if TYPE_CHECKING:
    from .lanes import TapeSteps


def tape_steps(
    system: Any, integrator: Integrator, starts: tuple[Ambient, Ambient], step_sizes: np.ndarray, evaluator: str | None
) -> "TapeSteps | str":
    """The steps on the tape, or in words why XLA computes them; raises if ``evaluator`` asks for a tape that cannot be."""
    if evaluator == "xla":
        return "it was asked for"
    reason = _obstacle(system, integrator)
    if not reason:
        from ...tape import NotTraceableError
        from ...tape.program import UnknownInstructionError
        from .lanes import TapeSteps

        try:
            return TapeSteps(system, integrator, starts, step_sizes)
        except (NotTraceableError, UnknownInstructionError) as error:
            reason = str(error)
        except (ImportError, RuntimeError) as error:  # no Numba for this Python, or no folder for what it compiles
            reason = f"Numba is not available: {error}"
    if evaluator == "tape":
        raise InvalidInputError(f"the steps cannot run on the tape: {reason}; try evaluator=None")
    return reason


def _obstacle(system: Any, integrator: Integrator) -> str:
    """Why the steps of an integrator are not those of programs, whatever the functions of the system; else nothing."""
    if working_precision() != np.dtype(float):
        return "JAX is in single precision, the tape in double"
    single = integrator.substeps()[0]
    if single.stage(system, 1.0) is None:
        return f"the steps of {type(single).__name__} are more than the equations of one stage"
    return ""
