"""The study of a sweep: its members, their solutions, and the kept figures."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import jax
import numpy as np

from ..integrators import Solutions, Solver
from ..integrators.problem.free_quantities import is_free
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError, RetraxError

# Members that are solved at once: more need more memory than is near to the processor, and take longer each.
CHUNK_MEMBERS = 100
ASKED = "starts", "ends", "horizons", "guesses", "parameters", "tolerance", "max_iterations"


@final
@dataclass(frozen=True)
class Study:
    """The contents of a sweep: a solver, its cases, and the values to keep of each solution.

    Parameters
    ----------
    solver : Solver
        The solver; each worker builds its own.
    cases : callable
        A function of the numbers of ``B`` members, shape ``(B,)``. It returns arguments of ``solver.solve_many`` in a
        dictionary: ``starts``, ``ends``, ``horizons``, ``guesses``, ``parameters``, ``tolerance``, ``max_iterations``.
        A case depends on its number alone: draw it with ``np.random.default_rng([seed, number])``.
    keep : callable, optional
        A function of the ``Solutions`` of ``B`` members. It returns real arrays of shape ``(B, ...)`` by name, which
        are stored with cost, success and result.

    Raises
    ------
    InvalidInputError
        For other arguments.
    """

    solver: Solver
    cases: Callable[[np.ndarray], dict[str, Any]]
    keep: Callable[[Solutions], dict[str, Any]] | None = None

    def __post_init__(self) -> None:
        if not (
            isinstance(self.solver, Solver) and callable(self.cases) and (self.keep is None or callable(self.keep))
        ):
            raise InvalidInputError(
                "Study takes a Solver, a function of the numbers of members, and a function of Solutions or None, got "
                f"{brief(self.solver)}, {brief(self.cases)} and {brief(self.keep)}; try Study(Solver(...), cases)"
            )


def make_study(build: Callable[[], Any]) -> Study:
    """The study that a function returns; raises if it returns something else."""
    study = build()
    if not isinstance(study, Study):
        raise InvalidInputError(
            f"build returned {brief(study)}, expected a Study(solver, cases); try: return Study(...)"
        )
    return study


def solve_arguments(study: Study, members: np.ndarray) -> dict[str, Any]:
    """The arguments of ``solve_many`` for some members; raises unless these are arguments of it."""
    given = study.cases(members)
    if not isinstance(given, dict) or not {"starts", "ends", "horizons"} <= set(given) <= set(ASKED):
        came = sorted(map(str, given)) if isinstance(given, dict) else f"{brief(given)}"
        raise InvalidInputError(
            f"cases returned {came}, expected a dictionary with starts, ends and horizons, and what else solve_many "
            f"takes: {', '.join(ASKED[3:])}"
        )
    return given


def solve_members(study: Study, members: np.ndarray) -> dict[str, Any]:
    """Cost, success, result and kept figures of some members; a rejected member has the reason as its result.

    ``kept`` arrays have rows for the solved members, which ``has`` marks. Raises ``KeyboardInterrupt`` if the iteration
    was stopped.
    """
    return _join(
        [
            _solve_or_halve(study, members[first : first + CHUNK_MEMBERS])
            for first in range(0, len(members), CHUNK_MEMBERS)
        ]
    )


def _solve_or_halve(study: Study, members: np.ndarray) -> dict[str, Any]:
    """The results of one batch, or of its halves if the batch is rejected, so that one member does not spoil a
    batch."""
    try:
        return _solve_batch(study, members)
    except RetraxError as error:
        if len(members) > 1:
            half = len(members) // 2
            return _join([_solve_or_halve(study, members[:half]), _solve_or_halve(study, members[half:])])
        no = np.zeros(1, bool)
        return {
            "cost": np.full(1, np.nan),
            "success": no,
            "has": no,
            "result": [f"{type(error).__name__}: {error}"],
            "kept": {},
        }


def _solve_batch(study: Study, members: np.ndarray) -> dict[str, Any]:
    count, solutions = len(members), study.solver.solve_many(**solve_arguments(study, members))
    if len(solutions) != count:
        raise InvalidInputError(f"cases returned {len(solutions)} cases for {count} members, expected one for each")
    result = solutions.result
    if any(spent.stopped for spent in solutions.statistics):
        raise KeyboardInterrupt
    kept = _check_figures(study.keep(solutions), count) if study.keep else {}
    return {
        "cost": solutions.cost,
        "success": solutions.success,
        "has": np.ones(count, bool),
        "result": result,
        "kept": kept,
    }


def _check_figures(kept: Any, count: int) -> dict[str, np.ndarray]:
    """The kept figures as arrays of numbers; raises if the user's function returns something else."""
    arrays = {name: np.asarray(value) for name, value in kept.items()} if isinstance(kept, dict) else {}
    if not isinstance(kept, dict) or not all(
        isinstance(name, str) and a.shape[:1] == (count,) and a.dtype.kind in "biuf" for name, a in arrays.items()
    ):
        came = {name: f"{a.dtype}{a.shape}" for name, a in arrays.items()} or f"{brief(kept)}"
        raise TypeError(
            f"keep returned {came}, expected a dictionary of arrays of real numbers with {count} rows, by names"
        )
    return {name: a.astype(float) for name, a in arrays.items()}


def _join(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """The members of all parts."""
    joined = {name: np.concatenate([part[name] for part in parts]) for name in ("cost", "success", "has")}
    known = [part["kept"] for part in parts if part["has"].any()]
    kept = {name: np.concatenate([arrays[name] for arrays in known]) for name in (known[0] if known else ())}
    return {**joined, "result": [words for part in parts for words in part["result"]], "kept": kept}


def marks(study: Study, count: int) -> dict[str, str]:
    """Digests by which a sweep that goes on is known to be the same: of the problem with its method, and of its
    cases."""
    cases = [solve_arguments(study, np.array([k])) for k in (0, count - 1)]
    solver = study.solver
    bound = solver.problem.with_parameters(jax.tree.map(_first, cases[0].get("parameters"))).at_time(0.0)
    method = f"{solver.problem.manifold!r} {solver.method!r} {solver.fractions.tolist()}"
    given = [{name: value for name, value in case.items() if name != "guesses"} for case in cases]
    numbers = jax.tree.map(lambda leaf: repr(leaf) if is_free(leaf) else np.asarray(leaf).tolist(), given)
    return {
        "problem": _digest((bound._digest() or b"unknown") + method.encode()),
        "cases": _digest(repr(numbers).encode()),
    }


def _first(leaf: Any) -> Any:
    if is_free(leaf):
        return leaf.member(0).guess
    if not np.ndim(leaf):
        raise InvalidInputError(
            f"cases returned {brief(leaf)} among the parameters, expected an array with an entry for each member; try "
            "np.full(len(members), value)"
        )
    return np.asarray(leaf)[0]


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
