"""The immutable record of a classified optimal control problem."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike

from ....manifolds import (
    CotangentBundle,
    Euclidean,
    Immersion,
    InvalidInputError,
    PresymplecticManifold,
    Submanifold,
)
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem, is_same_problem
from ..integrability_result import IntegrabilityResult, Signature
from .affine_hulls import PieceEquations
from .algorithm_stages import Level
from .final_equations import FinalEquations
from .lagrangian_submanifolds import immersed_dynamics
from .sample_points import APPROACHED


@dataclass(frozen=True)
class MorseTest:
    r"""A test at points with ``dH/du = 0`` whether ``H`` is a Morse family and whether the problem is regular.

    Attributes
    ----------
    count : int
        The number of points.
    states : pair of points and covectors
        The points ``(q, p)``, shape ``(count, *leaf)``.
    controls : array, or tuple of arrays
        The controls there.
    family : bool
        Whether :math:`D(\partial H / \partial u)` has rank m at all points.
    family_singular_values : array
        Singular values at the point with the smallest one, in units of the sizes of the problem.
    regular : bool
        Whether :math:`\partial^2 H / \partial u^2` has rank m at all points.
    hessian_singular_values : array
        Its singular values, likewise.
    gap : float
        The last counted singular value over the first one that is not counted.
    """

    count: int
    states: Ambient
    controls: Ambient
    family: bool
    family_singular_values: np.ndarray
    regular: bool
    hessian_singular_values: np.ndarray
    gap: float


@dataclass(frozen=True, eq=False)
class Stratum:
    """A piece of ``P_f`` with constant ranks, found at ``count`` of the points.

    Attributes
    ----------
    signature : Signature
        Codimension, free controls, rank of the form.
    count : int
        The number of points on it.
    flat : bool
        Whether its tangent spaces are the same at all points.
    k_f, k_f_base : int
        The levels at which ``S`` and ``P`` stop changing.
    determined_at : tuple of int or None
        For each control component the level that determines it; None if it is free.
    q, p, u : point, covector, control
        A point of the piece, and a control there.
    kernel : pair
        Basis of the kernel of ``omega_f`` at the point, leaves ``(k, *leaf)`` of pairs ``(dq, dp)``.
    states : pair
        All its points, leaves ``(count, *leaf)`` of pairs ``(q, p)``.
    equations : FinalEquations
        Equations, which may vanish on other pieces too.
    piece : PieceEquations or None
        Equations of this piece alone; None if it lies in no affine space of its own.
    feedback : FinalEquations
        The equations that determine the controls.
    """

    signature: Signature
    count: int
    flat: bool
    k_f: int
    k_f_base: int
    determined_at: tuple[int | None, ...]
    q: Ambient
    p: Ambient
    u: Ambient
    kernel: Ambient
    states: Ambient
    equations: FinalEquations
    piece: PieceEquations | None
    feedback: FinalEquations

    @property
    def codimension(self) -> int:
        """The number of independent equations in ``T*Q``."""
        return self.signature.codimension

    @property
    def dimension(self) -> int:
        """The dimension of the piece: rank of the form plus dimension of its kernel."""
        return self.rank + len(jax.tree.leaves(self.kernel)[0])

    @property
    def rank(self) -> int:
        """The rank of ``omega_f``."""
        return self.signature.form_rank

    @property
    def free_controls(self) -> int:
        """The number of free controls."""
        return self.signature.free_controls


@dataclass(frozen=True, eq=False)
class Classification(IntegrabilityResult[Stratum]):
    """The result of the integrability algorithm at points of ``T*Q``, with the evidence of each level.

    Attributes
    ----------
    problem : OptimalControlProblem
        The problem.
    strata : tuple of Stratum
        The pieces of ``P_f``, largest dimension first. The properties describe the first one.
    morse : MorseTest or None
        The test for a Morse family and for regularity; None if no point was found.
    levels : tuple of Level
        The evidence, level by level.
    excluded : int
        The number of points that were left out.
    zero_costate_excluded : bool
        Whether extremals with ``p = 0`` were left out.
    digest : bytes or None
        A digest of the functions of the problem.
    jump : str
        Words on a jump of the functions between the points, on whose sides ``P_f`` may differ; empty without one.
    """

    morse: MorseTest | Any
    levels: tuple[Level, ...]
    excluded: int
    zero_costate_excluded: bool
    digest: bytes | None = field(repr=False)
    jump: str = field(default="", repr=False)

    @property
    def regular(self) -> bool:
        """Whether ``dH/du = 0`` determines every control: then ``P_f = T*Q``."""
        return self.morse is not None and self.morse.regular

    @property
    def irregular(self) -> bool:
        """Whether Gauss-Newton was slow: the differentials of the equations vanish or become dependent on their zero
        set."""
        return any(level.slow for level in self.levels)

    @property
    def reliable(self) -> bool:
        """Whether every level has points where its equations are regular and ranks clear, so that ``P_f`` is known."""
        return not any(level.unknown for level in self.levels)

    @property
    def contradictory(self) -> bool:
        """Whether no piece was found because the conditions contradict each other, not for want of a point that meets
        them."""
        if not self.empty or self.excluded:
            return self.empty
        return self.levels[-1].residual > APPROACHED and self.levels[-1].opposed

    @property
    def sparse(self) -> bool:
        """Whether half of the points or more are missing: not found, or left out for irregular equations or unclear
        ranks."""
        return self.reliable and not self.empty and any(2 * level.missing >= level.tried for level in self.levels)

    def is_of(self, problem: OptimalControlProblem) -> bool:
        """Whether this is the classification of a problem whose functions still compute the same.

        Parameters
        ----------
        problem : OptimalControlProblem
            The problem.
        """
        unchanged = self.digest is None or self.digest == problem._digest()
        return unchanged and is_same_problem(self.problem, problem)

    def require_reliable(self) -> None:
        """Raise ``InvalidInputError`` if the equations of ``P_f`` are irregular or ranks not clear, so that nothing is
        known."""
        if self.reliable:
            return
        if any(level.unknown and level.slow == level.consistent for level in self.levels):
            raise InvalidInputError(
                "the equations of P_f are irregular: their differentials vanish or depend on each other on P_f, so "
                f"they do not make it a manifold\n{self}\nreplace them by equivalent ones, as x = 0 for x^2 = 0, in "
                "the problem"
            )
        raise InvalidInputError(
            "P_f is not known: at every point found, a number that decides a rank may be zero or not within the "
            "precision of the point, or a function underflows or is smaller than the rounding of the "
            f"others\n{self}\ntry near=(q, p), a state where the functions are of comparable size, or other units"
        )

    @property
    def gauge_components(self) -> tuple[int, ...]:
        """Components of the control that you can choose freely; the remaining components follow from the choice and the
        state.

        They are entries of ``u`` in R^m; on another U coordinates in its chart around ``stratum.feedback.center``.
        """
        return self.stratum.feedback.pivots.free

    @property
    def equations(self) -> FinalEquations:
        """Equations of ``P_f``, a JAX function of ``z = (q, p)`` with values of shape ``(codimension,)``."""
        return self.stratum.equations

    @cached_property
    def manifold(self) -> Submanifold | Any:
        """``P_f`` as an embedded manifold; ``Projection(P_f)`` is a retraction of it, ``P_f.nearby(z)`` a point of it
        near ``z``.

        Valid around the point of the stratum, as far as the elimination of the controls reaches. Raises
        ``InvalidInputError`` if the equations are irregular there.
        """
        self.require_reliable()
        bundle = CotangentBundle(self.problem.manifold)
        return Submanifold(bundle, self.equations, self.stratum.piece) if self.codimension else bundle

    @property
    def presymplectic(self) -> PresymplecticManifold:
        """``(P_f, omega_f)``: with the rank and the kernel of the form at any point of ``P_f``."""
        return PresymplecticManifold(self.manifold, CotangentBundle(self.problem.manifold).two_form)

    def control(self, q: Ambient, p: Ambient, gauge: ArrayLike | None = None) -> Ambient:
        """The control at a point of ``P_f``, a JAX function that is compiled at its first call.

        Parameters
        ----------
        q, p : point, covector
            A point of ``P_f``.
        gauge : array_like of shape (gauge controls,), optional
            The components ``gauge_components``; by default their values at the point of the stratum.

        Notes
        -----
        Entries are NaN where the equations do not determine the other components, as on a piece of ``P_f`` that was not
        told apart from that of the stratum.
        """
        return self._control((q, p), gauge)

    @cached_property
    def _control(self) -> Callable[..., Ambient]:
        feedback = self.stratum.feedback
        return jax.jit(lambda z, gauge: feedback.determined(z, gauge))

    @property
    def dynamics(self) -> Immersion:
        """``S_f`` in ``(TP_f, d_T omega_f)``, immersed from ``P_f`` times the space of gauge controls."""
        control = self.stratum.feedback.control
        return immersed_dynamics(self.problem, self.manifold, Euclidean(self.gauge_controls), control)

    def __str__(self) -> str:
        from .classification_report import report_text

        return report_text(self)

    def __repr__(self) -> str:
        nothing = "empty" if self.contradictory else "no point found"
        kind = nothing if self.empty else f"dim P_f = {self.dimension}, k_f = {self.k_f}"
        return f"Classification({kind})"
