"""The samples of a problem in discrete time."""

from typing import Any, NamedTuple

import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics.tolerances import SAME_TIME
from ...retractions import Euler, Retraction, Theta
from ..reporting.text import brief
from .free_quantities import is_free


class Sampling(NamedTuple):
    """The step that a problem in discrete time has its dynamics for.

    Attributes
    ----------
    time : float
        The length of every step, in the unit of the horizon.
    retraction : Retraction
        The retraction ``R`` of the Euler map, whose step ``R(q, time X(q, u))`` is the state at the next sample.
    """

    time: float
    retraction: Retraction

    @property
    def method(self) -> Theta:
        """The method whose steps are exact."""
        return Euler(self.retraction)

    def require_steps(self, horizon: Any, fractions: np.ndarray) -> None:
        """Raise unless steps with these fractions of a horizon are the samples.

        Parameters
        ----------
        horizon : float or array of float
            The duration, or the durations of a batch.
        fractions : array of shape (N,)
            The lengths of the steps relative to it.
        """
        if is_free(horizon):
            raise InvalidInputError(
                f"each control is held for {self.time:g}, got the free horizon {horizon!r}; try a fixed horizon"
            )
        count, lengths = len(fractions), np.multiply.outer(horizon, fractions)
        off = float(np.max(np.abs(lengths - self.time)))
        if off > SAME_TIME * count * self.time:
            raise InvalidInputError(
                f"each control is held for {self.time:g}, got the horizon {brief(horizon)} with {count} steps, and one "
                f"is {off:.3g} off; try the horizon {count} * {self.time:g} with {count} equal steps"
            )

    def require_method(self, method: object) -> None:
        """Raise unless this is the method whose steps are exact.

        Parameters
        ----------
        method : object
            The method.
        """
        if method != self.method:
            raise InvalidInputError(
                "the steps of a problem with held controls are those of the Euler map of its retraction, "
                f"problem.sampling.method, got {brief(method)}; try this one, or no method"
            )
