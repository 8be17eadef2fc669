"""Compositions: integrators of higher order from steps of different sizes of one symmetric integrator."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...manifolds import InvalidInputError, Manifold
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.tolerances import SAME_TIME
from ...retractions import Retraction
from .integrator import Integrator
from .step import StepResult


def _symmetric(*half: float) -> tuple[float, ...]:
    """Weights ``half``, the middle one that makes the sum 1, and ``half`` reversed."""
    return (*half, 1 - 2 * sum(half), *reversed(half))


# [Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, II.4 and V.3.2]
TRIPLE_JUMP = _symmetric(1 / (2 - 2 ** (1 / 3)))  # order 4 [Yoshida 1990]
SUZUKI = _symmetric(*(2 * [1 / (4 - 4 ** (1 / 3))]))  # order 4, its negative step half as long [Suzuki 1990]
YOSHIDA_6 = _symmetric(0.784513610477557, 0.235573213359359, -1.17767998417887)  # order 6, 14 digits [Yoshida 1990]
KAHAN_LI_6 = _symmetric(  # order 6 [Kahan, Li 1997]
    0.39216144400731413928,
    0.33259913678935943860,
    -0.70624617255763935981,
    0.082213596293550800230,
)
KAHAN_LI_8 = _symmetric(  # order 8 [Kahan, Li 1997]
    0.13020248308889008088,
    0.56116298177510838456,
    -0.38947496264484728641,
    0.15884190655515560090,
    -0.39590389413323757734,
    0.18453964097831570709,
    0.25837438768632204729,
    0.29501172360931029887,
)


@final
class Composition(Integrator):
    r"""A composition of substeps :math:`w_1 h, \dots, w_s h` of one integrator, with weights that sum to 1.

    Parameters
    ----------
    integrator : Integrator
        A symmetric integrator of order 2, for the orders below.
    weights : tuple of float
        ``TRIPLE_JUMP`` or ``SUZUKI``, the default, for order 4; ``YOSHIDA_6`` or ``KAHAN_LI_6`` for order 6;
        ``KAHAN_LI_8`` for order 8.

    Notes
    -----
    Geometric properties of every substep hold for the composition. The orders hold for steps that tend to the identity
    with ``h``; of a ``StageIntegrator``, compose two halves first.

    References
    ----------
    Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, II.4 and V.3.2.

    Examples
    --------
    >>> method = SymplecticIntegrator(CotangentLift(Midpoint(Addition(Euclidean(1)))))
    >>> len(Composition(method, TRIPLE_JUMP).weights)
    3
    """

    integrator: Integrator
    weights: tuple[float, ...] = eqx.field(static=True, default=SUZUKI)

    def __check_init__(self) -> None:
        if not isinstance(self.integrator, Integrator):
            raise InvalidInputError(
                f"Composition takes an integrator, got {self.integrator!r}; try SymplecticIntegrator(lift)"
            )
        if not abs(sum(self.weights) - 1) <= SAME_TIME:
            raise InvalidInputError(f"the weights of a composition must sum to 1, got {self.weights}; try SUZUKI")

    @property
    def manifold(self) -> Manifold:
        return self.integrator.manifold

    @property
    def control_times(self) -> np.ndarray:
        weights, inner = np.asarray(self.weights), self.integrator.control_times
        begins = (np.cumsum(weights) - weights).reshape(-1, *(1,) * inner.ndim)
        return begins + np.multiply.outer(weights, inner)

    @property
    def retraction(self) -> Retraction:
        return self.integrator.retraction

    def energy(self, system: Any, q: Ambient, p: Ambient, control: Any) -> Array | None:
        return self.integrator.energy(system, q, p, control)

    def substeps(self) -> tuple[Integrator, np.ndarray]:
        inner, parts = self.integrator.substeps()
        return inner, np.multiply.outer(np.asarray(self.weights), parts)

    def check(self, system: Any, q: Ambient, p: Ambient) -> None:
        self.integrator.check(system, q, p)

    def begin(self, system: Any, q: Ambient, p: Ambient) -> tuple[Any, Any]:
        unknowns = self.integrator.begin(system, q, p)
        count = len(self.weights)
        control = self.integrator.control(unknowns)
        return unknowns, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), control)

    def step(self, system: Any, h: ArrayLike, q: Ambient, p: Ambient, previous: tuple[Any, Any]) -> StepResult:
        def substep(last: StepResult, weight: ArrayLike) -> tuple[StepResult, Any]:
            new = self.integrator.step(system, weight * h, last.q, last.p, last.unknowns)
            return new._replace(converged=last.converged & new.converged), self.integrator.control(new.unknowns)

        first = StepResult(q, p, previous[0], jnp.array(True))
        last, controls = jax.lax.scan(substep, first, jnp.asarray(self.weights))
        return last._replace(unknowns=(last.unknowns, controls))

    def control(self, unknowns: tuple[Any, Any]) -> Any:
        return unknowns[1]

    def hint(self, system: Any, first: tuple[Ambient, Ambient], last: tuple[Ambient, Ambient]) -> str:
        return self.integrator.hint(system, first, last)
