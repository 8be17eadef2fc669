"""Random points, tangent vectors and covectors from integer seeds, in flat real coordinates."""

from collections.abc import Iterator
from functools import cached_property

import jax
import numpy as np

from ..manifolds import CotangentBundle, InvalidInputError, LevelSet, Manifold, Submanifold, TangentBundle
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.precision import default_tolerance, same_point
from ..retractions import Retraction
from .numerics import Vector, compiled, flat, unflat, violation_kernel
from .precision import precision

RESTORING_STEPS = 12  # restorations in a row of a point near the manifold: enough for its rounding
DRAW_HALVINGS = 50  # of a step whose end cannot be restored; after the last one the step is rounding
RUNGS = 16  # multiples of a vector, evenly up to the longest, among which the first outside a domain is looked for


def direction(rng: np.random.Generator, basis: np.ndarray) -> np.ndarray:
    """Unit vector in a random direction of the span of an orthonormal ``basis``, given by rows; zero if there is
    none."""
    c = rng.standard_normal(basis.shape[0])
    return (c / max(float(np.linalg.norm(c)), 1e-300)) @ basis


class Sampler:
    """Draws on one manifold; its kernels are compiled at the first draw."""

    def __init__(self, manifold: Manifold) -> None:
        self.manifold, self.unflat = manifold, unflat(manifold)

        def point(seed: jax.Array) -> Vector:
            return flat(manifold.random_point(jax.random.split(jax.random.key(seed))[0]))

        def at(x: Vector, seed: jax.Array) -> tuple[Vector, jax.Array]:
            key, y = jax.random.split(jax.random.key(seed))[1], self.unflat(x)
            return flat(manifold.random_tangent(key, y)), vec.flatten_frame(manifold.basis(y))

        def nearest(a: Vector) -> Vector:
            return jax.lax.fori_loop(0, RESTORING_STEPS, lambda _, a: flat(manifold.restore(self.unflat(a))), a)

        def frame(x: Vector, v: Vector) -> jax.Array:
            return vec.flatten_frame(TangentBundle(manifold).spanning_frame((self.unflat(x), self.unflat(v))))

        self._random, self.at = compiled(point), compiled(at)
        self._violation = violation_kernel(manifold)
        self._nearest, self._frame = compiled(nearest), compiled(frame)

    def random(self, seed: int) -> np.ndarray:
        """A random point. Raises ``InvalidInputError`` where the equations of a level set have none."""
        if self._none:
            raise self._none
        return self._random(seed)

    @cached_property
    def _none(self) -> InvalidInputError | None:
        """The error of a level set without random points, in its own words: a compiled program has none."""
        if isinstance(self.manifold, LevelSet | Submanifold):
            try:
                self.manifold.random_point(jax.random.key(0))
            except InvalidInputError as error:
                return error
        return None

    def point(self, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A random point, a random tangent vector there, and the orthonormal basis of the tangent space, by rows."""
        x = self.random(seed)
        return x, *self.at(x, seed)

    def near(self, x: np.ndarray, rng: np.random.Generator, distance: float) -> np.ndarray:
        """A point of the manifold about this far from ``x``, or nearer, reached through the ambient space.

        Nearer where inequalities, which ``restore`` does not see, do not hold so far from ``x``.
        """
        a = rng.standard_normal(x.size)
        u = a / np.linalg.norm(a)
        return next((y for y in self._candidates(x, distance * u) if self._violation(y)[0] <= precision().half), x)

    def _candidates(self, x: np.ndarray, step: np.ndarray) -> Iterator[np.ndarray]:
        return (self._nearest(x + 2.0**-k * step) for k in range(DRAW_HALVINGS))

    def bundle_frame(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Frame of the tangent space of ``TM`` at ``(x, v)``, by rows; its second half is ``(0, e_i)``."""
        return self._frame(x, v)

    @cached_property
    def cotangent(self) -> "Sampler":
        """Draws on the cotangent bundle."""
        return Sampler(CotangentBundle(self.manifold))


class DomainEdge:
    """How far a retraction's domain reaches from a point in a direction without a gap.

    ``margin`` is how near its edge, relatively, the domain is to be trusted: ``sqrt(eps)``, and 1e-2 where it is
    derived from a round trip, as there rounding decides whether Newton's method ends. A gap between two of 16 multiples
    is not seen: domains that lack isolated multiples of a vector are taken to hold them.
    """

    def __init__(self, retraction: Retraction) -> None:
        back = unflat(retraction.manifold)
        self._derived = "domain" not in retraction.closed_forms
        self.margin, self._bisections = (1e-2, 14) if self._derived else (precision().half, 52)
        self._domain = compiled(lambda x, v: retraction.domain(back(x), back(v)))
        self._preimages = compiled(jax.vmap(lambda x, y: flat(retraction.preimage(back(x), back(y))), (None, 0)))
        self.move = compiled(lambda x, v: flat(retraction(back(x), back(v))))

    def preimage(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """``R_x^-1(y)``, from a batch of one."""
        return self._preimages(x, y[None])[0]

    def _inside(self, x: np.ndarray, v: np.ndarray) -> bool:
        if not self._derived:
            return bool(self._domain(x, v))
        # The round trip by the kernels that the checks of the inverse read: Newton's method takes long to compile.
        return bool(same_point(self.preimage(x, self.move(x, v)), v, default_tolerance()))

    def __call__(self, x: np.ndarray, u: np.ndarray, longest: float) -> float:
        """Length up to which the multiples of the unit tangent vector ``u`` lie in the domain, at most
        ``longest``."""
        rungs = longest * np.arange(RUNGS + 1) / RUNGS
        outside = next((k for k in range(1, RUNGS + 1) if not self._inside(x, rungs[k] * u)), None)
        if outside is None:
            return longest
        low, high = rungs[outside - 1], rungs[outside]
        for _ in range(self._bisections):
            middle = (low + high) / 2
            low, high = (middle, high) if self._inside(x, middle * u) else (low, middle)
        return float(low)
