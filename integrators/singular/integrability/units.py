"""Units of the derivative array and its unknowns: sizes at the starts, and at each point what each equation is made
of."""

from dataclasses import dataclass

import numpy as np

from .linearisation import Linearisation

SMALLEST_LENGTH = 1e-3  # of a coordinate of Q: its unit is not smaller, so that steps of it are no rounding
LEAST = 1e-13  # of an equation's terms: its unit is not smaller, since that is their rounding


@dataclass(frozen=True)
class Sizes:
    """Typical sizes at the starts, shared by a batch.

    ``lengths``: of the coordinates of Q, ``(n,)``; ``action``: of a costate times these; ``rate``: of change, over
    them; ``control``, ``(m,)``; ``rows``: of the array, ``(order + 1, m)``. ``vanishing``: which of these are rounding.
    """

    lengths: np.ndarray
    action: float
    rate: float
    control: np.ndarray
    rows: np.ndarray
    vanishing: np.ndarray

    @property
    def state(self) -> np.ndarray:
        """The sizes of the coordinates of ``T*Q``, ``(2n,)``."""
        return np.concatenate([self.lengths, self.action / self.lengths])


@dataclass(frozen=True)
class Units:
    """Units at each point: of the array and the jet, ``(batch, order + 1, m)``, and of the state, ``(batch, 2n)``.

    ``terms``: what the array is made of before anything cancels, of which the rows are a unit if that is not rounding.
    """

    rows: np.ndarray
    terms: np.ndarray
    state: np.ndarray
    jet: np.ndarray

    @property
    def both(self) -> np.ndarray:
        """The units of state and jet, raveled."""
        return np.concatenate([self.state, self.jet.reshape(len(self.jet), -1)], axis=1)


def typical(sizes: np.ndarray) -> np.ndarray:
    """Medians over the finite sizes of a batch, which one point near a pole does not move; largest sizes if these are
    zero."""
    known = np.where(np.isfinite(sizes), sizes, np.nan)
    known = np.where(np.isnan(known).all(axis=0), 0.0, known)
    medians = np.nanmedian(known, axis=0)
    return np.where(medians > 0, medians, np.nanmax(known, axis=0))


def sizes_at_starts(at: Linearisation, lengths: np.ndarray, vanishing: np.ndarray) -> Sizes:
    """Sizes from the velocity, the cost, the costate and the control at the starts."""
    n = len(lengths)
    rate = float(typical(np.max(np.abs(at.velocity[:, :n]) / lengths, axis=1))) or 1.0
    action = float(typical(np.abs(at.cost_rate))) / rate or float(typical(np.max(np.abs(at.costate) * lengths, axis=1)))
    control = np.sqrt(np.mean(at.jet[:, 0] ** 2, axis=0))
    first = Sizes(
        lengths, action or 1.0, rate, np.where(control > 0, control, 1.0), np.ones(vanishing.shape), vanishing
    )
    return Sizes(lengths, first.action, rate, first.control, typical(units_at(at, first).rows), vanishing)


def units_at(at: Linearisation, sizes: Sizes) -> Units:
    """The unit of each equation at each point: the sum of its partial derivatives, each times the size of its variable.

    A value is then the distance, relative to such sizes, at which the equation holds. Variables far larger than at the
    starts have the size that they have. Of a row that is rounding everywhere, ``D_t F = <dF, field>``, the terms of
    this sum are.
    """
    lengths = np.maximum(sizes.lengths, SMALLEST_LENGTH * np.abs(at.position))
    action = np.maximum(sizes.action, np.max(np.abs(at.costate) * lengths, axis=1))[:, None]
    state = np.concatenate([lengths, action / lengths], axis=1)
    orders = np.arange(at.jet.shape[1])[:, None]
    jet = np.maximum(sizes.control * sizes.rate**orders, np.abs(at.jet))
    with np.errstate(all="ignore"):  # functions that overflow are told by values that are not finite
        rows = _weigh(at, state, jet)
        along = np.concatenate([np.abs(at.jet[:, 1:]), np.zeros_like(at.jet[:, :1])], axis=1)
        terms = _weigh(at, np.abs(at.velocity), along)
        first = np.max(rows[:, :1] * jet[:, :1], axis=2, keepdims=True) / jet[:, :1]
        terms = np.concatenate([first, terms[:, :-1]], axis=1)
        rows, terms = np.maximum(rows, np.where(sizes.vanishing, 1.0, LEAST) * terms), np.maximum(rows, terms)
    return Units(np.where(np.isfinite(rows) & (rows > 0), rows, 1.0), terms, state, jet)


def own_sizes(at: Linearisation) -> np.ndarray:
    """The size of each equation from the values of the variables at the point, ``(batch, order + 1, m)``."""
    with np.errstate(all="ignore"):
        return np.nan_to_num(_weigh(at, np.abs(np.concatenate([at.position, at.costate], axis=1)), np.abs(at.jet)))


def _weigh(at: Linearisation, state: np.ndarray, jet: np.ndarray) -> np.ndarray:
    return np.einsum("bkms,bs->bkm", np.abs(at.by_state), state) + np.einsum("bkmln,bln->bkm", np.abs(at.by_jet), jet)
