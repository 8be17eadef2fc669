"""Inequalities along a trajectory: bounds of the controls, and functions of state and control that are not positive."""

from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...manifolds import Euclidean, InvalidInputError, Manifold
from ...manifolds.numerics.ambient import Ambient, is_traced
from ..reporting.text import brief
from .user_functions import real_vector

LOWER, UPPER = "control_bounds lower", "control_bounds upper"
HORIZON_LOWER, HORIZON_UPPER = "horizon lower", "horizon upper"
PARAMETERS_LOWER, PARAMETERS_UPPER = "parameters lower", "parameters upper"
TAKEN = LOWER, UPPER, HORIZON_LOWER, HORIZON_UPPER, PARAMETERS_LOWER, PARAMETERS_UPPER
NOT_POSITIVE = "return a number that is not positive where the {0} is admissible, as {1}[0] - 1 for {1}[0] < 1"
OF_CONTROL, OF_STATE = NOT_POSITIVE.format("control", "u"), NOT_POSITIVE.format("state", "q")
NO_BOUND = "-numpy.inf or numpy.inf where there is no bound"
Constraint = Callable[..., Any]


@final
class Inequalities(eqx.Module):
    """Bounds ``lower <= u <= upper``, functions of ``(q, u)`` and functions of ``q``, each ``<= 0``.

    ``lower``, ``upper``: bounds of all entries of ``u`` in a row, infinite without a bound; empty without any bounds.
    ``names``: names of the ``functions``, which hold at the points of a trajectory. Functions ``at_first`` hold at the
    first point only, ``node_functions`` at the nodes. ``clock``: whether the end of the time is given, if the last
    entry of the state is the time, or None.
    """

    lower: tuple[float, ...] = eqx.field(static=True, default=())
    upper: tuple[float, ...] = eqx.field(static=True, default=())
    names: tuple[str, ...] = eqx.field(static=True, default=())
    functions: tuple[Constraint, ...] = ()
    at_first: frozenset[str] = eqx.field(static=True, default=frozenset())
    node_names: tuple[str, ...] = eqx.field(static=True, default=())
    node_functions: tuple[Constraint, ...] = ()
    clock: bool | None = eqx.field(static=True, default=None)

    @classmethod
    def of(cls, bounds: Any, constraints: Any, node_constraints: Any, controls: Manifold) -> "Inequalities":
        """The inequalities of a user, checked without a look at the arguments of the functions."""
        lower, upper = _check_bounds(bounds, controls)
        given = _check_constraints("constraints", constraints, "a state and a control")
        at_nodes = _check_constraints("node_constraints", node_constraints, "a state")
        for name in at_nodes:
            if name in given:
                raise InvalidInputError(
                    f"{node_words(name)} has the name of one of the constraints; expected another one, under which its "
                    f"multipliers are found; try {name + ' at the nodes'!r}"
                )
        own, more = tuple(given.values()), tuple(at_nodes.values())
        return cls(lower, upper, tuple(given), own, node_names=tuple(at_nodes), node_functions=more)

    def with_functions(
        self, functions: tuple[Constraint, ...], node_functions: tuple[Constraint, ...]
    ) -> "Inequalities":
        """The inequalities with the same bounds and names, and other functions."""
        names = self.lower, self.upper, self.names
        return Inequalities(*names, functions, self.at_first, self.node_names, node_functions, self.clock)

    def bounds(self, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray] | None:
        """The bounds of controls of this shape; None if there are none."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        return (lower.reshape(shape), upper.reshape(shape)) if lower.size else None

    @property
    def bounded(self) -> dict[str, list[int]]:
        """The entries of ``u`` that have a bound, from below and from above."""
        sides = {LOWER: self.lower, UPPER: self.upper}
        return {name: [i for i, value in enumerate(side) if isfinite(value)] for name, side in sides.items()}

    @property
    def any(self) -> bool:
        """Whether there is one."""
        return bool(self.functions or self.node_functions) or any(self.bounded.values())

    @property
    def along(self) -> bool:
        """Whether there is one that holds along the whole trajectory."""
        return any(self.bounded.values()) or bool(self.node_names) or not self.at_first.issuperset(self.names)

    def once(self, sizes: Mapping[str, int | None]) -> np.ndarray:
        """Whether each entry holds at the first point only, as bounds of free quantities do.

        ``sizes``: numbers of entries of the functions.
        """
        found = [False for side in self.bounded.values() for _ in side]
        return np.array(
            found + [name in self.at_first for name, size in sizes.items() for _ in range(count(size))], bool
        )

    @property
    def every_name(self) -> tuple[str, ...]:
        """The names of all functions."""
        return *self.names, *self.node_names

    @property
    def function_words(self) -> tuple[str, ...]:
        """The names of all functions in messages."""
        return *map(constraint_words, self.names), *map(node_words, self.node_names)

    def values(self, q: Ambient, u: Ambient) -> Float[Array, " k"]:
        """The inequalities of a state and a control: bounds from below, from above, then the functions in order."""
        rows, sides = [jnp.zeros(0)], self.bounded
        if any(sides.values()):
            flat = jnp.ravel(u)
            below, above = (np.array(side, int) for side in sides.values())
            rows += [np.array(self.lower)[below] - flat[below], flat[above] - np.array(self.upper)[above]]
        return jnp.concatenate([*rows, *self.of_points(q, u)])

    def at_node(self, q: Ambient) -> Float[Array, " k"]:
        """The inequalities at a node, in order."""
        return jnp.concatenate([jnp.zeros(0), *self.of_nodes(q)])

    def of_functions(self, q: Ambient, u: Ambient) -> tuple[Array, ...]:
        """The values of each function in a row, with the functions at the nodes last."""
        return *self.of_points(q, u), *self.of_nodes(q)

    def of_points(self, q: Ambient, u: Ambient) -> tuple[Array, ...]:
        """The values of each function at a point, in a row."""
        return tuple(map(jnp.ravel, self._each(q, u)))

    def of_nodes(self, q: Ambient) -> tuple[Array, ...]:
        """The values of each function at a node, in a row."""
        return tuple(map(jnp.ravel, self._each_at_node(q)))

    def _each(self, q: Ambient, u: Ambient) -> list[Array]:
        named = zip(self.names, self.functions, strict=True)
        return [real_vector(constraint_words(name), function(q, u), OF_CONTROL) for name, function in named]

    def _each_at_node(self, q: Ambient) -> list[Array]:
        named = zip(self.node_names, self.node_functions, strict=True)
        return [real_vector(node_words(name), function(q), OF_STATE) for name, function in named]

    def sizes(self, q: Ambient, u: Ambient) -> dict[str, int | None]:
        """How many entries each function at the points has at states and controls of this structure, None for a
        number."""
        return dict(zip(self.names, map(_size, jax.eval_shape(self._each, q, u)), strict=True))

    def node_sizes(self, q: Ambient) -> dict[str, int | None]:
        """How many entries each function at the nodes has at states of this structure, None for a number."""
        return dict(zip(self.node_names, map(_size, jax.eval_shape(self._each_at_node, q)), strict=True))

    def words_of_entries(self, q: Ambient, u: Ambient) -> list[str]:
        """The name in messages of the function of each entry of ``of_functions``."""
        sizes = (*self.sizes(q, u).values(), *self.node_sizes(q).values())
        return [words for words, size in zip(self.function_words, sizes, strict=True) for _ in range(count(size))]

    def words(self, sizes: dict[str, int | None], shape: tuple[int, ...]) -> tuple[str, ...]:
        """A name for each entry at a point, where ``u`` has this shape: ``cone[1]``."""
        of_bounds = (_entry(name, np.unravel_index(i, shape)) for name, side in self.bounded.items() for i in side)
        return (*of_bounds, *entry_words(sizes))

    def by_name(self, values: np.ndarray, sizes: dict[str, int | None]) -> dict[str, np.ndarray]:
        """Numbers that belong to the entries, along the last axis, under the names; zero where there is no bound."""
        found, begin = {}, 0
        for name, side in self.bounded.items():
            if side:
                found[name] = np.zeros((*values.shape[:-1], len(self.lower)))
                found[name][..., side] = values[..., begin : begin + len(side)]
            begin += len(side)
        return found | entries_of(values[..., begin:], sizes)


def constraint_words(name: str) -> str:
    """The name of the function of a constraint in a message."""
    return f"constraints[{name!r}]"


def node_words(name: str) -> str:
    """The name of the function of a constraint at the nodes in a message."""
    return f"node_constraints[{name!r}]"


def entry_words(sizes: Mapping[str, int | None]) -> tuple[str, ...]:
    """A name for each entry of functions of these sizes."""
    return tuple(_entry(name, () if size is None else (i,)) for name, size in sizes.items() for i in range(count(size)))


def entries_of(values: np.ndarray, sizes: Mapping[str, int | None]) -> dict[str, np.ndarray]:
    """Numbers that belong to the entries of functions of these sizes, along the last axis, under their names."""
    cuts = np.cumsum([0, *map(count, sizes.values())])
    return {name: values[..., a:b] for name, a, b in zip(sizes, cuts[:-1], cuts[1:], strict=True)}


def count(size: int | None) -> int:
    """How many entries a function of a size has."""
    return 1 if size is None else size


def _size(value: Any) -> int | None:
    return value.shape[0] if value.shape else None


def _entry(name: str, place: tuple[Any, ...]) -> str:
    return f"{name}[{', '.join(str(int(i)) for i in place)}]" if place else name


def _check_bounds(given: Any, controls: Manifold) -> tuple[tuple[float, ...], tuple[float, ...]]:
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
    both = (_check_side(name, side, controls.shape) for name, side in zip(("lower", "upper"), given, strict=True))
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


def _check_side(name: str, given: Any, shape: tuple[int, ...]) -> tuple[float, ...]:
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
        raise InvalidInputError(f"control_bounds: {name} is {brief(given)}, {expected}") from error
    if array.dtype.kind not in "fiu":
        raise InvalidInputError(f"control_bounds: {name} is {brief(given)}, {expected}")
    if array.shape not in ((), shape):
        raise InvalidInputError(f"control_bounds: {name} has shape {array.shape}, {expected}")
    if np.any(np.isnan(array)):
        raise InvalidInputError(f"control_bounds: {name} has entries that are NaN, {expected}")
    return tuple(map(float, np.broadcast_to(array, shape).ravel()))


def _check_constraints(kind: str, given: Any, of: str) -> dict[str, Constraint]:
    """The constraints of a kind, functions ``of`` something, by their names; raises where something is wrong."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise InvalidInputError(
            f'{kind} must be a dictionary of functions by their names, got {brief(given)}; try {{"name": function}}'
        )
    for name, function in given.items():
        if not isinstance(name, str) or not name.strip():
            raise InvalidInputError(f'{kind} must have names that are words, got {name!r}; try {{"name": function}}')
        if name in TAKEN:
            raise InvalidInputError(f"{kind} have the name {name!r}, which bounds have; try another one")
        if not callable(function):
            raise InvalidInputError(f"{kind}[{name!r}] must be a function of {of}, got {brief(function)}")
    return dict(given)
