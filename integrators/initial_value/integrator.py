"""Integrators of initial-value problems on T*Q."""

from abc import abstractmethod
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...compute.jit_cache import compile_function
from ...errors import FAILURES, TRACEABLE
from ...manifolds import InvalidInputError, Manifold, RetraxError
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.attribute import attribute
from ...manifolds.numerics.rank import is_regular, pivotal_values
from ...retractions import CollocationMethod, CotangentLift, DiscretizationMap, Retraction, default_retraction
from ...tracing import one_tracing
from ..problem.argument_errors import require_arguments
from ..problem.initial_controls import resting_control
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.pontryagin import extremal_control
from ..problem.user_functions import real_number
from ..problem_checks.requirements import require_retraction, require_same_manifold, require_treated
from ..problem_checks.smoothness.derivative_check import require_correct_hamiltonian_derivatives
from ..stages import CollocationStage, ControlStage, HamiltonianStage, Stage
from ..stages.collocation import CollocationUnknowns
from ..stages.hamiltonian import Hamiltonian
from .step import StepResult, lifted_step, restore


class Integrator(eqx.Module):
    """A one-step method on ``T*Q``: a base class with the abstract methods below.

    Examples
    --------
    >>> isinstance(SymplecticIntegrator(Gauss(2, Cayley(SO(3)))), Integrator)
    True
    """

    @attribute
    @abstractmethod
    def manifold(self) -> Manifold:
        """The configuration manifold Q."""

    @attribute
    @abstractmethod
    def control_times(self) -> np.ndarray:
        """The times of the controls in fractions of the step, shaped like the leading axes of ``control``."""

    @abstractmethod
    def check(self, system: Any, q: Ambient, p: Ambient) -> None:
        """Raise an error if ``system`` cannot be integrated from ``(q, p)``.

        Parameters
        ----------
        system : callable or OptimalControlProblem
            The system.
        q, p : point, covector
            The start.
        """

    @abstractmethod
    def begin(self, system: Any, q: Ambient, p: Ambient) -> Any:
        """The unknowns from which the first step is predicted.

        Parameters
        ----------
        system, q, p
            As in ``check``.
        """

    @abstractmethod
    def step(self, system: Any, h: ArrayLike, q: Ambient, p: Ambient, previous: Any) -> StepResult:
        """One step of size ``h`` from ``(q, p)``, predicted from the unknowns of the step before.

        Parameters
        ----------
        system : callable or OptimalControlProblem
            The system.
        h : float
            The step.
        q, p : point, covector
            The state before the step.
        previous : pytree
            The unknowns of the step before.
        """

    @abstractmethod
    def control(self, unknowns: Any) -> Any:
        """The control in the unknowns of a step; None if there is none.

        Parameters
        ----------
        unknowns : pytree
            The unknowns of a step.
        """

    def stage(self, system: Any, h: ArrayLike) -> Stage | None:
        """The stage of a whole step; None for steps of another form.

        Parameters
        ----------
        system, h
            As in ``step``.
        """
        return None

    def substeps(self) -> tuple["Integrator", np.ndarray]:
        """The integrator of the parts of a step, and these parts, shaped like the leading axes of ``control``."""
        return self, np.ones(())

    @property
    def retraction(self) -> Retraction:
        """A retraction of Q, whose charts connect two states."""
        return default_retraction(self.manifold)

    def energy(self, system: Any, q: Ambient, p: Ambient, control: Any) -> Array | None:
        """The Hamiltonian of a system, which must not jump; None if there is none.

        Parameters
        ----------
        system, q, p, control
            The system, a state, and a control or None.
        """
        return None

    def hint(self, system: Any, first: tuple[Ambient, Ambient], last: tuple[Ambient, Ambient]) -> str:
        """A hint for the error of a step without a solution: a possible reason, in words.

        Parameters
        ----------
        system, first, last
            The system, and the pairs ``(q, p)`` of the start and of the last state.
        """
        return ""


