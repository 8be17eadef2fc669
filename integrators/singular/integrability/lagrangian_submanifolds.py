"""The Lagrangian submanifolds of an optimal control problem: ``L_H`` in ``T*T*Q``, ``S_H`` in ``TT*Q``, ``S_f`` in
``TP_f``.

[Barbero-Linan, Martin de Diego, "Presymplectic integrators for optimal control problems via retraction maps", section
3.] Each is an ``Immersion``: sample ``L.source.random_point(key)``, and test with ``is_lagrangian(L, y)``.
"""

from collections.abc import Callable

import jax
from jaxtyping import Array, Float

from ....manifolds import (
    CotangentBundle,
    Immersion,
    InvalidInputError,
    Manifold,
    PresymplecticManifold,
    Product,
    Submanifold,
    TangentBundle,
    tangent_lift,
)
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem
from .derivative_array import Pair, hamiltonian_field


def critical_set(problem: OptimalControlProblem) -> Submanifold:
    """``{(z, u) : dH/du = 0}`` in ``T*Q x U``: a submanifold of dimension ``2n`` where ``H`` is a Morse family.

    Raises ``InvalidInputError`` for anything but a problem; so do ``L_H`` and ``S_H``.
    """
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"expected an OptimalControlProblem, got {problem!r}")

    def slope(y: tuple[Pair, Ambient]) -> Float[Array, " m"]:
        z, u = y
        gradient = jax.grad(lambda u: problem.hamiltonian(*z, u))(u)
        return vec.components(problem.controls.basis(u), gradient)

    return Submanifold(Product(CotangentBundle(problem.manifold), problem.controls), slope)


def L_H(problem: OptimalControlProblem) -> Immersion:
    r"""The Lagrangian submanifold :math:`\{(z, dH(z, u)) : \partial H / \partial u = 0\}` of ``T*T*Q`` with its
    canonical form.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem, with Pontryagin's Hamiltonian ``H``.

    Returns
    -------
    Immersion
        The submanifold, immersed from states and controls.
    """
    critical = critical_set(problem)
    phase = CotangentBundle(problem.manifold)
    bundle = CotangentBundle(phase)

    def differential(y: tuple[Pair, Ambient]) -> tuple[Pair, Pair]:
        z, u = y
        return z, phase.projection(z, jax.grad(lambda z: problem.hamiltonian(z[0], z[1], u))(z))

    return Immersion(critical, PresymplecticManifold(bundle, bundle.two_form), differential)


def S_H(problem: OptimalControlProblem) -> Immersion:
    r"""The Lagrangian submanifold :math:`\{(z, X_H(z, u)) : \partial H / \partial u = 0\}` of ``TT*Q`` with the
    tangent lift.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem, with Pontryagin's Hamiltonian ``H``.

    Returns
    -------
    Immersion
        The submanifold, immersed from states and controls.
    """
    critical = critical_set(problem)
    phase = CotangentBundle(problem.manifold)
    space = PresymplecticManifold(TangentBundle(phase), tangent_lift(phase.two_form))
    return Immersion(critical, space, lambda y: (y[0], hamiltonian_field(problem, *y)))


def immersed_dynamics(
    problem: OptimalControlProblem, base: Manifold, parameters: Manifold, control: Callable[[Pair, Array], Ambient]
) -> Immersion:
    """``{(z, X_H(z, control(z, gauge)))}`` in ``T base``, with ``d_T`` of the canonical form, for ``base`` in
    ``T*Q``."""
    form = CotangentBundle(problem.manifold).two_form
    space = PresymplecticManifold(TangentBundle(base), tangent_lift(form))
    return Immersion(Product(base, parameters), space, lambda y: (y[0], hamiltonian_field(problem, y[0], control(*y))))
