"""Problems that are affine in some of their controls: the splitting ``H(q, p, u) = H_0(q, p) + s . phi(q, p)``."""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....manifolds import Euclidean, InvalidInputError
from ....manifolds.numerics.ambient import Ambient
from ...initial_value.integrator import find_control
from ...problem import OptimalControlProblem
from .leaves import Constraints, Point, ambient_field, bracket, bracket_size


class Brackets(NamedTuple):
    """Poisson brackets of functions with others, and the sizes of the terms that they are sums of."""

    values: Float[Array, "m m"]
    sizes: Float[Array, "m m"]


@final
class ControlAffineSplitting(eqx.Module):
    """A problem whose Pontryagin Hamiltonian is affine in the controls ``s = u[singular]`` and regular in the others, ``w``.

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
        """The problem with ``s = 0``, in the controls ``w``: its extremals are those of ``H_0``."""
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
        """The extremal ``w(q, p)`` near ``near``, by default near zero; entries are NaN where Newton's method finds none."""
        w, found = find_control(self.regular_problem(), q, p, jnp.zeros(self.regular_count) if near is None else near)
        return jnp.where(found, w, jnp.nan)

    def energy(self, q: Ambient, p: Ambient) -> Array:
        """``H_0(q, p)``, the value of H at ``s = 0`` and the extremal ``w``."""
        return self.regular_problem().hamiltonian(q, p, self.regular_controls(q, p))

    def secondary(self, q: Ambient, p: Ambient, near: Array | None = None) -> Float[Array, " m"]:
        """``psi = {phi, H_0}``: the rate of the primary constraints along the motion; ``near`` as for ``regular_controls``."""
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
    """The controls ``u`` with ``u[singular] = s`` and the others ``w``, in their order."""
    places, others = np.asarray(singular, int), regular_places(w.size + s.size, singular)
    return jnp.zeros(w.size + s.size, jnp.result_type(w, s)).at[others].set(w).at[places].set(s)


def regular_places(count: int, singular: tuple[int, ...]) -> np.ndarray:
    """Indices of the other controls, of ``count``."""
    return np.setdiff1d(np.arange(count), singular)


def check_splitting(problem: OptimalControlProblem, singular: tuple[int, ...]) -> None:
    """Raise if ``singular`` does not name controls of a Euclidean control space."""
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"expected an OptimalControlProblem, got {problem!r}")
    count = problem.controls.dimension
    named = all(isinstance(i, int) and 0 <= i < count for i in singular)
    if not (isinstance(problem.controls, Euclidean) and singular and named and len(set(singular)) == len(singular)):
        raise InvalidInputError(
            f"singular = {singular} must name controls by their indices in {problem.controls}; try singular=(0,)"
        )