class LiftedIntegrator(Integrator):
    """A method on ``T*Q`` built on the cotangent lift of a discretization map.

    Examples
    --------
    >>> issubclass(SingularIntegrator, LiftedIntegrator)
    True
    """

    @attribute
    @abstractmethod
    def lift(self) -> CotangentLift:
        """The cotangent lift."""

    @property
    def manifold(self) -> Manifold:
        return self.lift.discretization.manifold

    @property
    def retraction(self) -> Retraction:
        return self.lift.discretization.retraction

    @property
    def control_times(self) -> np.ndarray:
        return np.asarray(self.lift.theta)


def check_hamiltonian(hamiltonian: Hamiltonian, q: Ambient, p: Ambient) -> None:
    """Raise unless a function ``H(q, p)`` returns a real number; asked once in a reading."""
    with one_tracing() as reading:
        key = "Hamiltonian", id(hamiltonian), str(jax.tree.map(jax.typeof, (q, p)))
        reading.once(key, lambda: (_check_hamiltonian(hamiltonian, q, p), hamiltonian))


def _check_hamiltonian(hamiltonian: Hamiltonian, q: Ambient, p: Ambient) -> None:
    require_arguments("the Hamiltonian", getattr(hamiltonian, "function", hamiltonian), "(q, p)")
    try:
        jax.eval_shape(lambda q, p: real_number("the Hamiltonian", hamiltonian(q, p)), q, p)
    except RetraxError:
        raise
    except FAILURES as error:
        traced = isinstance(error, jax.errors.JAXTypeError)
        reason, hint = ("JAX cannot trace it", TRACEABLE) if traced else (str(error), "index what is there")
        shapes = [jax.tree.map(np.shape, a) for a in (q, p)]
        at = f"(q, p) of shapes {shapes[0]} and {shapes[1]}"
        raise InvalidInputError(f"the Hamiltonian fails at {at}: {reason}; {hint}") from error


class VariationalIntegrator(Integrator):
    """Steps that are stationary points of a stage's generating function, by a lifted discretization map or a Gauss
    method."""

    method: CotangentLift | CollocationMethod

    def __check_init__(self) -> None:
        if not isinstance(self.method, CotangentLift | CollocationMethod):
            raise InvalidInputError(
                f"{type(self).__name__} takes a cotangent lift or a collocation method, got {self.method!r}; "
                "try CotangentLift(Midpoint(retraction)) or Gauss(3, retraction)"
            )

    @property
    def discretization(self) -> DiscretizationMap | CollocationMethod:
        """The discretization of Q: the Gauss method itself, or the map that is lifted."""
        return self.method if isinstance(self.method, CollocationMethod) else self.method.discretization

    @property
    def manifold(self) -> Manifold:
        return self.discretization.manifold

    @property
    def retraction(self) -> Retraction:
        return self.discretization.retraction

    @property
    def control_times(self) -> np.ndarray:
        return self.method.nodes if isinstance(self.method, CollocationMethod) else np.asarray(self.method.theta)

    @abstractmethod
    def stage(self, system: Any, h: ArrayLike) -> Stage:
        """The stage whose stationary points are the steps of ``system``."""

    def step(self, system: Any, h: ArrayLike, q: Ambient, p: Ambient, previous: Any) -> StepResult:
        return restore(self.manifold, lifted_step(self.stage(system, h), q, p, previous))


