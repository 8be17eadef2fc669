"""Goh's reduction: singular controls that act along constant directions are replaced by what they integrate to.

[Goh, Necessary conditions for singular extremals involving multiple control variables, 1966; Kelley, A transformation
approach to singular subarcs in optimal trajectory and control problems, 1964]
"""

from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....compute.jit_cache import compile_function
from ....manifolds import Euclidean, InvalidInputError, Manifold, Product
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ....manifolds.numerics.tolerances import tolerance
from ....retractions import default_retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from .control_affine_splitting import (
    POINT_DISTANCES,
    affine_tolerance,
    check_splitting,
    first_finite,
    merge_controls,
    regular_places,
    relative_curvature,
)
from .euclidean_part import EuclideanPart
from .hamiltonian_leaf_flow import Point

Near = tuple[Any, Any]  # a point of Q and a control

CONSTANT_POWER = 0.8  # of the machine epsilon: relative changes and brackets that are rounding
MISSED_POTENTIAL = 1e-4  # of half of the digits: what the derivative of a potential may miss the cost by
REDUCTION_SAMPLES = 3  # random points at which a reduction is checked
# Gauss-Legendre quadrature on [0, 1], exact for polynomials of degree 19.
_NODES, _WEIGHTS = ((np.polynomial.legendre.leggauss(10)[i] + (1 - i)) / 2 for i in (0, 1))


