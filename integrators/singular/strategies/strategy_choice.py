"""The choice of a strategy from the classification of a problem."""

from dataclasses import dataclass, field, replace
from typing import final

import jax.numpy as jnp
import numpy as np

from ....manifolds import InvalidInputError
from ....retractions import CotangentLift, DiscretizationMap
from ....tracing import reads_once
from ...problem.user_functions import require_concrete
from ...problem_checks.requirements import require_same_manifold
from ...reporting.text import clauses
from ..integrability import Classification
from ..wording import chart_words, component_words
from .final_manifold_stages import DirectIntegrator
from .goh_reduced_integrator import ReducedIntegrator
from .projection import ProjectedIntegrator
from .rattle import RattleIntegrator
from .stage_integrator import StageIntegrator
from .strategy import Gauge, NotApplicableError, SingularIntegrator

# In the order in which they are tried.
STRATEGIES: dict[str, type[SingularIntegrator]] = {
    "direct": DirectIntegrator,
    "rattle": RattleIntegrator,
    "reduced": ReducedIntegrator,
    "stage": StageIntegrator,
    "project": ProjectedIntegrator,
}


@final
@dataclass(frozen=True)
class Choice:
    """The strategy of an integrator on ``P_f`` with its reason; printed, a line for each statement.

    Attributes
    ----------
    strategy : str
        Its name in ``STRATEGIES``.
    reason : str
        The reason why it applies.
    remarks : tuple of str
        The gauge controls in use, and the piece of ``P_f`` if there are several.
    refusals : dict of str to str
        The reasons why earlier strategies do not apply.
    """

    strategy: str
    reason: str
    remarks: tuple[str, ...] = ()
    refusals: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return clauses([f"{self.strategy}: {self.reason}", *self.remarks, *_refusal_words(self.refusals)])


@reads_once
def singular_integrator(
    classification: Classification,
    discretization: DiscretizationMap,
    strategy: str | None = None,
    gauge: Gauge | None = None,
) -> tuple[SingularIntegrator, Choice]:
    """An integrator on the final constraint manifold ``P_f`` of a classified problem, and the choice of it.

    Parameters
    ----------
    classification : Classification
        The result of ``classify``; ``classification.choose(i)`` selects another piece.
    discretization : DiscretizationMap
        The map whose lift is used.
    strategy : str, optional
        A name in ``STRATEGIES``; by default the first one that applies.
    gauge : callable, optional
        ``gauge(t, q, p)`` returns the components ``classification.gauge_components`` of the control, shape ``(gauge
        controls,)``, with ``t`` from the start of the integration. By default the control of least norm.

    Returns
    -------
    integrator : SingularIntegrator
        The integrator, for ``integrate`` or ``solve``.
    choice : Choice
        The reasons; print it.

    Raises
    ------
    InvalidInputError
        If ``P_f`` is empty or irregular, if the strategy does not apply, or if the gauge does not return finite
        controls.
    """
    if not isinstance(classification, Classification):
        raise InvalidInputError(f"expected a Classification, got {classification!r}; try classify(problem)")
    if strategy is not None and strategy not in STRATEGIES:
        raise InvalidInputError(f"unknown strategy {strategy!r}; expected one of {', '.join(STRATEGIES)}, or None")
    if not isinstance(discretization, DiscretizationMap):
        raise InvalidInputError(
            "singular problems are integrated through the lift of a discretization map, "
            f"got {discretization!r}; try Midpoint(default_retraction(manifold))"
        )
    require_concrete("singular_integrator", classification, discretization, gauge)
    require_same_manifold(classification.problem, discretization)
    classification.require_reliable()
    if gauge is not None:
        _check_gauge(classification, gauge)
    lift, names = CotangentLift(discretization), [*STRATEGIES] if strategy is None else [strategy]
    found, refusals = _first(names, classification, lift, gauge)
    if found is not None:
        return found
    if strategy is not None:
        found, others = _first([name for name in STRATEGIES if name != strategy], classification, lift, gauge)
        if found is not None:
            raise InvalidInputError(f"{clauses(_refusal_words(refusals))};\nwhat applies is\n{found[1]}")
        refusals |= others
    raise InvalidInputError(f"no strategy applies:\n{clauses(_refusal_words(refusals))}")


def _first(
    names: list[str], classification: Classification, lift: CotangentLift, gauge: Gauge | None
) -> tuple[tuple[SingularIntegrator, Choice] | None, dict[str, str]]:
    """The first of these strategies that applies, if any, and the reasons against the strategies before."""
    refusals = dict[str, str]()
    for name in names:
        try:
            found, reason = STRATEGIES[name].suited(classification, lift, gauge)
        except NotApplicableError as error:
            refusals[name] = str(error)
            continue
        piece = classification.stratum.piece
        if piece is not None and found.keeps_nodes:
            found = replace(found, hull=piece.hull)
        remarks = *_gauge(classification, gauge), *_piece(classification)
        return (found, Choice(name, reason, remarks, refusals)), refusals
    return None, refusals


def _refusal_words(refusals: dict[str, str]) -> list[str]:
    """Sentences on strategies that do not apply."""
    return [f"not {name}: {why}" for name, why in refusals.items()]


def _check_gauge(classification: Classification, gauge: Gauge) -> None:
    """Raise unless the gauge returns as many finite numbers as there are gauge controls, at the point of the piece."""
    count, piece = classification.gauge_controls, classification.stratum
    if not count:
        raise InvalidInputError("a gauge was given, but the problem has no gauge controls; leave it out")
    controls = classification.problem.controls
    names = ", ".join(component_words(controls, a) for a in classification.gauge_components)
    expected = (
        f"gauge must be a function gauge(t, q, p) that returns the gauge control{'s' * (count > 1)} {names}, shape "
        f"({count},)" + chart_words(controls, str(piece.feedback.center))
    )
    example = f"try gauge=lambda t, q, p: jnp.zeros({count})"
    if not callable(gauge):
        raise InvalidInputError(f"{expected}, got {gauge!r}; {example}")
    try:
        values = jnp.ravel(gauge(jnp.zeros(()), piece.q, piece.p))
    except (TypeError, ValueError, IndexError) as error:
        raise InvalidInputError(f"{expected}; it fails with {error}; {example}") from error
    if values.size != count:
        raise InvalidInputError(f"{expected}; it returns {values.size} numbers, {values}; {example}")
    if not np.all(np.isfinite(values)):
        raise InvalidInputError(
            f"{expected}; at t = 0, q = {piece.q}, p = {piece.p} it returns {values}, expected finite numbers"
        )


def _gauge(classification: Classification, gauge: Gauge | None) -> list[str]:
    """Words on the gauge controls, if there are any."""
    if not classification.gauge_controls:
        return []
    if gauge is None:
        return ["gauge controls of least norm, for want of gauge(t, q, p)"]
    return [getattr(gauge, "meaning", "gauge controls as given")]


def _piece(classification: Classification) -> list[str]:
    """Words on the piece of ``P_f`` that is taken, if there are several."""
    if not classification.stratified:
        return []
    return [f"on piece 0 of the {len(classification.strata)} of P_f, classification.choose(i) takes another"]
