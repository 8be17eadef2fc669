"""The options of a search: its tolerance, its limit of iterations, and what is reported of it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import is_count, is_finite_number
from ....manifolds.numerics.precision import working_precision
from ...reporting.result_sentences import warn_about_precision
from ..iteration_reports import Iteration, IterationTable

# Of the rounding, the default tolerance: 1e-11 in double precision, RETRAX_USUAL_TOLERANCE in constants.h of the core.
DEFAULT_TOLERANCE_POWER = 0.7


class Options(NamedTuple):
    """The options of an iteration, checked."""

    tolerance: float
    max_iterations: int
    callback: Callable[[Iteration], Any] | None
    # Whether more searches follow; asked if the search from the guess finds no minimum.
    restarts: Callable[[], bool] = lambda: True

    @classmethod
    def of(cls, tolerance: float | None, max_iterations: int, callback: Any = None, verbose: bool = False) -> "Options":
        """The options as they are given."""
        warn_about_precision()
        precision = working_precision()
        rounding = np.finfo(precision).eps
        limit = rounding**DEFAULT_TOLERANCE_POWER if tolerance is None else tolerance
        if not (is_finite_number(limit) and limit >= rounding):
            raise InvalidInputError(
                f"tolerance must be a positive finite number, at least {rounding:.1e}, which is rounding of "
                f"{precision}; got {tolerance!r}; try None, for {rounding**DEFAULT_TOLERANCE_POWER:.0e}"
            )
        if not is_count(max_iterations):
            raise InvalidInputError(f"max_iterations must be a whole number of at least 1, got {max_iterations!r}")
        if callback is not None and not callable(callback):
            raise InvalidInputError(f"callback must be a function of an Iteration, got {callback!r}")
        return cls(float(limit), int(max_iterations), IterationTable(callback) if verbose else callback)