@final
class GohReduction(eqx.Module):
    """The reduction of ``q' = f(q, v) + sum_a u_a g_a``, cost ``F(q, v) + l(q) . u``, by singular controls ``u``.

    The fields ``g_a`` must be constant, along Euclidean factors of Q: columns of the matrix ``G`` on the gathered
    Euclidean part ``x = N y + G s``, ``N`` an orthonormal basis of the complement. Then ``s' = (f)_s + u``, so that
    ``s`` serves as a control instead of ``u``, of a problem on ``Q_r``: Q without the directions ``G``. Where the
    primary constraints ``phi_a = <p, g_a> - l_a`` commute there is a potential ``lambda(q)`` with ``d lambda / ds =
    l``, and

        ``int F + l . u dt = int F - D lambda [f] dt + lambda(end) - lambda(begin)``.

    ``reduced`` is the problem with the dynamics of ``(other factors, y)``, that running cost and the controls ``(v,
    s)``. On ``{phi = 0}`` its costate is that of ``p - d lambda``, its Hamiltonian is ``H``, its canonical form that of
    T*Q, and ``dH/ds = 0`` says that ``{phi, H} = 0``. Terminal cost and boundary conditions are not reduced: ``s`` may
    jump at the ends of an arc.

    ``singular``: indices of ``u`` among the controls; ``near``: a state and a control around which the problem's
    functions are looked at, by default random ones. Raises ``InvalidInputError`` if the fields are not constant along
    Euclidean factors or dependent, if the constraints do not commute, or if the functions are not finite there.
    """

    problem: OptimalControlProblem
    singular: tuple[int, ...] = eqx.field(static=True)
    directions: Float[Array, "k m"]
    inverse: Float[Array, "m k"]
    complement: Float[Array, "k k-m"]
    costly: bool = eqx.field(static=True)

    def __init__(self, problem: OptimalControlProblem, singular: tuple[int, ...], near: Near | None = None) -> None:
        check_splitting(problem, singular)
        self.problem, self.singular = problem, tuple(singular)
        keys = jax.random.split(jax.random.key(0), REDUCTION_SAMPLES)
        points, samples = zip(
            *(jax.device_get(_sample(problem, self.singular, key, near)) for key in keys), strict=True
        )
        directions = _constant_directions(problem, self.singular, samples)
        columns = np.linalg.qr(directions, mode="complete")[0]
        self.directions, self.inverse = jnp.asarray(directions), jnp.asarray(np.linalg.pinv(directions))
        self.complement = jnp.asarray(columns[:, len(singular) :])
        self.costly = any(np.any(sample.rates) for sample in samples)
        if self.costly:
            _check_potential(self, points)

    @property
    def part(self) -> EuclideanPart:
        """Q as the product of a Euclidean space and its other factors."""
        return EuclideanPart(self.problem.manifold)

    @property
    def manifold(self) -> Manifold:
        """The manifold ``Q_r``: the unreduced factors of Q, then the rest of the Euclidean factors as one factor."""
        flat = Euclidean(self.complement.shape[1])
        return Product(*self.part.others, flat) if self.part.others else flat

    @property
    def reduced(self) -> OptimalControlProblem:
        """The reduced problem on ``Q_r``, in the controls ``(v, s)``."""
        return OptimalControlProblem(
            self.manifold, self._velocity, self._cost, self.problem.controls.dimension, abnormal=self.problem.abnormal
        )

    def coordinates(self, q: Ambient) -> tuple[Ambient, Float[Array, " m"]]:
        """Point of ``Q_r`` and ``s``."""
        others, x = self.part.split(q)
        return self._pack(others, self.complement.T @ x), self.inverse @ x

    def below(self, q: Ambient, u: Float[Array, " r+m"]) -> Near:
        """The point of ``Q_r`` and the control ``(v, s)`` of the reduced problem, of a state and a control of the
        problem."""
        q_r, s = self.coordinates(q)
        return q_r, jnp.concatenate([jnp.asarray(u)[regular_places(len(u), self.singular)], s])

    def point(self, q_r: Ambient, s: Float[Array, " m"]) -> Ambient:
        """The point of Q with these coordinates."""
        others, y = self._unpack(q_r)
        return self.part.join(others, self.complement @ y + self.directions @ s)

    def potential(self, q: Ambient) -> Array:
        """``lambda(q)``: the integral of ``l . ds`` from ``s = 0``, all else kept."""
        q_r, s = self.coordinates(q)
        rates = jax.vmap(lambda t: control_rates(self.problem, self.singular, self.point(q_r, t * s)))(
            jnp.asarray(_NODES)
        )
        return jnp.asarray(_WEIGHTS) @ (rates @ s)

    def down(self, q: Ambient, p: Ambient) -> tuple[Ambient, Ambient]:
        """The point ``(q_r, p_r)`` of ``T*Q_r`` that a point of ``{phi = 0}`` goes to."""
        others, x = self.part.split(vec.subtract(p, self._shift(q)))
        return self.coordinates(q)[0], self._pack(others, self.complement.T @ x)

    def up(self, q_r: Ambient, p_r: Ambient, s: Float[Array, " m"]) -> tuple[Ambient, Ambient]:
        """The point of ``{phi = 0}`` with reduced point ``(q_r, p_r)`` and coordinates ``s`` of Q along the
        directions."""
        q, (others, y) = self.point(q_r, s), self._unpack(p_r)
        return q, vec.add(self.part.join(others, self.complement @ y), self._shift(q))

    def controls(self, q: Ambient, v: Float[Array, " r"], rate: Float[Array, " m"]) -> Float[Array, " r+m"]:
        """All controls of the problem with which ``s`` has a given rate: ``u = s' - (f)_s``."""
        drift = self.part.split(self._drift(q, v))[1]
        return merge_controls(v, rate - self.inverse @ drift, self.singular)

    def _drift(self, q: Ambient, v: Float[Array, " r"]) -> Ambient:
        return self.problem.velocity(q, self._resting_controls(v))

    def _resting_controls(self, v: Float[Array, " r"]) -> Float[Array, " r+m"]:
        return merge_controls(v, jnp.zeros(len(self.singular)), self.singular)

    def _velocity(self, q_r: Ambient, c: Float[Array, " r+m"]) -> Ambient:
        v, s = self.parts(c)
        others, x = self.part.split(self._drift(self.point(q_r, s), v))
        return self._pack(others, self.complement.T @ x)

    def _cost(self, q_r: Ambient, c: Float[Array, " r+m"]) -> Array:
        v, s = self.parts(c)
        q = self.point(q_r, s)
        cost = self.problem.cost_rate(q, self._resting_controls(v))
        return cost - jax.jvp(self.potential, (q,), (self._drift(q, v),))[1] if self.costly else cost

    def parts(self, c: Float[Array, " r+m"]) -> tuple[Float[Array, " r"], Float[Array, " m"]]:
        """``v`` and ``s`` of the reduced problem's controls."""
        return c[: -len(self.singular)], c[-len(self.singular) :]

    def _shift(self, q: Ambient) -> Ambient:
        """``d lambda`` at ``q``."""
        manifold = self.problem.manifold
        return manifold.projection(q, vec.gradient(self.potential, q)) if self.costly else vec.zeros(manifold.ambient)

    def _pack(self, others: tuple[Ambient, ...], y: Array) -> Ambient:
        return (*others, y) if others else y

    def _unpack(self, a: Ambient) -> tuple[tuple[Ambient, ...], Array]:
        return (tuple(a[:-1]), a[-1]) if self.part.others else ((), a)


def control_rates(problem: OptimalControlProblem, singular: tuple[int, ...], q: Ambient) -> Float[Array, " m"]:
    """``l(q)``, the derivative of the running cost by the singular controls."""
    return jax.grad(lambda u: problem.cost_rate(q, u))(jnp.zeros(problem.controls.dimension))[np.asarray(singular)]


class _Sample(NamedTuple):
    """At one point: the control fields in the other factors and in the Euclidean part, ``l``, and the curvature of
    H."""

    others: Array
    fields: Array
    rates: Array
    curvature: Array


@compile_function
def _sample(
    problem: OptimalControlProblem, singular: tuple[int, ...], key: Array, near: Near | None
) -> tuple[Ambient, _Sample]:
    """A point, and what is found there."""
    places = np.asarray(singular)

    def at(z: Point, u: Array) -> tuple[Ambient, _Sample]:
        def along(u: Array) -> tuple[Array, Array, Array]:
            others, x = EuclideanPart(problem.manifold).split(problem.velocity(z[0], u))
            leaves = [jnp.ravel(leaf) for leaf in jax.tree.leaves(others)]
            return jnp.concatenate([jnp.zeros(0), *leaves]), x, problem.cost_rate(z[0], u)

        curvature = relative_curvature(problem, z, u)[places]
        others, fields, rates = (leaf[..., places] for leaf in jax.jacfwd(along)(u))
        return z[0], _Sample(others, fields, rates, curvature)

    return first_finite(jax.vmap(at)(*states_near(problem, key, near)))


