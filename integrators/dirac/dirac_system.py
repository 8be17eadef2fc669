"""Hamiltonian systems with nonholonomic constraints, as implicit systems in a Dirac structure."""

from collections.abc import Callable
from typing import Any, Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from ...compute.jit_cache import digest
from ...manifolds import ConvergenceError, InvalidInputError, Manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, Frame, is_traced
from ...manifolds.numerics.root import find_root
from ..problem.initial_controls import resting_control
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.pontryagin import find_control
from ..problem.user_functions import real_number
from ..problem_checks.requirements import require_treated
from ..stages.hamiltonian import Hamiltonian

Multipliers = Float[Array, " m"]


@final
class DiracSystem(eqx.Module):
    r"""A Hamiltonian system with linear or affine constraints on the velocity: a Dirac structure on ``T*Q``.

    Parameters
    ----------
    manifold : Manifold
        The configuration manifold Q.
    hamiltonian : callable
        ``H(q, p)``, a number.
    forms : callable
        One-forms ``mu^a(q)``: independent covectors as leaves of shape ``(m, *leaf)``.
    rates : callable, optional
        The values ``c(q)``, shape ``(m,)``; by default zero.

    Notes
    -----
    The equations are

    .. math::
        \dot q = \partial H / \partial p, \quad \dot p = -\partial H / \partial q + \lambda_a \mu^a(q), \quad
        \langle \mu^a(q), \dot q \rangle = c^a(q), \quad a = 1, \dots, m.

    All functions are JAX functions of ambient arrays. States are the ``(q, p)`` that satisfy the constraints;
    ``project`` maps any covector to one of them.

    References
    ----------
    Yoshimura, Marsden, Dirac structures in Lagrangian mechanics, J. Geom. Phys. 57, 2006.
    """

    manifold: Manifold
    hamiltonian: Hamiltonian
    forms: Callable[[Any], Frame]
    rates: Callable[[Any], Multipliers] | None = None

    @classmethod
    def controlled(
        cls,
        problem: OptimalControlProblem,
        forms: Callable[[Any], Frame],
        rates: Callable[[Any], Multipliers] | None = None,
    ) -> Self:
        """The system of Pontryagin's Hamiltonian with the control eliminated by ``dH/du = 0`` near the resting
        control.

        Parameters
        ----------
        problem : OptimalControlProblem
            The problem.
        forms, rates
            As in the class.

        Notes
        -----
        ``H(q, p, u(q, p))`` has the differential in ``(q, p)`` of ``H`` with a fixed ``u``. It is NaN where ``dH/du =
        0`` does not determine ``u``.
        """
        if not isinstance(problem, OptimalControlProblem):
            raise InvalidInputError(
                f"controlled takes an OptimalControlProblem, got {problem!r}; or give DiracSystem an H(q, p)"
            )
        require_treated(problem, "DiracSystem.controlled", "an initial cost")
        return cls(problem.manifold, _ExtremalHamiltonian(problem), forms, rates)

    def __check_init__(self) -> None:
        if not isinstance(self.manifold, Manifold):
            raise InvalidInputError(f"manifold must be a Manifold, got {self.manifold!r}; try Euclidean(3)")
        functions = {"hamiltonian": self.hamiltonian, "forms": self.forms, "rates": self.rates}
        for name, value in functions.items():
            if not (callable(value) or (name == "rates" and value is None)):
                of = "(q, p)" if name == "hamiltonian" else "q"
                raise InvalidInputError(f"{name} must be a function of {of}, got {value!r}")

    def _digest(self) -> bytes | None:
        """A digest of the results of the functions, with the values that they use now; None if there is none."""
        ambient = self.manifold.ambient
        return digest(lambda q, p: (self.hamiltonian(q, p), self.constraint(q, p)), ambient, ambient)

    def velocity(self, q: Ambient, p: Ambient) -> Ambient:
        """The velocity ``dH/dp``, a tangent vector at ``q``.

        Parameters
        ----------
        q, p : point, covector
            The state.
        """
        return self.manifold.projection(
            q, vec.gradient(lambda p: real_number("the Hamiltonian", self.hamiltonian(q, p)), p)
        )

    def constraint(self, q: Ambient, v: Ambient) -> Multipliers:
        r"""The values :math:`\langle \mu^a(q), v \rangle - c^a(q)`, shape ``(m,)``: zero for an admissible velocity.

        Parameters
        ----------
        q, v : point, tangent vector
            A point, and a velocity.
        """
        along = vec.components(self.forms(q), v)
        return along if self.rates is None else along - self.rates(q)

    def kick(self, q: Ambient, p: Ambient, impulse: Multipliers) -> Ambient:
        r"""The covector :math:`p + r_a \mu^a(q)` after an impulse of the constraint forces.

        Parameters
        ----------
        q, p, impulse : point, covector, array of shape (m,)
            The state, and the impulse ``r``.
        """
        return self.manifold.projection(q, vec.add(p, vec.combine(self.forms(q), impulse)))

    def impulse(
        self, q: Ambient, p: Ambient, first: Multipliers, sizes: Multipliers | None = None
    ) -> tuple[Multipliers, Bool[Array, ""]]:
        """The impulse near ``first`` after which the state satisfies the constraints, and whether it was found.

        Parameters
        ----------
        q, p : point, covector
            The state.
        first : array of shape (m,)
            The first guess.
        sizes : array of shape (m,), optional
            Sizes of impulses; by default ``impulse_sizes(q, p)``.
        """
        sizes = self.impulse_sizes(q, p) if sizes is None else sizes
        return find_root(lambda r: self.constraint(q, self.velocity(q, self.kick(q, p, r))), first, sizes)

    def impulse_sizes(self, q: Ambient, p: Ambient, h: ArrayLike = 0.0) -> Multipliers:
        """The sizes of impulses that change ``p`` by its size or by ``h dH/dq``, or lead from rest to the rates.

        Parameters
        ----------
        q, p, h : point, covector, float
            The state, and a step.
        """
        q, p = jax.lax.stop_gradient((q, p))
        pushed = vec.gradient(lambda q: real_number("the Hamiltonian", self.hamiltonian(q, p)), q)
        momentum = jnp.maximum(vec.size(p), jnp.abs(h) * vec.size(pushed))
        forms = jax.vmap(vec.size)(self.forms(q))
        sizes = momentum / jnp.where(forms > 0, forms, 1.0)
        if self.rates is not None:
            nothing = jnp.zeros_like(sizes)
            mobility = jnp.abs(jnp.diagonal(self.mobility(q, p, nothing)))
            sizes = jnp.maximum(sizes, jnp.abs(self.rates(q)) / jnp.where(mobility > 0, mobility, jnp.inf))
        return jnp.where((sizes > 0) & jnp.isfinite(sizes), sizes, 1.0)

    def mobility(self, q: Ambient, p: Ambient, impulse: Multipliers) -> Array:
        r"""The matrix :math:`\langle \mu^a, H_{pp} \mu^b \rangle`, shape ``(m, m)``: the change of the constraints
        by impulses.

        Parameters
        ----------
        q, p, impulse : point, covector, array of shape (m,)
            The state, and the impulse.
        """
        return jax.jacfwd(lambda r: self.constraint(q, self.velocity(q, self.kick(q, p, r))))(impulse)

    def project(self, q: Ambient, p: Ambient) -> Ambient:
        """The covector that satisfies the constraints and differs from ``p`` by a linear combination of the
        one-forms.

        Parameters
        ----------
        q, p : point, covector
            The state; ``ConvergenceError`` if there is none nearby.
        """
        size = jax.tree.leaves(jax.eval_shape(self.forms, q))[0].shape[0]
        r, found = self.impulse(q, p, jnp.zeros(size))
        if not is_traced(found) and not found:
            raise ConvergenceError(
                f"no covector near {p} satisfies the constraints at q = {q}; are the one-forms independent?"
            )
        return self.kick(q, p, r)


@final
class _ExtremalHamiltonian(eqx.Module):
    """``H(q, p, u)`` with ``dH/du = 0``."""

    problem: OptimalControlProblem

    def __call__(self, q: Ambient, p: Ambient) -> Array:
        u, found = find_control(self.problem, q, p, resting_control(self.problem.controls))
        return jnp.where(found, self.problem.hamiltonian(q, p, u), jnp.nan)
