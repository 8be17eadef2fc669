"""The use of the controls in the functions of a problem: a control that is broadcast, entries that nothing reads."""

import warnings

import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from ...index_bounds import place_of
from ..problem.quantities import Quantities
from ..reporting.result_sentences import callers


def warn_of_broadcast(program: ClosedJaxpr) -> None:
    """Warn of a single control that a function adds to an array: JAX adds the control to every entry.

    ``program``: the functions of a problem, whose last input is the control.
    """
    control = program.jaxpr.invars[-1]
    for equation in program.jaxpr.eqns if control.aval.shape == (1,) else ():
        count = equation.outvars[0].aval.size
        if equation.primitive.name in ("add", "sub") and control in equation.invars and count > 1:
            warnings.warn(
                f"the only control{place_of(equation)} is added to each of {count} entries; try controls={count} for a "
                "control of each entry, or u[0] for one control of all entries",
                stacklevel=callers(),
            )


def unread_controls(program: ClosedJaxpr, quantities: Quantities) -> list[str]:
    """The names of the entries of the controls that no function reads; none where the functions have no tape."""
    from ...tape import NotTraceableError, Tape  # they load CasADi

    zeros = [np.zeros(kind.shape, kind.dtype) for kind in program.in_avals]
    try:
        function = Tape.trace(jaxpr_as_fun(program), *zeros).to_casadi()
    except NotTraceableError:
        return []
    names = [name for quantity in quantities.controls for name in quantity.columns]
    last, read = function.n_in() - 1, np.zeros(len(names), bool)
    for k in range(function.n_out()):
        read |= np.diff(function.jac_sparsity(k, last).colind()) > 0
    return [name for name, is_read in zip(names, read, strict=True) if not is_read]