def states_near(problem: OptimalControlProblem, key: Array, near: Near | None) -> tuple[Point, Array]:
    """Batches of states, around ``near`` nearer and nearer to it, and of controls."""
    first, second, third, fourth = jax.random.split(key, 4)
    manifold, shares = problem.manifold, jnp.asarray(POINT_DISTANCES)
    q, u = near or (manifold.random_point(first), jnp.zeros(problem.controls.dimension))
    direction, turn = manifold.random_tangent(second, q), jax.random.normal(third, u.shape, u.dtype)
    move = default_retraction(manifold)
    points = jax.vmap(lambda share: move(q, vec.scale(share, direction)))(shares)
    return (points, jax.vmap(lambda q: manifold.random_tangent(fourth, q))(points)), u + shares[:, None] * turn


def _constant_directions(
    problem: OptimalControlProblem, singular: tuple[int, ...], samples: tuple[_Sample, ...]
) -> np.ndarray:
    """``G``. Raises ``InvalidInputError`` if there is none."""
    begin = f"no reduction of the problem on {problem.manifold} by the controls {singular}:"
    others, fields, rates, curvature = (np.stack(parts) for parts in zip(*samples, strict=True))
    if not all(np.all(np.isfinite(values)) for values in (others, fields, rates, curvature)):
        raise InvalidInputError(
            f"{begin} its functions or their derivatives are not finite where they were looked at; give near"
        )
    size = np.max(np.abs(np.concatenate([others, fields], axis=1)), axis=(0, 1))  # of each field
    constant = tolerance(fields, CONSTANT_POWER) * size
    findings = {
        "H is not affine in them: relative to it, its second derivatives reach": (
            np.moveaxis(curvature, 1, 2),
            affine_tolerance(),
        ),
        "their fields have parts along factors that are not Euclidean, of size": (others, constant),
        "their fields are not constant: between two points they change by": (fields - fields[0], constant),
    }
    for words, (values, allowed) in findings.items():
        if np.any(np.abs(values) > allowed):
            raise InvalidInputError(
                f"{begin} {words} {np.max(np.abs(values)):.3g}, expected 0; change coordinates so that they are "
                "constant"
            )
    values = np.linalg.svd(fields[0] / np.where(size > 0, size, 1.0), compute_uv=False)
    if len(values) < len(singular) or not values[-1] > default_tolerance() * values[0]:
        raise InvalidInputError(
            f"{begin} the singular values of their fields, of size one, are {values}, expected {len(singular)} "
            "positive ones; a control without effect on the motion is gauge, or P_f empty"
        )
    return fields[0]


def _check_potential(reduction: GohReduction, points: tuple[Ambient, ...]) -> None:
    """Raise if the derivative of ``lambda`` by ``s`` is not ``l``."""
    for q in points:
        missed, asymmetric = jax.device_get(_potential_gap(reduction, q))
        if not np.isfinite(missed + asymmetric):
            raise InvalidInputError(
                f"the potential of the cost of the controls {reduction.singular} is not finite: their cost has to be "
                "so on the way along their directions from the origin; move the origin of the coordinates, or use the "
                "strategy 'rattle'"
            )
        if asymmetric > tolerance(asymmetric, CONSTANT_POWER):
            raise InvalidInputError(
                f"the primary constraints of the controls {reduction.singular} do not commute: a bracket is "
                f"{asymmetric:.3g} of its terms, expected 0; reduce by fewer controls"
            )
        if missed > MISSED_POTENTIAL * default_tolerance():
            raise InvalidInputError(
                f"the potential of the cost of the controls {reduction.singular} misses it by {missed:.3g}: their cost "
                f"is too rough along their directions for the quadrature with {len(_NODES)} nodes; use the strategy "
                "'rattle'"
            )


@compile_function
def _potential_gap(reduction: GohReduction, q: Ambient) -> tuple[Array, Array]:
    """Size of ``d lambda / ds - l`` and of the brackets of the primary constraints, relative to ``l`` and its
    change."""
    q_r, s = reduction.coordinates(q)

    def rates(s: Array) -> Array:
        return control_rates(reduction.problem, reduction.singular, reduction.point(q_r, s))

    derivative = jax.grad(lambda s: reduction.potential(reduction.point(q_r, s)))(s)
    among = jax.jacfwd(rates)(s)
    size = vec.size(rates(s)) + vec.size(among) * vec.size(s)
    unit = jnp.where(size > 0, size, 1.0)
    return vec.size(derivative - rates(s)) / unit, vec.size(among - among.T) * vec.size(s) / unit
