"""Inequalities along a trajectory: bounds of the controls, and functions of state and control that are not positive."""

from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..manifolds import Euclidean, InvalidInputError, Manifold
from ..manifolds.numerics.ambient import Ambient, is_traced
from .functions import real_vector

LOWER, UPPER = "control_bounds lower", "control_bounds upper"
HORIZON_LOWER, HORIZON_UPPER = "horizon lower", "horizon upper"
PARAMETERS_LOWER, PARAMETERS_UPPER = "parameters lower", "parameters upper"
TAKEN = LOWER, UPPER, HORIZON_LOWER, HORIZON_UPPER, PARAMETERS_LOWER, PARAMETERS_UPPER
NO_BOUND = "-numpy.inf or numpy.inf where there is no bound"
Constraint = Callable[..., Any]


@final
class Inequalities(eqx.Module):
    """``lower <= u <= upper``, and the entries of functions of ``(q, u)``, each ``<= 0``.

    ``lower``, ``upper``: of all entries of ``u`` in a row, infinite where there is no bound; empty where there is none
    at all. ``names`` of the ``functions``; ``at_first`` are those that hold at the first point of a trajectory only.
    """

    lower: tuple[float, ...] = eqx.field(static=True, default=())
    upper: tuple[float, ...] = eqx.field(static=True, default=())
    names: tuple[str, ...] = eqx.field(static=True, default=())
    functions: tuple[Constraint, ...] = ()
    at_first: frozenset[str] = eqx.field(static=True, default=frozenset())

    @classmethod
    def of(
        cls, bounds: Any, constraints: Any, controls: Manifold, at_first: frozenset[str] = frozenset()
    ) -> "Inequalities":
        """Those of a user, checked; the arguments of the functions are not looked at."""
        lower, upper = _checked_bounds(bounds, controls)
        given = _checked_constraints(constraints)
        return cls(lower, upper, tuple(given), tuple(given.values()), at_first)

    @property
    def bounded(self) -> dict[str, list[int]]:
        """The entries of ``u`` that have a bound, from below and from above."""
        sides = {LOWER: self.lower, UPPER: self.upper}
        return {name: [i for i, value in enumerate(side) if isfinite(value)] for name, side in sides.items()}

    @property
    def any(self) -> bool:
        """Whether there is one."""
        return bool(self.functions) or any(self.bounded.values())

    @property
    def along(self) -> bool:
        """Whether there is one that holds along the whole trajectory."""
        return any(self.bounded.values()) or not self.at_first.issuperset(self.names)

    def values(self, q: Ambient, u: Ambient) -> Float[Array, " k"]:
        """All of them at a state and a control: bounds from below, from above, then the functions in their order."""
        rows, sides = [jnp.zeros(0)], self.bounded
        if any(sides.values()):
            flat = jnp.ravel(u)
            below, above = (np.array(side, int) for side in sides.values())
            rows += [np.array(self.lower)[below] - flat[below], flat[above] - np.array(self.upper)[above]]
        return jnp.concatenate([*rows, *self.of_functions(q, u)])

    def of_functions(self, q: Ambient, u: Ambient) -> tuple[Array, ...]:
        """The values of each function, in a row."""
        named = zip(self.names, self.functions, strict=True)
        return tuple(jnp.ravel(real_vector(constraint_words(name), function(q, u))) for name, function in named)

    def sizes(self, q: Ambient, u: Ambient) -> dict[str, int | None]:
        """How many entries each function has at states and controls of this structure, None for a number."""
        found = {}
        for name, function in zip(self.names, self.functions, strict=True):
            value = jax.eval_shape(lambda q, u, n=name, f=function: real_vector(constraint_words(n), f(q, u)), q, u)
            found[name] = value.shape[0] if value.shape else None
        return found

    def words(self, sizes: dict[str, int | None], shape: tuple[int, ...]) -> tuple[str, ...]:
        """A name for each entry, where ``u`` has this shape: ``cone[1]``."""
        of_bounds = (_entry(name, np.unravel_index(i, shape)) for name, side in self.bounded.items() for i in side)
        of_functions = (
            _entry(n, () if size is None else (i,)) for n, size in sizes.items() for i in range(_count(size))
        )
        return (*of_bounds, *of_functions)

    def by_name(self, values: np.ndarray, sizes: dict[str, int | None]) -> dict[str, np.ndarray]:
        """Numbers that belong to the entries, along the last axis, under the names; zero where there is no bound."""
        found, begin = {}, 0
        for name, side in self.bounded.items():
            if side:
                found[name] = np.zeros((*values.shape[:-1], len(self.lower)))
                found[name][..., side] = values[..., begin : begin + len(side)]
            begin += len(side)
        for name, size in sizes.items():
            found[name] = values[..., begin : begin + _count(size)]
            begin += _count(size)
        return found

    def flat(self, named: Mapping[str, np.ndarray], shape: tuple[int, ...], sizes: dict[str, int | None]) -> np.ndarray:
        """The inverse of ``by_name``, of shape ``(*shape, k)``, zero for missing names; raises for wrong widths."""
        widths = {name: (len(self.lower), side) for name, side in self.bounded.items() if side}
        widths |= {name: (_count(size), list(range(_count(size)))) for name, size in sizes.items()}
        columns = []
        for name, (width, kept) in widths.items():
            given = named.get(name, np.zeros((1, width)))
            if given.shape[-1] != width:
                raise InvalidInputError(
                    f"guess: multipliers of {name!r} have {given.shape[-1]} entries at a stage, expected {width}; try "
                    "guess._replace(multipliers=None), of a solution solution.guess()._replace(multipliers=None)"
                )
            columns.append(np.broadcast_to(given[..., kept], (int(np.prod(shape)), len(kept))))
        return np.concatenate(columns, axis=1).reshape(*shape, -1)

    def mask(self, sizes: dict[str, int | None], steps: int, stages: int) -> np.ndarray:
        """At which points each entry holds, shape ``(steps, stages, k)``."""
        once = [False for side in self.bounded.values() for _ in side]
        once += [name in self.at_first for name, size in sizes.items() for _ in range(_count(size))]
        holds = np.ones((steps, stages, len(once)), bool)
        holds[:, :, once] = False
        holds[0, 0] = True
        return holds


