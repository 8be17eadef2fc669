"""Facts about cotangent lifts: discretization maps of a cotangent bundle that are symplectic."""

from collections.abc import Iterable
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import CotangentBundle, HomogeneousSpace, InvalidInputError
from ...manifolds.numerics.ambient import Ambient
from ...retractions import CotangentLift, DiscretizationMap
from ..numerics import Vector, flat, unflat
from ..properties import SAMPLE_SEEDS, Sample, examine
from ..report import Comparison, Inapplicable, Report, fact
from . import discretization as maps
from .discretization import MAP_REACH, DiscretizationFacts


class CotangentLiftFacts(DiscretizationFacts):
    """Measured facts of a discretization map of a cotangent bundle, with ``x = (q, p)`` and ``v = (qdot, pdot)``."""

    def __init__(
        self,
        lift: DiscretizationMap,
        *,
        equivariant: bool = False,
        symmetric: bool = False,
        reach: float = MAP_REACH,
        seeds: Iterable[int] = SAMPLE_SEEDS,
        points: Iterable[Ambient] = (),
        tolerance: float | None = None,
    ) -> None:
        super().__init__(lift, symmetric=symmetric, reach=reach, seeds=seeds, points=points, tolerance=tolerance)
        if not isinstance(self.manifold, CotangentBundle):
            raise InvalidInputError(
                f"a cotangent lift acts on a cotangent bundle, got one on {self.manifold}; try CotangentLift(map)"
            )
        self.base, self.equivariant = self.manifold.base, equivariant


def _base_ends(lift: CotangentLift, sample: Sample) -> dict:
    """The ends of the map that is lifted."""
    back = unflat(lift.discretization.manifold)
    q, qdot = (back(jnp.split(sample[name], 2)[0]) for name in ("x", "v"))
    return {"base": flat(lift.discretization(q, qdot))}


def _momenta(lift: DiscretizationMap, sample: Sample) -> dict:
    """Momentum of the group's action at both ends, and its derivative along the vector."""
    back, base = unflat(lift.manifold), cast(HomogeneousSpace, cast(CotangentBundle, lift.manifold).base)

    def momentum(z: Vector) -> Vector:
        return base.momentum(*back(z))

    first, second = lift(back(sample["x"]), back(sample["v"]))
    change = momentum(flat(second)) - momentum(flat(first))
    return {"change": change, "rate": jax.jvp(momentum, (sample["x"],), (sample["v"],))[1]}


def omega(n: int) -> np.ndarray:
    """Matrix of ``dq ^ dp`` on flat ``(q, p)`` with ``n`` entries each."""
    return np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(n))


def tangent_lift_of_omega(n: int) -> np.ndarray:
    """Matrix of ``d_T omega`` on ``(z, zdot)``: ``omega(adot, b) + omega(a, bdot)``."""
    return np.kron(np.array([[0.0, 1.0], [1.0, 0.0]]), omega(n))


def omega_of_both_ends(n: int) -> np.ndarray:
    """Matrix of ``Omega_12 = pr2* omega - pr1* omega`` on ``(z0, z1)``."""
    return np.kron(np.diag([-1.0, 1.0]), omega(n))


@fact
def lift_is_symplectic(facts: CotangentLiftFacts) -> Comparison:
    """The lift pulls ``pr2* omega - pr1* omega`` back to the tangent lift ``d_T omega``, at ``v = 0`` and elsewhere."""
    f = facts.measure(maps.both_ends, "zero", "inside")
    n, frame, push = f["x"].shape[1] // 2, f["frame"], f["push"]
    pulled = push @ omega_of_both_ends(n) @ np.swapaxes(push, 1, 2)
    return facts.compare(
        "|(R_d^T*)* Omega_12 - d_T omega|",
        f,
        pulled,
        frame @ tangent_lift_of_omega(n) @ np.swapaxes(frame, 1, 2),
        facts.tolerance,
    )


@fact
def ends_lie_over_those_of_the_map(facts: CotangentLiftFacts) -> Comparison | Inapplicable:
    """The base points ``(q0, q1)`` of the lift's ends are ``R_d(q, qdot)``."""
    if not isinstance(facts.subject, CotangentLift):
        return Inapplicable("the map that is lifted is not known")
    f, base = facts.measure(maps.both_ends, "inside"), facts.measure(_base_ends, "inside")
    q0, _, q1, _ = np.split(f["value"], 4, axis=1)
    return facts.compare(
        "|(q0, q1) - R_d(q, qdot)|", f, np.concatenate([q0, q1], axis=1), base["base"], facts.tolerance
    )


@fact
def momentum_changes_by_its_derivative_along_the_vector(facts: CotangentLiftFacts) -> Comparison | Inapplicable:
    """Lifts of equivariant maps: ``J(q1, p1) - J(q0, p0) = dJ(z)[zdot]``, hence their integrators conserve momenta."""
    if not facts.equivariant or not isinstance(facts.base, HomogeneousSpace):
        return Inapplicable("equivariance under the action of a group is not claimed")
    f = facts.measure(_momenta, "inside")
    return facts.compare("|J(q1, p1) - J(q0, p0) - dJ[zdot]|", f, f["change"], f["rate"], 10 * facts.tolerance)


COTANGENT_LIFT_CHECKS = (
    maps.zero_goes_to_the_base_point_twice,
    maps.derivatives_of_the_ends_at_zero_differ_by_the_identity,
    maps.ends_stay_on_the_manifold,
    maps.map_is_its_own_adjoint,
    maps.inverse_finds_the_tangent_vector,
    maps.map_inverts_its_inverse,
    lift_is_symplectic,
    ends_lie_over_those_of_the_map,
    momentum_changes_by_its_derivative_along_the_vector,
)


def check_cotangent_lift(
    lift: DiscretizationMap,
    *,
    equivariant: bool = False,
    symmetric: bool = False,
    reach: float = MAP_REACH,
    seeds: Iterable[int] = SAMPLE_SEEDS,
    points: Iterable[Ambient] = (),
    tolerance: float | None = None,
    only: Iterable[str] | str | None = None,
    skip: dict[str, str] | None = None,
    throw: bool = True,
) -> Report:
    """Measure whether a discretization map of a cotangent bundle is one, and symplectic.

    Parameters
    ----------
    lift : DiscretizationMap
        The map.
    equivariant : bool
        Whether the map on the base is claimed to commute with the group that acts there, so that momenta are conserved.
    symmetric, reach
        As in ``check_discretization_map``.
    seeds, points, tolerance, only, skip, throw
        As in ``check_manifold``; ``points`` are pairs in the shape of ``manifold.ambient``.

    Returns
    -------
    Report
        The outcomes.

    Raises
    ------
    ConformanceError
        If a fact does not hold and ``throw`` is true.
    """
    claims = {"equivariant": equivariant, "symmetric": symmetric, "reach": reach}
    facts = CotangentLiftFacts(lift, **claims, seeds=seeds, points=points, tolerance=tolerance)
    return examine(facts, COTANGENT_LIFT_CHECKS, only, skip, throw)
