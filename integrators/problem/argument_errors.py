"""Arguments that users often ask for, with words on what to use instead."""

import inspect
from collections.abc import Callable
from difflib import get_close_matches
from functools import cache
from typing import Any, ParamSpec, TypeVar

from ...errors import InvalidCallError, concise
from ...manifolds import InvalidInputError

P = ParamSpec("P")
R = TypeVar("R")

TIME = (
    "for explicit time give OptimalControlProblem time_dependent=True and functions of (q, u, t), a terminal "
    "cost of (q, t)"
)
ENERGY_TIME = (
    "a Hamiltonian has no explicit time; make a clock s a coordinate: a factor Euclidean(1) with covector e, and the "
    "energy H(q, p, s) + e[0]"
)
HORIZON = "for a free one give horizon=Free(guess), or Free(guess, lower=..., upper=...)"
BOUNDS = (
    'bounds belong to OptimalControlProblem: control_bounds=(lower, upper), or constraints={"name": function} of '
    "(q, u) that is not positive where a state and a control are admissible"
)
ENDS = (
    "conditions on the ends are start and end of solve, with None or Free(guess) for what is free, and of "
    'OptimalControlProblem boundary_constraints={"name": function} of (q_0, q_T) that is zero where they hold'
)
LABELS = (
    'names belong to OptimalControlProblem: labels={"states": ("position", "speed"), "controls": ("force",)}, and '
    "units likewise"
)
OF_ENDS, CONDITIONS = ("terminal", "final", "end", "initial", "start", "boundary"), ("constraint", "condition", "equal")
ACCURACY = "for steps that are refined until the error is small give accuracy=1e-8"
REFINED = "_error", "error_", "refin", "mesh", "adapt"  # parts of names of what accuracy does
# Parts of names, in the order in which they are looked for.
ASKED_FOR = {
    LABELS: ("names", "label"),
    BOUNDS: (
        "bound",
        "limit",
        "constraint",
        "_max",
        "_min",
        "max_u",
        "min_u",
        "umax",
        "umin",
        "saturat",
        "lower",
        "upper",
        "inequal",
        "box",
        "lb",
        "ub",
        "lbx",
        "ubx",
    ),
    f"the final time is the horizon of solve; {HORIZON}": (
        "free",
        "horizon",
        "final_time",
        "end_time",
        "duration",
        "tf",
        "t_f",
    ),
    TIME: ("time", "clock", "t0", "t"),
}
# Arguments, by their names in texts and in other libraries.
ELSEWHERE = {
    "start": ("x0", "q0", "y0", "x_0", "q_0", "init", "initial", "initial_state", "initial_point", "source"),
    "end": ("xf", "qf", "x_f", "q_f", "xT", "qT", "x1", "q1", "final", "final_state", "goal", "target", "terminal"),
    "horizon": ("T",),
    "steps": ("N", "n", "n_steps", "num_steps", "n_nodes", "num_nodes", "nodes", "intervals", "num_intervals", "dt"),
    "guess": (
        "initial_guess",
        "guess_states",
        "guess_controls",
        "x_guess",
        "u_guess",
        "u0",
        "states",
        "warm_start",
        "init_guess",
    ),
    "parameters": ("p", "params", "param", "args"),
    "method": ("discretization", "scheme", "transcription"),
    "dynamics": ("f", "ode", "rhs", "vector_field", "system"),
    "running_cost": ("cost", "objective", "stage_cost", "lagrange", "lagrangian"),
    "terminal_cost": ("mayer", "final_cost", "end_cost"),
    "labels": ("state_names", "control_names"),
    "verbose": ("print_level", "disp", "display"),
}
NAMED_ELSEWHERE = {name: argument for argument, names in ELSEWHERE.items() for name in names}
SIMILARITY = 0.75  # of a name to another one that is a slip of the pen
SHORT = 3  # letters that a name cut short has at least
TIMES = frozenset({"t", "time", "tau"})
CLOCKS = TIMES | {"horizon", "tf", "final_time"}


def missing_option(name: str) -> str:
    """Words on what a name asks for that is not offered; empty for other names."""
    if asks_for_end_condition(name):
        return ENDS
    fits = (words for words, parts in ASKED_FOR.items() if any(p == name or (len(p) > 2 and p in name) for p in parts))
    return next(fits, "")


