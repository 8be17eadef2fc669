"""Integration of singular problems through Goh's reduction to a regular one."""

from typing import ClassVar, NamedTuple, Self, final

import numpy as np
from jaxtyping import Array, ArrayLike

from ....compute.jit_cache import compile_function
from ....manifolds import Euclidean, InvalidInputError, Manifold, NotOnManifoldError, Product
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ....retractions import CotangentLift, DiscretizationMap, ProductRetraction, Retraction, Theta, default_retraction
from ...initial_value.integrator import PresymplecticIntegrator
from ...initial_value.step import StepResult
from ...problem.optimal_control_problem import OptimalControlProblem, is_same_problem
from ...problem.pontryagin import find_control
from ...problem_checks.requirements import require_same_manifold
from ..integrability import Classification
from .goh_chain import ExtremalPoint, ReductionChain, reduce_until_regular
from .hamiltonian_leaf_flow import Point
from .strategy import Gauge, NotApplicableError, SingularIntegrator


class _Memory(NamedTuple):
    """Unknowns of the stage of the regular problem, and the control of the singular one at the end of the step."""

    stage: tuple[Ambient, Array]
    control: Array


@final
class ReducedIntegrator(SingularIntegrator):
    """A presymplectic integrator on ``P_f`` for problems that Goh's reduction makes regular.

    One step goes down from ``P_f`` to ``T*Q_r``, takes a step of the regular problem there, and comes up with the
    extremal control at its end: it preserves ``P_f`` and ``omega_f``, is symmetric if the discretization is, and of its
    order. The controls are those at the end of each step, and so of the order of the nodes.

    ``chain``: from ``reduce_until_regular``. ``discretization``: a discretization map on ``Q_r``; by default the one
    that is lifted on Q, factor by factor, with addition on the Euclidean part.
    """

    lift: CotangentLift
    chain: ReductionChain
    discretization: DiscretizationMap | None = None
    presymplectic: ClassVar[bool] = True

    def __check_init__(self) -> None:
        if not isinstance(self.chain, ReductionChain):
            raise InvalidInputError(
                f"ReducedIntegrator takes a chain of reductions, got {self.chain!r}; try reduce_until_regular(problem)"
            )
        require_same_manifold(self.chain.problem, self.lift.discretization)
        require_same_manifold(self.chain.reduced, self.regular.discretization)

    @property
    def regular(self) -> PresymplecticIntegrator:
        """The integrator of the regular problem on ``Q_r``."""
        given, reduced = self.discretization, self.chain.reduced.manifold
        return PresymplecticIntegrator(
            CotangentLift(_restrict(self.lift.discretization, reduced) if given is None else given)
        )

    @classmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> tuple[Self, str]:
        problem, stratum = classification.problem, classification.stratum
        if not isinstance(problem.controls, Euclidean):
            raise NotApplicableError(f"the controls lie on {problem.controls}, in which H cannot be affine")
        if classification.gauge_controls:
            raise NotApplicableError("a gauge control has no value that a reduction to a regular problem would leave")
        try:
            integrator = cls(lift=lift, chain=reduce_until_regular(problem, near=(stratum.q, stratum.u)))
        except InvalidInputError as error:
            raise NotApplicableError(str(error)) from error
        reduced, count = integrator.chain.reduced.manifold, len(integrator.chain.reductions)
        if 2 * reduced.dimension != classification.dimension:
            raise NotApplicableError(
                f"the reduction is to the cotangent bundle of {reduced}, but P_f has dimension "
                f"{classification.dimension}"
            )
        times = "once" if count == 1 else f"{count} times"
        return integrator, f"P_f is the cotangent bundle of {reduced}, by Goh's reduction {times}"

    @property
    def control_times(self) -> np.ndarray:
        return np.asarray(1.0)

    def check(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> None:
        if not is_same_problem(system, self.chain.problem):
            raise InvalidInputError(
                "the reductions of this integrator are those of another problem; make them from this one"
            )
        z, at = _there_and_back(self.chain, q, p)
        gap = float(vec.size(vec.subtract((at.q, at.p), (q, system.manifold.projection(q, p)))))
        if not (at.found and gap <= default_tolerance() * (1 + float(vec.size((q, p))))):
            raise NotOnManifoldError(
                "start is not on the constraint manifold: the point of it with the same reduced state, "
                f"{(at.q, at.p)}, is {gap:.3g} away, expected 0; start there"
            )
        self.regular.check(self.chain.reduced, *z)

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> _Memory:
        chain = self.chain.of(system)
        z, near = chain.down(q, p)
        control, _ = find_control(chain.reduced, *z, near)
        return _Memory((z[0], control), chain.up(z, control).u)

    def unchecked_step(
        self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: _Memory
    ) -> StepResult:
        chain = self.chain.of(system)
        z, _ = chain.down(q, p)
        new = self.regular.step(chain.reduced, h, *z, previous.stage)
        at = chain.up((new.q, new.p), new.unknowns[1])
        return StepResult(at.q, at.p, _Memory(new.unknowns, at.u), new.converged & at.found)

    def control(self, unknowns: _Memory) -> Array:
        return unknowns.control


@compile_function
def _there_and_back(chain: ReductionChain, q: Ambient, p: Ambient) -> tuple[Point, ExtremalPoint]:
    z, near = chain.down(q, p)
    return z, chain.up(z, near)


def _restrict(discretization: DiscretizationMap, reduced: Manifold) -> DiscretizationMap:
    """A discretization on the factors that a reduction leaves as they are, with addition on the Euclidean part."""
    if not isinstance(discretization, Theta):
        raise _unrestrict(discretization, reduced)
    backward, other = discretization.backward, discretization.other
    forward = None if other is None else _restrict_retraction(other, reduced)
    return Theta(_restrict_retraction(backward, reduced), discretization.theta, forward)


def _restrict_retraction(retraction: Retraction, reduced: Manifold) -> Retraction:
    if not isinstance(reduced, Product):
        return default_retraction(reduced)
    kept = [r for r in _factors(retraction) if not isinstance(r.manifold, Euclidean)]
    if any(isinstance(r.manifold, Product) for r in kept):
        raise _unrestrict(retraction, reduced)
    return ProductRetraction(*kept, default_retraction(reduced.factors[-1]))


def _factors(retraction: Retraction) -> list[Retraction]:
    if isinstance(retraction, ProductRetraction):
        return [leaf for factor in retraction.factors for leaf in _factors(factor)]
    return [retraction]


def _unrestrict(given: DiscretizationMap | Retraction, reduced: Manifold) -> InvalidInputError:
    return InvalidInputError(
        f"{type(given).__name__} does not act factor by factor, so that it could be restricted to {reduced}; give "
        "ReducedIntegrator a discretization there, for instance Midpoint(default_retraction(chain.reduced.manifold))"
    )
