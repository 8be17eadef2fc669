"""The final manifold ``P_f`` by its equations, and the controls that they determine.

At a consistent point the derivative array ``F(z, U) = 0`` is split by pivoting: some of its rows are solved for as many
of the unknowns ``U = (u, u', ...)``, which leaves equations in ``z`` alone. ``P_f`` is their zero set, and the unknowns
that were solved for are functions of ``z`` (and of the free controls) by the implicit function theorem.
"""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.root import find_root
from ....manifolds.numerics.tolerances import EPS, HALF
from ..wording import ordinal
from .algorithm_stages import PointRanks
from .derivative_array import DerivativeArray, Pair
from .sample_points import Points

Indices = tuple[int, ...]
EXPLICIT = 1e-10  # largest derivative by a control of a row that does not involve it, in units
SINGULAR = EPS**HALF  # smallest singular value of a matrix beside its largest, below which it determines nothing


class Pivots(NamedTuple):
    """Indices into the raveled array and its unknowns.

    Rows ``solved`` for the unknowns ``eliminated``; rows ``kept`` as equations; ``free`` components of the control,
    which parametrise the undetermined ones.
    """

    solved: Indices
    eliminated: Indices
    kept: Indices
    free: Indices


@final
class FinalEquations(eqx.Module):
    """A derivative array with some of its rows solved for the control and its derivatives.

    ``jet``: the consistent value of ``(u, u', ...)`` that the elimination starts from; ``rows`` and ``columns``: units
    of the array and of the jet, raveled; ``explicit``: whether the rows kept as equations involve no control, so that
    nothing has to be solved for them.
    """

    array: DerivativeArray
    center: Ambient
    jet: Array
    rows: Array
    columns: Array
    pivots: Pivots = eqx.field(static=True)
    explicit: bool = eqx.field(static=True)

    def values(self, z: Pair, jet: Array) -> Float[Array, " rows"]:
        """The array in units, raveled, at a raveled jet."""
        return self.array(z, self.center, jet.reshape(self.jet.shape)).reshape(-1) / self.rows

    def eliminate(self, z: Pair, gauge: ArrayLike | None = None) -> Array:
        """The raveled jet with which the solved rows vanish; entries are NaN where Newton's method fails."""
        jet = self.jet.reshape(-1)
        if gauge is not None and self.pivots.free:
            jet = jet.at[jnp.array(self.pivots.free)].set(jnp.ravel(jnp.asarray(gauge)))
        if not self.pivots.solved:
            return jet
        unknown, solved = jnp.array(self.pivots.eliminated), jnp.array(self.pivots.solved)
        root, found = find_root(
            lambda y: self.values(z, jet.at[unknown].set(y))[solved], jet[unknown], self.columns[unknown]
        )
        return jet.at[unknown].set(jnp.where(found, root, jnp.nan))

    def determined_control(self, z: Pair, gauge: ArrayLike | None = None) -> Ambient:
        """The control where the solved rows determine it; elsewhere its entries are NaN.

        On another piece of ``P_f`` these rows may be singular: then they hold for any control.
        """
        jet = self.eliminate(z, gauge)
        unknown, solved = (jnp.array(own, int) for own in (self.pivots.eliminated, self.pivots.solved))
        slope = jax.jacfwd(lambda y: self.values(z, jet.at[unknown].set(y))[solved])(jet[unknown])
        sizes = jnp.linalg.svd(slope * self.columns[unknown], compute_uv=False)
        regular = jnp.min(sizes, initial=jnp.inf) > SINGULAR * jnp.max(sizes, initial=0.0)
        return self._control(jnp.where(regular, jet, jnp.nan))

    def __call__(self, z: Pair) -> Float[Array, " codimension"]:
        """Values of the equations, of order one near ``P_f``, lower levels first."""
        jet = self.jet.reshape(-1) if self.explicit else self.eliminate(z)
        return self.values(z, jet)[jnp.array(self.pivots.kept, int)]

    def conormals(self, points: Points) -> np.ndarray:
        """Derivatives of the equations along the state, in units, at the point of a batch that they were made from."""
        by_state, by_jet = (part[0] for part in points.matrices(len(self.jet) - 1))
        solved, unknown, kept, _ = map(list, self.pivots)
        moved = np.linalg.solve(by_jet[np.ix_(solved, unknown)], by_state[solved])
        return by_state[kept] - by_jet[np.ix_(kept, unknown)] @ moved

    def control(self, z: Pair, gauge: ArrayLike | None = None) -> Ambient:
        """The control at a point of ``P_f``; ``gauge`` gives the free components, shape ``(free controls,)``."""
        return self._control(self.eliminate(z, gauge))

    def _control(self, jet: Array) -> Ambient:
        return self.array.problem._steer(self.center, jet[: self.jet.shape[-1]])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the equations by the level at which they appear."""
        return tuple(ordinal(row // self.jet.shape[-1]) for row in self.pivots.kept)


def final_equations(points: Points, level: int, ranks: PointRanks) -> FinalEquations:
    """The equations of the stratum through the one point of a batch, consistent to ``level``."""
    by_jet = points.matrices(level)[1][0]
    pivots = _pivots(ranks.pivots, points.at.jet.shape[-1], len(by_jet))
    return FinalEquations(
        array=DerivativeArray(points.array.problem, level),
        center=jax.tree.map(jnp.asarray, vec.taken(points.centers, 0)),
        jet=jnp.asarray(points.at.jet[0, : level + 1]),
        rows=jnp.asarray(points.units.rows[0, : level + 1].reshape(-1)),
        columns=jnp.asarray(points.units.jet[0, : level + 1].reshape(-1)),
        pivots=pivots,
        explicit=bool(np.max(np.abs(by_jet[list(pivots.kept)]), initial=0.0) <= EXPLICIT),
    )


def _pivots(rows: np.ndarray, m: int, width: int) -> Pivots:
    """Indices from the rows solved for ``u'``, ..., then ``u``, then ``z``: ``width`` unknowns of which ``m`` are
    ``u``."""
    unknowns = np.roll(np.arange(width), -m)
    solved = rows[:width] >= 0
    return Pivots(
        solved=_sort(rows[:width][solved]),
        eliminated=_sort(unknowns[solved]),
        kept=_sort(rows[width:][rows[width:] >= 0]),
        free=_sort(unknowns[width - m :][~solved[width - m :]]),
    )


def _sort(indices: np.ndarray) -> Indices:
    return tuple(sorted(int(i) for i in indices))
