"""Goh's reductions of a singular problem, one after the other, down to a regular one."""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ....compute.jit_cache import compile_function
from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ....manifolds.numerics.root import known_root
from ...problem.initial_controls import resting_control
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.pontryagin import find_control
from ...problem_checks.requirements import require_treated
from .control_affine_splitting import affine_tolerance, first_finite, relative_curvature
from .goh_reduction import REDUCTION_SAMPLES, GohReduction, Near, states_near
from .hamiltonian_leaf_flow import Point, ambient_field


class ExtremalPoint(NamedTuple):
    """A point of ``P_f``: position, costate and control, and whether the equations for the control are solved."""

    q: Ambient
    p: Ambient
    u: Array
    found: Bool[Array, ""]


@final
class ReductionChain(eqx.Module):
    """Reductions of which each takes up the problem that the one before leaves, and the last leaves a regular one.

    They identify ``P_f`` with the cotangent bundle of the last reduced manifold ``Q_r``, and ``omega_f`` with its
    canonical form.
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
        """The chain of reductions for a problem with the same control fields and other data."""
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
        """The point of ``P_f`` over a point of ``T*Q_r``, with the control of the regular problem that is near
        ``near``."""
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


def reduce_until_regular(
    problem: OptimalControlProblem, singular: tuple[int, ...] | None = None, near: Near | None = None
) -> ReductionChain:
    """Goh's reduction by the controls ``singular``, repeated until the reduced Hamiltonian is affine in no control.

    By default ``singular`` are the controls in which the Hamiltonian is affine. ``near``: a state and a control around
    which the problem's functions are looked at, by default random ones. Raises ``InvalidInputError`` where there are no
    such controls, or a reduction does not apply.
    """
    require_treated(problem, "reduce_until_regular", "an initial cost")
    affine, reductions = affine_controls(problem, near) if singular is None else singular, list[GohReduction]()
    if not affine:
        raise InvalidInputError("there is nothing to reduce: the Hamiltonian has a second derivative in every control")
    while affine:
        reductions.append(GohReduction(problem, affine, near))
        near = None if near is None else reductions[-1].below(*near)
        problem = reductions[-1].reduced
        affine = affine_controls(problem, near)
    return ReductionChain(tuple(reductions))


def affine_controls(problem: OptimalControlProblem, near: Near | None = None) -> tuple[int, ...]:
    """Indices of the controls in which the Hamiltonian is affine, none if the problem is regular, at points ``near``.

    Raises ``InvalidInputError`` if it is singular in more than these controls.
    """
    keys = jax.random.split(jax.random.key(0), REDUCTION_SAMPLES)
    hessians = np.stack([jax.device_get(_control_hessian(problem, key, near)) for key in keys])
    if not np.all(np.isfinite(hessians)):
        raise InvalidInputError(
            f"the second derivative of the Hamiltonian in the controls of the problem on {problem.manifold} is not "
            "finite where it was looked at; give near, a state and a control where it is"
        )
    rows = np.max(np.abs(hessians), axis=(0, 1))
    curved = rows > affine_tolerance()
    block = (hessians / np.sqrt(np.outer(rows, rows) + ~np.outer(curved, curved)))[:, curved][:, :, curved]
    values = np.linalg.svd(block, compute_uv=False)
    if not np.all(values > default_tolerance()):
        raise InvalidInputError(
            f"the second derivative of the Hamiltonian in the controls {np.flatnonzero(curved).tolist()} of the "
            f"problem on {problem.manifold} has singular values {values[0]}, expected all positive: it is singular in "
            "combinations of them; take these as controls of their own"
        )
    return tuple(int(i) for i in np.flatnonzero(~curved))


@compile_function
def _control_hessian(problem: OptimalControlProblem, key: Array, near: Near | None) -> Array:
    """Relative ``d2H/du2`` at a random state and control, as near to ``near`` as it is finite."""
    return first_finite(jax.vmap(lambda z, u: relative_curvature(problem, z, u))(*states_near(problem, key, near)))