def asks_for_end_condition(name: str) -> bool:
    """Whether a name is one of conditions on the ends."""
    return any(part.startswith(OF_ENDS) for part in name.split("_")) and any(part in name for part in CONDITIONS)


def intended_name(unknown: str, names: list[str]) -> str:
    """The name that an unknown one is a slip of the pen for, or cut short of; empty if there is none."""
    if NAMED_ELSEWHERE.get(unknown) in names:
        return NAMED_ELSEWHERE[unknown]
    near = get_close_matches(unknown, names, 1, SIMILARITY)
    if asks_for_end_condition(unknown.lower()):  # a terminal constraint is no terminal cost
        near = [name for name in near if asks_for_end_condition(name)]
    cut = unknown.lower().replace("_", "")
    longer = [name for name in names if len(cut) >= SHORT and name.replace("_", "").startswith(cut)]
    return next(iter([*near, *longer]), "")


def require_known_options(function: Callable[P, R]) -> Callable[P, R]:
    """The function, with an ``InvalidCallError`` in words for keywords that it does not have, and for missing
    arguments."""
    signature, what = inspect.signature(function), function.__qualname__.removesuffix(".__init__")
    names = [name for name in signature.parameters if name != "self"]

    @cache  # a call is complete by the number of its arguments and the names of its options
    def check(count: int, *given: str) -> None:
        unknown = next((name for name in given if name not in names), None)
        if unknown is None:
            _require_all(signature, what, count, given)
            return
        near = intended_name(unknown, names)
        hint = f"did you mean {near}?" if near else missing_option(unknown.lower())
        if "accuracy" in names and any(part in unknown.lower() for part in REFINED):
            hint = ACCURACY
        raise InvalidCallError(
            f"{what} has no option {unknown!r}, expected one of {', '.join(names)}" + (f"; {hint}" if hint else "")
        )

    return concise(function, check)


def _require_all(signature: inspect.Signature, what: str, count: int, given: tuple[str, ...]) -> None:
    """Raise where an argument is missing, given twice or too many."""
    try:
        signature.bind(*range(count), **dict.fromkeys(given))
    except TypeError as error:
        required = [name for name, p in signature.parameters.items() if p.default is p.empty and name != "self"]
        hint = f"; {HORIZON}" if "'horizon'" in str(error) else ""
        if "too many positional" in str(error):
            hint = "; the options behind these are named, as steps=20"
        raise InvalidCallError(f"{what}: {error}, expected {what}({', '.join(required)}, ...){hint}") from error


def require_arguments(name: str, function: Any, expected: str, more: str = "") -> bool:
    """Raise unless ``function`` is one of the arguments in ``expected``, ``"(q, u)"``, or of these and ``more``.

    A time, ``t``, is the last of the arguments that are expected, or is not among them. Returns whether it takes
    ``more``.
    """
    if not callable(function):
        raise InvalidInputError(f"{name} must be a function of {expected}, got {function!r}")
    parameters, count = _names(function), expected.count(",") + 1
    if parameters is None:
        return False
    clock = _has_clock(parameters, count, expected.endswith("t)"))
    takes_them = bool(more) and takes_more(function, count)
    if not (takes_them or _binds(function, count)) or clock:
        hint = f"; {ENERGY_TIME if expected == '(q, p)' else TIME}" if clock and not expected.endswith("t)") else ""
        also = f", or of these and {more}" if more else ""
        raise InvalidInputError(
            f"{name} must be a function of {expected}{also}, got one with the arguments {arguments_of(function)}{hint}"
        )
    return takes_them


def _has_clock(parameters: list[str], count: int, timed: bool) -> bool:
    """Whether there is a time among the arguments where none is expected."""
    if timed:
        return any(name in TIMES and place != count - 1 for place, name in enumerate(parameters))
    return len(parameters) > count and not CLOCKS.isdisjoint(parameters)


def takes_more(function: Callable[..., Any], count: int) -> bool:
    """Whether a function takes one argument more than ``count``, and cannot do without it."""
    return _names(function) is not None and not _binds(function, count) and _binds(function, count + 1)


def arguments_of(function: Callable[..., Any]) -> str:
    """The names of the arguments, as ``(q, u)``."""
    return f"({', '.join(_names(function) or ['...'])})"


def _names(function: Callable[..., Any]) -> list[str] | None:
    """Names of the arguments; None for a builtin, which has none."""
    try:
        return list(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return None


def _binds(function: Callable[..., Any], count: int) -> bool:
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    return True