@final
class SymplecticIntegrator(VariationalIntegrator):
    """An integrator of Hamilton's equations by a lifted discretization map or a Gauss method.

    Parameters
    ----------
    method : CotangentLift or Gauss
        ``CotangentLift(Midpoint(R))``, or ``Gauss(s, R)`` of order ``2 s``.

    Notes
    -----
    A step is :math:`(q_0, p_0; q_1, p_1) = R_d^{T^*}(h X_H(z))` for some ``z`` in ``T*Q``. It is a symplectic map of
    ``T*Q``. It is symmetric, and of order 2, if the discretization map is symmetric. The system is a Hamiltonian ``H(q,
    p)``, a JAX function of ambient arrays.

    References
    ----------
    Barbero-Liñán and Martin de Diego, Retraction maps: a seed of geometric integrators, 2022.

    Examples
    --------
    >>> SymplecticIntegrator(Gauss(2, Cayley(SO(3)))).manifold
    SO(n=3)
    """

    def stage(self, system: Hamiltonian, h: ArrayLike) -> HamiltonianStage | CollocationStage:
        if isinstance(self.method, CollocationMethod):
            return CollocationStage.of_hamiltonian(system, self.method, h)
        return HamiltonianStage(hamiltonian=system, discretization=self.method.discretization, step=h)

    def begin(self, system: Hamiltonian, q: Ambient, p: Ambient) -> Any:
        stage = self.stage(system, 0.0)
        return stage.begin(q, p, resting_control(stage.controls)) if isinstance(stage, CollocationStage) else (q, p, p)

    def control(self, unknowns: Any) -> None:
        return None

    def energy(self, system: Hamiltonian, q: Ambient, p: Ambient, control: Any) -> Array:
        return real_number("the Hamiltonian", system(q, p))

    def check(self, system: Hamiltonian, q: Ambient, p: Ambient) -> None:
        if not callable(system):
            raise InvalidInputError(f"SymplecticIntegrator integrates a Hamiltonian H(q, p), got {system!r}")
        require_retraction(self.retraction, q)
        check_hamiltonian(system, q, p)
        require_correct_hamiltonian_derivatives(system, self.retraction, q, p)


@final
class PresymplecticIntegrator(VariationalIntegrator):
    r"""An integrator for the extremals of a regular optimal control problem.

    Parameters
    ----------
    method : CotangentLift or Gauss
        ``CotangentLift(Midpoint(R))``, or ``Gauss(s, R)`` of order ``2 s``.

    Notes
    -----
    :math:`\frac1h (R_d^{T^*})^{-1}(q_0, p_0; q_1, p_1)` lies in the Lagrangian submanifold S_H of the problem:
    Hamilton's equations of Pontryagin's Hamiltonian, with :math:`\partial H / \partial u = 0` at the stage. A Gauss
    method has a control at each of its points; ``controls`` then have an axis of length ``s``, also for ``s = 1``.

    References
    ----------
    Barbero-Liñán and Martin de Diego, Presymplectic integrators for optimal control problems via retraction maps, 2023.

    Examples
    --------
    >>> PresymplecticIntegrator(CotangentLift(Midpoint(Cayley(SO(3))))).manifold
    SO(n=3)
    """

    def stage(self, system: OptimalControlProblem, h: ArrayLike) -> ControlStage | CollocationStage:
        if isinstance(self.method, CollocationMethod):
            return CollocationStage.of_problem(system, self.method, h)
        return ControlStage(problem=system, discretization=self.method.discretization, step=h)

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> Any:
        u, stage = extremal_control(system, q, p), self.stage(system, 0.0)
        return stage.begin(q, p, u) if isinstance(stage, CollocationStage) else (q, u)

    def energy(self, system: OptimalControlProblem, q: Ambient, p: Ambient, control: Any) -> Array:
        return system.hamiltonian(q, p, control)

    def control(self, unknowns: Any) -> Ambient:
        return unknowns.controls if isinstance(unknowns, CollocationUnknowns) else unknowns[1]

    def check(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> None:
        if not isinstance(system, OptimalControlProblem):
            raise InvalidInputError(f"PresymplecticIntegrator integrates an OptimalControlProblem, got {system!r}")
        require_treated(system, "PresymplecticIntegrator", "an initial cost")
        require_same_manifold(system, self.discretization)
        require_retraction(self.retraction, q)
        u = extremal_control(system, q, p)
        system.check(q, u)
        singular = pivotal_values(np.asarray(_control_curvature(system, q, p, u)))
        if not is_regular(singular):
            raise InvalidInputError(
                "the problem is singular here: the second derivative of Pontryagin's Hamiltonian in the controls has "
                f"singular values {singular} in units of its diagonal, expected all positive; make the running cost "
                "strictly convex in every control"
            )


@compile_function
def _control_curvature(problem: OptimalControlProblem, q: Ambient, p: Ambient, u: Ambient) -> Array:
    """``d2H/du2``, shape (m, m)."""
    return jax.hessian(lambda c: problem.hamiltonian(q, p, problem._steer(u, c)))(jnp.zeros(problem.controls.dimension))
