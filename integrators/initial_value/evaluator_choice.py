"""The choice between the tape and XLA for steps outside JAX's transformations."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import working_precision
from ...tracing import one_tracing
from ...undisturbed import undisturbed
from .integrator import Integrator

if TYPE_CHECKING:
    from .tape_steps import TapeSteps, TracedSteps


def tape_steps(
    system: Any, integrator: Integrator, starts: tuple[Ambient, Ambient], step_sizes: np.ndarray, evaluator: str
) -> "TapeSteps | str":
    """The steps on the tape, or in words why XLA computes them; raises if ``evaluator`` asks for a tape that cannot
    be."""
    if evaluator == "xla":
        return "it was asked for"
    found = trace_steps(system, integrator)
    if isinstance(found, str):
        if evaluator == "tape":
            raise InvalidInputError(f"the steps cannot run on the tape: {found}; try evaluator='automatic'")
        return found
    from .tape_steps import TapeSteps

    return TapeSteps(found, starts, step_sizes)


def trace_steps(system: Any, integrator: Integrator) -> "TracedSteps | str":
    """The steps as programs, made once in a reading, or in words why they cannot be."""
    key = "steps", id(system), id(integrator), str(working_precision())
    with one_tracing() as reading:  # which keeps both, so that no other objects get their numbers
        return reading.once(key, lambda: (_trace_steps(system, integrator), system, integrator))[0]


@undisturbed  # the imports too
def _trace_steps(system: Any, integrator: Integrator) -> "TracedSteps | str":
    reason = _obstacle(system, integrator)
    if reason:
        return reason
    from ...tape import NotTraceableError
    from ...tape.instructions import UnknownInstructionError

    try:
        from .tape_steps import TracedSteps

        return TracedSteps(system, integrator)
    except (NotTraceableError, UnknownInstructionError) as error:
        return str(error)


def _obstacle(system: Any, integrator: Integrator) -> str:
    """The reason why the steps of an integrator cannot be programs for any system; otherwise empty."""
    if working_precision() != np.dtype(float):
        return "JAX is in single precision, the tape in double"
    single = integrator.substeps()[0]
    if single.stage(system, 1.0) is None:
        return f"the steps of {type(single).__name__} are more than the equations of one stage"
    return ""