def constraint_words(name: str) -> str:
    """What the function of a constraint is called in a message."""
    return f"constraints[{name!r}]"


def _entry(name: str, place: tuple[Any, ...]) -> str:
    return f"{name}[{', '.join(str(int(i)) for i in place)}]" if place else name


def _count(size: int | None) -> int:
    return 1 if size is None else size


def _checked_bounds(given: Any, controls: Manifold) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Both bounds of all entries of the control; raises where something is wrong."""
    if given is None:
        return (), ()
    if not (isinstance(given, tuple | list) and len(given) == 2):
        raise InvalidInputError(
            f"control_bounds must be a pair (lower, upper) of numbers or arrays, got {given!r}; try (-1.0, 1.0)"
        )
    if not isinstance(controls, Euclidean):
        raise InvalidInputError(
            f"control_bounds are given, {given!r}, and the controls lie in {controls}; expected controls in R^m; try "
            'constraints={"name": function}, a function of (q, u) that is not positive where the control is admissible'
        )
    both = (_checked_side(name, side, controls.shape) for name, side in zip(("lower", "upper"), given, strict=True))
    lower, upper = both
    for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
        place = _entry("u", np.unravel_index(i, controls.shape))
        if low > high or low == np.inf or high == -np.inf:
            raise InvalidInputError(
                f"control_bounds of {place} are {low:.6g} and {high:.6g}, expected the lower one first"
            )
        if low == high:
            raise InvalidInputError(
                f"control_bounds of {place} are both {low:.6g}, expected a lower one that is less than the upper one; "
                "write a control that is a given number into the dynamics"
            )
    return lower, upper


def _checked_side(name: str, given: Any, shape: tuple[int, ...]) -> tuple[float, ...]:
    """The bounds of all entries of the control on one side."""
    if is_traced(given):
        raise InvalidInputError(
            f"control_bounds: {name} is traced by JAX, expected numbers; try constraints={{...}} for a bound that is a "
            "parameter"
        )
    expected = f"expected a number or an array of shape {shape}, {NO_BOUND}"
    try:
        array = np.asarray(given)
    except ValueError as error:
        raise InvalidInputError(f"control_bounds: {name} is {given!r:.80}, {expected}") from error
    if array.dtype.kind not in "fiu":
        raise InvalidInputError(f"control_bounds: {name} is {given!r:.80}, {expected}")
    if array.shape not in ((), shape):
        raise InvalidInputError(f"control_bounds: {name} has shape {array.shape}, {expected}")
    if np.any(np.isnan(array)):
        raise InvalidInputError(f"control_bounds: {name} has entries that are NaN, {expected}")
    return tuple(map(float, np.broadcast_to(array, shape).ravel()))


def _checked_constraints(given: Any) -> dict[str, Constraint]:
    """The constraints by their names; raises where something is wrong."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise InvalidInputError(
            f'constraints must be a dictionary of functions by their names, got {given!r:.80}; try {{"name": function}}'
        )
    for name, function in given.items():
        if not isinstance(name, str) or not name.strip():
            raise InvalidInputError(
                f'constraints must have names that are words, got {name!r}; try {{"name": function}}'
            )
        if name in TAKEN:
            raise InvalidInputError(f"constraints have the name {name!r}, which bounds have; try another one")
        if not callable(function):
            raise InvalidInputError(
                f"{constraint_words(name)} must be a function of a state and a control, got {function!r:.80}"
            )
    return dict(given)
