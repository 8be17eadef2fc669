"""Free quantities: a horizon, a parameter or a part of an end, with a guess and bounds."""

from typing import Any, final

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics.ambient import is_traced
from ..reporting.text import brief


@final
class Free:
    """A quantity that the optimisation finds, near ``guess`` and between ``lower`` and ``upper``.

    Parameters
    ----------
    guess : float or array_like
        The value at the beginning of the iteration, in the unit of the quantity.
    lower, upper : float or array_like, optional
        Bounds, numbers or arrays of the shape of ``guess``; by default infinite. A horizon is positive in any case.

    Raises
    ------
    InvalidInputError
        If a number is not finite, a bound has another shape, or the guess is outside the bounds.

    Notes
    -----
    Use it as the ``horizon`` of ``solve``, as a leaf of ``parameters``, or as a part of ``start`` or ``end``. In
    ``start`` and ``end`` it is an array without bounds.

    Bounds of a horizon or of parameters have multipliers in ``Solution.multipliers``.

    Examples
    --------
    >>> Free(5.0, lower=1.0).bounded
    True
    """

    __slots__ = ("guess", "lower", "upper")
    guess: Any
    lower: Any
    upper: Any

    def __init__(self, guess: Any, lower: Any = -np.inf, upper: Any = np.inf) -> None:
        values = {"guess": guess, "lower": lower, "upper": upper}
        arrays = {name: _real(name, value) for name, value in values.items()}
        shape = arrays["guess"].shape
        for name, array in arrays.items():
            if array.shape not in ((), shape):
                raise InvalidInputError(
                    f"Free: {name} has shape {array.shape}, expected that of the guess, {shape}, or a number"
                )
            object.__setattr__(self, name, array if array.shape else float(array))
        if not np.all(np.isfinite(arrays["guess"])):
            raise InvalidInputError(f"Free: guess must be finite, got {brief(guess)}")
        if not np.all(arrays["lower"] < arrays["upper"]):
            raise InvalidInputError(f"Free: lower must be less than upper, got {brief(lower)} and {brief(upper)}")
        if not np.all((arrays["lower"] <= arrays["guess"]) & (arrays["guess"] <= arrays["upper"])):
            raise InvalidInputError(
                f"Free: guess must lie between lower and upper, got {brief(guess)}, {brief(lower)}, {brief(upper)}"
            )

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"Free is frozen; make a new one to change {name}")

    def __reduce__(self) -> tuple[Any, ...]:
        return Free, (self.guess, self.lower, self.upper)

    def __repr__(self) -> str:
        return f"Free({self.guess!r}, lower={self.lower!r}, upper={self.upper!r})"

    def member(self, k: int) -> "Free":
        """The quantity of one member of a batch, whose arrays have one more leading axis.

        Parameters
        ----------
        k : int
            The number of the member.

        Returns
        -------
        Free
            Its guess and bounds.
        """
        return Free(*(value if np.ndim(value) == 0 else value[k] for value in (self.guess, self.lower, self.upper)))

    @property
    def bounded(self) -> bool:
        """Whether there is a bound."""
        return bool(np.any(np.isfinite(self.lower)) or np.any(np.isfinite(self.upper)))


def is_free(value: Any) -> bool:
    """Whether this is a ``Free``."""
    return isinstance(value, Free)


def guess_of(value: Any) -> Any:
    """The guess of what may be free."""
    return value.guess if isinstance(value, Free) else value


def _real(name: str, value: Any) -> np.ndarray:
    """An array of real numbers, none of them NaN, that cannot be written to."""
    if is_traced(value):
        raise InvalidInputError(
            f"Free: {name} is traced by JAX, expected numbers; solve runs outside jit, vmap and grad"
        )
    try:
        array = np.asarray(value)
    except ValueError as error:
        parts = len(value) if isinstance(value, tuple) else 0
        hint = (
            f"; for a point of a product try a Free for each part, ({', '.join(f'Free(q[{i}])' for i in range(parts))})"
            if parts
            else ""
        )
        raise InvalidInputError(f"Free: {name} must be a number or an array, got {brief(value)}{hint}") from error
    if array.dtype.kind not in "fiu" or np.any(np.isnan(array)):
        raise InvalidInputError(f"Free: {name} must be a real number or an array of them, got {brief(value)}")
    array = np.array(array, float)
    array.setflags(write=False)
    return array


def guesses_of(given: Any) -> Any:
    """The guesses of the leaves that may be free."""
    return jax.tree.map(guess_of, given)


def with_guess(value: Any, found: Any) -> Any:
    """The value with the found number as its guess, between its bounds, if the value is free."""
    return Free(np.clip(found, value.lower, value.upper), value.lower, value.upper) if is_free(value) else value


def guess_inside(guess: np.ndarray, lower: np.ndarray, upper: np.ndarray, share: float) -> np.ndarray:
    """Guesses strictly between their bounds: off each by a share of its size, and of the room between both."""
    sides = [np.where(np.isfinite(side), side, guess) for side in (lower, upper)]
    sizes = [np.maximum(np.abs(side), np.abs(guess)) for side in sides]
    off = [share * np.minimum(np.where(size > 0, size, 1.0), upper - lower) for size in sizes]
    return np.clip(guess, lower + off[0], upper - off[1])


def with_scaled_guess(value: Any, factor: float) -> Any:
    """The value with a guess larger by a factor, if the value is free; None for a guess outside its bounds."""
    if not is_free(value):
        return value
    guess = factor * value.guess
    return with_guess(value, guess) if value.lower <= guess <= value.upper else None
