"""Problems that are affine in some of their controls: the splitting ``H(q, p, u) = H_0(q, p) + s . phi(q, p)``."""

from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....manifolds import Euclidean, InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.pontryagin import find_control
from ...problem_checks.requirements import require_treated
from .hamiltonian_leaf_flow import Constraints, Point, ambient_field, bracket, bracket_size

AFFINE_POWER = 1.8  # of the default tolerance: second derivatives of H that are rounding
POINT_DISTANCES = (1.0, 0.1, 0.01, 0.0)  # how far from a point functions are looked at: less where they are not finite


class Brackets(NamedTuple):
    """Poisson brackets of functions, and the sizes of the terms of their sums."""

    values: Float[Array, "m m"]
    sizes: Float[Array, "m m"]


@final
class ControlAffineSplitting(eqx.Module):
    """A problem whose Pontryagin Hamiltonian is affine in ``s = u[singular]`` and regular in the remaining controls
    ``w``.

    ``H_0(q, p)`` is ``H`` at ``s = 0`` and the extremal ``w(q, p)``; ``phi = dH/ds`` are the primary constraints, and
    ``psi = {phi, H_0}`` the secondary ones.
    """

    problem: OptimalControlProblem
    singular: tuple[int, ...] = eqx.field(static=True)

    @property
    def regular_count(self) -> int:
        """Number of regular controls ``w``."""
        return self.problem.controls.dimension - len(self.singular)

    def controls(self, w: Float[Array, " r"], s: Float[Array, " m"]) -> Float[Array, " r+m"]:
        """All controls."""
        return merge_controls(w, s, self.singular)

    def regular_problem(self) -> OptimalControlProblem:
        """The problem with ``s = 0`` in the controls ``w``, whose extremals are the extremals of ``H_0``."""
        full = self.problem
        rest = jnp.zeros(len(self.singular))
        return OptimalControlProblem(
            full.manifold,
            lambda q, w: full.dynamics(q, self.controls(w, rest)),
            lambda q, w: full.running_cost(q, self.controls(w, rest)),
            Euclidean(self.regular_count),
            abnormal=full.abnormal,
        )

    def primary(self, q: Ambient, p: Ambient) -> Float[Array, " m"]:
        """``phi = dH/ds``."""
        w = jnp.zeros(self.regular_count)
        return jax.grad(lambda s: self.problem.hamiltonian(q, p, self.controls(w, s)))(jnp.zeros(len(self.singular)))

    def regular_controls(self, q: Ambient, p: Ambient, near: Array | None = None) -> Float[Array, " r"]:
        """The extremal ``w(q, p)`` near ``near``, by default near zero; entries are NaN where Newton's method finds
        none."""
        w, found = find_control(self.regular_problem(), q, p, jnp.zeros(self.regular_count) if near is None else near)
        return jnp.where(found, w, jnp.nan)

    def energy(self, q: Ambient, p: Ambient) -> Array:
        """``H_0(q, p)``, the value of H at ``s = 0`` and the extremal ``w``."""
        return self.regular_problem().hamiltonian(q, p, self.regular_controls(q, p))

    def secondary(self, q: Ambient, p: Ambient, near: Array | None = None) -> Float[Array, " m"]:
        """The rate ``psi = {phi, H_0}`` of the primary constraints along the motion; ``near`` as for
        ``regular_controls``."""
        regular, w = self.regular_problem(), self.regular_controls(q, p, near)
        motion = ambient_field(lambda q, p: regular.hamiltonian(q, p, w), (q, p))
        return jax.jvp(self.primary, (q, p), motion)[1]

    def fields(self, z: Point, near: Array | None = None) -> tuple[Point, Point]:
        """Fields of ``phi_a`` and of ``psi_a``, frames of ``m`` vectors each; ``near`` as for ``regular_controls``.

        ``{phi_a, phi_b}`` is zero, and ``{phi_a, psi_b}`` invertible, on ``P_f`` for first-order singular arcs.
        """

        def of(values: Constraints) -> Point:
            return jax.vmap(lambda a: ambient_field(lambda q, p: a @ values(q, p), z))(jnp.eye(len(self.singular)))

        return of(self.primary), of(lambda q, p: self.secondary(q, p, near))


def brackets(f: Point, g: Point) -> Brackets:
    """``{f_a, g_b}`` from frames of the fields of ``f_a`` and ``g_b``."""
    return Brackets(*(jax.vmap(lambda a, b=b: jax.vmap(lambda c: b(a, c))(g))(f) for b in (bracket, bracket_size)))


def merge_controls(w: Float[Array, " r"], s: Float[Array, " m"], singular: tuple[int, ...]) -> Float[Array, " r+m"]:
    """The controls ``u`` with ``u[singular] = s`` and the remaining entries ``w``, in their order."""
    places, others = np.asarray(singular, int), regular_places(w.size + s.size, singular)
    return jnp.zeros(w.size + s.size, jnp.result_type(w, s)).at[others].set(w).at[places].set(s)


def regular_places(count: int, singular: tuple[int, ...]) -> np.ndarray:
    """Indices of the other controls, of ``count``."""
    return np.setdiff1d(np.arange(count), singular)


def relative_curvature(problem: OptimalControlProblem, z: Point, u: Array) -> Float[Array, "m m"]:
    """``d2H/du2`` at a random control as near to ``u`` as it is finite, in controls of the size that changes H by its
    size.

    So it depends on no units; the size of H is that of its terms, ``|p| |X| + |F|``.
    """
    (q, p), direction = z, jax.random.normal(jax.random.key(0), u.shape, u.dtype)

    def relative(share: Array) -> Array:
        v = u + share * direction
        terms = vec.size(p) * vec.size(problem.velocity(q, v)) + jnp.abs(problem.cost_rate(q, v))
        fields, rates = jax.jacfwd(lambda v: (problem.velocity(q, v), problem.cost_rate(q, v)))(v)
        speeds = [jnp.max(jnp.abs(leaf.reshape(-1, v.size)), axis=0, initial=0.0) for leaf in jax.tree.leaves(fields)]
        slopes = vec.size(p) * jnp.max(jnp.stack(speeds), axis=0) + jnp.abs(rates)
        hessian = jax.hessian(lambda v: problem.hamiltonian(q, p, v))(v)
        return jnp.where(hessian == 0, 0.0, hessian * terms / jnp.outer(slopes, slopes))

    return first_finite(jax.vmap(relative)(jnp.asarray(POINT_DISTANCES)))


def first_finite(batch: Any) -> Any:
    """The first of a batch of trees all arrays of which are finite, or the first if none is."""
    finite = [jnp.all(jnp.isfinite(leaf.reshape(leaf.shape[0], -1)), axis=1) for leaf in jax.tree.leaves(batch)]
    index = jnp.argmax(jnp.all(jnp.stack(finite), axis=0))
    return vec.entries(batch, index)


def affine_tolerance() -> float:
    """Relative second derivatives of H that are rounding."""
    return default_tolerance() ** AFFINE_POWER


def check_splitting(problem: OptimalControlProblem, singular: tuple[int, ...]) -> None:
    """Raise if ``singular`` does not name controls of a Euclidean control space."""
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"expected an OptimalControlProblem, got {problem!r}")
    require_treated(problem, "a splitting of the controls", "an initial cost")
    count = problem.controls.dimension
    named = all(isinstance(i, int) and 0 <= i < count for i in singular)
    if not (isinstance(problem.controls, Euclidean) and singular and named and len(set(singular)) == len(singular)):
        raise InvalidInputError(
            f"singular = {singular} must name controls by their indices in {problem.controls}; try singular=(0,)"
        )
