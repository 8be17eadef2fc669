"""Whether the equations between the ends of phases are independent, and their names."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from ....manifolds import InvalidInputError
from ....manifolds.numerics.tolerances import EPS, HALF
from ...problem.boundary_conditions import PERIODIC, boundary_words
from ...problem.point_layout import PointLayout
from ...reporting.text import plural
from ..transcription.discrete_phase import LinkedPhases
from ..transcription.linkages import PhaseProblem
from ..transcription.search_record import SearchRecord

RANDOM_ENDS = 4  # random ends at which equations are looked at


def equation_words(phases: Sequence[PhaseProblem]) -> list[str]:
    """Names of the equations of boundary constraints."""
    several = len(phases) > 1
    return [
        f"{boundary_words(name)}[{i}]" + (f" of phase {k}" if several else "")
        for k, phase in enumerate(phases)
        for name, size in phase.sizes.items()
        for i in range(size)
    ]


def dependence_notes(problem: LinkedPhases, found: Sequence[SearchRecord], names: Sequence[str]) -> list[str]:
    """Words on equations between the ends that depend on each other at the ends that each member reached, if they do.

    The inertia of the KKT matrix, which is then singular, shows no minimum.
    """
    return [_dependent_words(problem, member, names) for member in found]


def _dependent_words(problem: LinkedPhases, found: SearchRecord, names: Sequence[str]) -> str:
    """The words on one member; otherwise empty."""
    rows = found.jacobian[:, problem.free]
    power = HALF if found.facts.converged else HALF / 2  # on the way they nearly depend
    if not np.all(np.isfinite(rows)) or len(independent := independent_rows(_scale(rows), power)) == len(rows):
        return ""
    every = enumerate(_all(problem, names))
    left = ", ".join(dict.fromkeys(name for place, name in every if place not in independent))
    return (
        " At the ends that were reached the boundary conditions depend on each other, and their multipliers are not "
        f"determined: {left}; try to leave out what follows from the others, or periodic=True for q(T) = q(0) on a "
        "manifold."
    )


def _all(problem: LinkedPhases, names: Sequence[str]) -> list[str]:
    """Names of all equations, and of the links."""
    link = "the link between phases" if len(problem.phases) > 1 else PERIODIC
    coupling: Any = problem.coupling
    return [*names, *(link for _ in range(coupling.rows - len(names)))]


def _scale(rows: np.ndarray) -> np.ndarray:
    """The rows scaled to one size."""
    sizes = np.max(np.abs(rows), axis=1, initial=0.0)
    return rows / np.where(sizes > 0, sizes, 1.0)[:, None]


def require_independent(problem: LinkedPhases, guess: Any, names: Sequence[str]) -> None:
    """Raise if equations between the ends depend on each other, at the guess and at random ends too.

    Where ends are prescribed, in what is free of them.
    """
    coupling: Any = problem.coupling
    names, best = _all(problem, names), None
    for ends in _samples(problem, guess):
        linked = coupling(ends, [phase.data.parameters[:1] for phase in problem.phases], guess.multipliers[:1])
        rows = linked.jacobian[0][:, problem.free]
        if not np.all(np.isfinite(rows)):
            continue
        independent = independent_rows(_scale(rows))
        if len(independent) == len(rows):
            return
        best = independent if best is None or len(independent) > len(best) else best
    if best is not None:
        left = list(dict.fromkeys(name for k, name in enumerate(names) if k not in best))
        count, verb = len(best), "depends" if len(left) == 1 else "depend"
        raise InvalidInputError(
            f"the boundary conditions are {plural(len(names), 'equation')}, of which {count} "
            f"{'is' if count == 1 else 'are'} independent where the ends are free: {', '.join(left)} {verb} on the "
            "others, or on what is prescribed alone; expected independent equations; try to leave out what follows "
            "from the others, and periodic=True for q(T) = q(0) on a manifold"
        )


def _samples(problem: LinkedPhases, guess: Any) -> list[list[np.ndarray]]:
    """The ends of the guess of the first member, and random ends where these are free."""
    found = [end[:1] for phase, part in zip(problem.phases, guess.parts, strict=True) for end in phase.end_nodes(part)]
    samples = [found]
    for key in jax.random.split(jax.random.key(0), RANDOM_ENDS):
        ends = []
        for k, (own, mine) in enumerate(zip(found, jax.random.split(key, len(found)), strict=True)):
            phase = problem.phases[k // 2]
            manifold = phase.transcription.manifold
            entries = phase.ends.end_entries if k % 2 else phase.ends.start_entries
            ends.append(np.where(entries, own, PointLayout.of(manifold).rows(manifold.random_point(mine), 0)))
        samples.append(ends)
    return samples


def independent_rows(rows: np.ndarray, power: float = HALF) -> list[int]:
    """The first rows of a matrix that are independent of the earlier rows."""
    basis, found = np.zeros((0, rows.shape[1])), list[int]()
    for k, row in enumerate(rows):
        rest = row - basis.T @ (basis @ row)
        rest -= basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > EPS**power * max(np.linalg.norm(row), np.finfo(float).tiny):
            basis, found = np.vstack([basis, rest / np.linalg.norm(rest)]), [*found, k]
    return found
