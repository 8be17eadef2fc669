"""Words that reports share."""

from collections.abc import Iterable

from ...manifolds import Euclidean, Manifold
from ..problem.optimal_control_problem import OptimalControlProblem

ORDINALS = ("primary", "secondary", "tertiary", "quaternary")


def ordinal(level: int) -> str:
    """The name of equations that appear at a level."""
    return ORDINALS[level] if level < len(ORDINALS) else f"level-{level}"


def problem_words(problem: OptimalControlProblem) -> str:
    """Words on the kind of extremals and on the problem."""
    kind = "abnormal (p_0 = 0)" if problem.abnormal else "normal (p_0 = 1)"
    return f"{kind} extremals on T*Q, Q = {problem.manifold}, controls in {problem.controls}"


def family_words(family: bool) -> str:
    """Whether ``H`` is a Morse family."""
    return "is a Morse family" if family else "is not a Morse family: the controls are redundant or dH/du degenerates"


def level_words(codimension: int, free_controls: int, form_rank: int) -> str:
    """Words on the codimension, free controls and rank of a stratum of ``P^k``."""
    return f"codimension {codimension}, free controls {free_controls}, rank of omega {form_rank}"


def final_words(dimension: int, total: int, names: Iterable[str]) -> str:
    """``P_f``, with how many equations of which names cut it out."""
    counted = list(names)
    kinds = ", ".join(f"{counted.count(kind)} {kind}" for kind in dict.fromkeys(counted))
    equations = f"{kinds} equation{'' if len(counted) == 1 else 's'}" if counted else "no equations"
    return f"dimension {dimension} in T*Q of dimension {total}: {equations}"


def stop_words(k_f: int, k_f_base: int) -> str:
    """Where the algorithm stops."""
    return f"{k_f} (S stops changing; P at {k_f_base})"


def form_words(rank: int, kernel: int) -> str:
    """``omega_f``."""
    return f"rank {rank}, kernel of dimension {kernel}" + ("" if kernel else " (symplectic)")


def class_words(codimension: int, kernel: int) -> str:
    """How many equations of each class."""
    return f"{kernel} first class, {codimension - kernel} second class"


def component_words(controls: Manifold, component: int) -> str:
    """The name of a component of the control: an entry of ``u`` where that is a vector, a coordinate of U elsewhere."""
    return f"u[{component}]" if _is_vector(controls) else f"coordinate {component}"


def chart_words(controls: Manifold, center: str) -> str:
    """In which chart the coordinates of U are taken, where ``u`` is no vector."""
    return "" if _is_vector(controls) else f"; coordinates in the retraction chart of U around u = {center}"


def _is_vector(controls: Manifold) -> bool:
    return isinstance(controls, Euclidean) and len(controls.shape) == 1


def unmet_words(level: int) -> str:
    """Words for an empty ``P_f``."""
    return f"empty: the conditions up to level {level} contradict each other at every point tried"


def approached_words(residual: float) -> str:
    """Words for a search that found no point and no contradiction."""
    return (
        f"no point found: its conditions are approached (residual {residual:.0e}) and not reached, perhaps at infinity "
        "or at the edge of the domain of the problem's functions, or for lack of precision; not shown to be empty; try "
        "near=(q, p)"
    )


def sparse_words(missing: int, tried: int) -> str:
    """Words on pieces that may be missing."""
    return (
        f"{missing} of {tried} points, which were not found, or where equations are irregular or ranks are not "
        "decided: pieces of P_f may be missing; try more starts, or near=(q, p) where one is expected"
    )


CURVED_PIECES = (
    "its tangent spaces differ: curved pieces of equal ranks that cross, as some do here, are not always told apart; "
    "try near=(q, p), a point of the piece that you want"
)
ON_EACH_SIDE = (
    "on each side P_f is that of another problem, and what follows holds near the points that were found; try near=(q, "
    "p), a state on the side that is meant"
)
EXCLUDED = "p = 0 is excluded (exclude_zero_costate=False admits it)"
UNRELIABLE = (
    "equations irregular at every point: what follows is no statement about P_f; replace them, as x^2 = 0 by x = 0"
)
UNDECIDED = (
    "not decided: at every point found, a number that decides a rank may be zero or not within the precision of the "
    "point, or a function underflows or is smaller than the rounding of the others; what follows is not a statement "
    "about P_f; try near=(q, p), a state where the functions are of comparable size, or other units"
)
EMPTY_WITHOUT_IT = "empty once p = 0 is excluded: every extremal found has a vanishing costate"
WITH_IT = "; extremals with p = 0, which is excluded, were not looked for"


def strata_words(count: int) -> str:
    """Words for a ``P_f`` with several pieces."""
    return f"{count}: P_f is not one manifold; largest dimension first, choose(i) takes one"
