"""The quantities that a problem is reformulated for: a free horizon, free parameters, an explicit time."""

from math import prod
from typing import Any, NamedTuple

import jax
import numpy as np

from ...problem.free_quantities import guess_of, is_free


class ReformulationKind(NamedTuple):
    """The free and the bounded quantities, which decide the functions of a reformulation."""

    horizon: bool
    horizon_bounds: tuple[bool, bool]
    structure: Any  # of the parameters
    shapes: tuple[tuple[int, ...], ...]  # of their leaves
    free: tuple[int, ...]  # places of those that are free
    below: tuple[int, ...]  # entries of the free ones, in a row, that are bounded from below
    above: tuple[int, ...]

    @classmethod
    def of(cls, horizon: Any, parameters: Any) -> "ReformulationKind":
        """The free and the bounded quantities of a horizon and of parameters."""
        leaves, structure = jax.tree.flatten(parameters)
        sides = np.isfinite(entry_rows(leaves, "lower")), np.isfinite(entry_rows(leaves, "upper"))
        free = tuple(place for place, leaf in enumerate(leaves) if is_free(leaf))
        limits = (horizon.lower > 0, bool(np.isfinite(horizon.upper))) if is_free(horizon) else (False, False)
        shapes = tuple(np.shape(guess_of(leaf)) for leaf in leaves)
        return cls(
            is_free(horizon), limits, structure, shapes, free, *(tuple(np.flatnonzero(side).tolist()) for side in sides)
        )

    @property
    def entries(self) -> int:
        """Number of the entries of all free parameters."""
        return sum(prod(self.shapes[place]) for place in self.free)

    def parameters(self, entries: Any, fixed: Any) -> Any:
        """The parameters, from the entries of the free parameters in a row and the fixed parameters."""
        remaining, begin, leaves = iter(fixed), 0, []
        for place, shape in enumerate(self.shapes):
            if place in self.free:
                leaves.append(entries[begin : begin + prod(shape)].reshape(shape))
                begin += prod(shape)
            else:
                leaves.append(next(remaining))
        return jax.tree.unflatten(self.structure, leaves)


def entry_rows(leaves: list[Any], name: str) -> np.ndarray:
    """The guesses, or bounds, of all free leaves in a row."""
    rows = [np.broadcast_to(getattr(leaf, name), np.shape(leaf.guess)).ravel() for leaf in leaves if is_free(leaf)]
    return np.concatenate([np.zeros(0), *rows])
