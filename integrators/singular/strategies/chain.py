"""Goh's reductions of a singular problem, one after the other, down to a regular one."""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ....manifolds import InvalidInputError
from ....manifolds.manifold import default_tolerance
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.root import known_root
from ...compilation import compiled
from ...initial_value.integrator import extremal_control, find_control, resting_control
from ...problem import OptimalControlProblem
from .leaves import Point, ambient_field
from .reduction import SAMPLES, GohReduction


class ExtremalPoint(NamedTuple):
    """A point of ``P_f``: position, costate and control, and whether the equations for the control are solved."""

    q: Ambient
    p: Ambient
    u: Array
    found: Bool[Array, ""]


@final
class ReductionChain(eqx.Module):
    """Reductions of which each takes up the problem that the one before leaves, and the last leaves a regular one.

    They identify ``P_f`` with the cotangent bundle of the last reduced manifold ``Q_r``, and ``omega_f`` with its canonical form.
    """

    reductions: tuple[GohReduction, ...]

    @property
    def problem(self) -> OptimalControlProblem:
        """The problem that is reduced."""
        return self.reductions[0].problem

    @property
    def reduced(self) -> OptimalControlProblem:
        """The regular problem at the end."""
        return self.reductions[-1].reduced

    def of(self, problem: OptimalControlProblem) -> "ReductionChain":
        """The same reductions of a problem with other data but these control fields."""
        made: list[GohReduction] = []
        for reduction in self.reductions:
            made.append(eqx.tree_at(lambda r: r.problem, reduction, made[-1].reduced if made else problem))
        return ReductionChain(tuple(made))

    def down(self, q: Ambient, p: Ambient) -> tuple[Point, Array]:
        """Point of ``T*Q_r`` of a point of ``P_f``, and a guess of the regular problem's control there."""
        s = jnp.zeros(0)
        for reduction in self.reductions:
            s, (q, p) = reduction.coordinates(q)[1], reduction.down(q, p)
        rest = jnp.asarray(resting_control(self.reduced.controls))
        return (q, p), rest.at[rest.size - s.size :].set(s)

    def up(self, z: Point, near: Array) -> ExtremalPoint:
        """The point of ``P_f`` over a point of ``T*Q_r``, with the control of the regular problem that is near ``near``."""
        regular = self.reduced
        root, found = find_control(regular, *z, near)

        def control(z: Point) -> Array:
            return known_root(jax.grad(lambda u: regular.hamiltonian(*z, u)), root)

        def motion(z: Point) -> Point:
            u = control(z)
            return ambient_field(lambda q, p: regular.hamiltonian(q, p, u), z)

        def ascend(level: int, z: Point) -> tuple[Point, Array]:
            if level == len(self.reductions):
                return z, control(z)
            ((q, p), c), (_, rates) = jax.jvp(lambda y: ascend(level + 1, y), (z,), (motion(z),))
            reduction = self.reductions[level]
            (v, s), (_, rate) = reduction.parts(c), reduction.parts(rates)
            q, p = reduction.up(q, p, s)
            return (q, p), reduction.controls(q, v, rate)

        (q, p), u = ascend(0, z)
        return ExtremalPoint(q, p, u, found)


def reduce_until_regular(problem: OptimalControlProblem, singular: tuple[int, ...] | None = None) -> ReductionChain:
    """Goh's reduction by the controls ``singular``, then by those in which the reduced Hamiltonian is affine, until none is.

    By default the first ones, too, are those in which the Hamiltonian is affine. Raises ``InvalidInputError`` where there are
    none, or a reduction does not apply.
    """
    affine, reductions = affine_controls(problem) if singular is None else singular, list[GohReduction]()
    if not affine:
        raise InvalidInputError("there is nothing to reduce: the Hamiltonian has a second derivative in every control")
    while affine:
        reductions.append(GohReduction(problem, affine))
        problem = reductions[-1].reduced
        affine = affine_controls(problem)
    return ReductionChain(tuple(reductions))


def affine_controls(problem: OptimalControlProblem) -> tuple[int, ...]:
    """Indices of the controls in which the Hamiltonian is affine, none if the problem is regular, at random points.

    Raises ``InvalidInputError`` if it is singular in more than these controls.
    """
    keys = jax.random.split(jax.random.key(0), SAMPLES)
    hessians = np.stack([jax.device_get(_control_hessian(problem, key)) for key in keys])
    size = np.max(np.abs(hessians))
    curved = np.max(np.abs(hessians), axis=(0, 1)) > default_tolerance() * size
    values = np.linalg.svd(hessians[:, curved][:, :, curved], compute_uv=False)
    if not np.all(values > default_tolerance() * size):
        raise InvalidInputError(
            f"the second derivative of the Hamiltonian in the controls {np.flatnonzero(curved).tolist()} of the problem on "
            f"{problem.manifold} has singular values {values[0]}, expected all positive: it is singular in combinations of them; "
            "take these as controls of their own"
        )
    return tuple(int(i) for i in np.flatnonzero(~curved))


@compiled
def _control_hessian(problem: OptimalControlProblem, key: Array) -> Array:
    """``d2H/du2`` at a random point of T*Q and the extremal control there, or the resting one if there is none."""
    first, second = jax.random.split(key)
    q = problem.manifold.random_point(first)
    p = problem.manifold.random_tangent(second, q)
    return jax.hessian(lambda u: problem.hamiltonian(q, p, u))(extremal_control(problem, q, p))
