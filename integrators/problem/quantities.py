"""Names and units of what a problem is about: the arrays of a state, the controls, the time, the cost."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Self, final

import jax

from ...manifolds import InvalidInputError, Manifold, Product
from ...manifolds.product import factor_name
from ..reporting.text import brief

ABOUT = "states", "controls"
UNITS = (*ABOUT, "time", "cost")


@final
@dataclass(frozen=True)
class Quantity:
    """An array of a state or a control: its name, the units and names of its entries, and its manifold.

    Attributes
    ----------
    name : str
        The name of the array.
    units : tuple of str
        One unit for all entries, or one each; empty without units.
    entries : tuple of str
        Names of the entries, row by row; by default their indices, such as ``1`` or ``0,2``.
    space : str
        Its manifold, such as ``SO(3)``.
    bounds : tuple of pairs of float
        The least and the largest value of each entry of a bounded control; empty without bounds.
    """

    name: str
    units: tuple[str, ...]
    entries: tuple[str, ...]
    space: str
    bounds: tuple[tuple[float, float], ...] = ()

    @property
    def unit(self) -> str:
        """The unit of all entries; empty if there are several units, or none."""
        return self.units[0] if len(set(self.units)) == 1 else ""

    @property
    def title(self) -> str:
        """The name with the unit of all entries, such as ``body rate [rad/s]``."""
        return with_unit(self.name, self.unit)

    @property
    def is_named(self) -> bool:
        """Whether the entries have names of their own."""
        return not all(entry == "" or entry.replace(",", "").isdigit() for entry in self.entries)

    def unit_of(self, k: int) -> str:
        """The unit of an entry.

        Parameters
        ----------
        k : int
            The number of the entry.
        """
        return self.units[k if len(self.units) > 1 else 0]

    @property
    def columns(self) -> tuple[str, ...]:
        """A name for each entry: its own name, or the name of the array with its index, such as ``body rate[1]``."""
        if self.is_named:
            return self.entries
        return tuple(f"{self.name}[{entry}]" if entry else self.name for entry in self.entries)


@final
@dataclass(frozen=True)
class Quantities:
    """The quantities of a problem: the arrays of a state and of a control, and the units of time and cost.

    Attributes
    ----------
    states : tuple of Quantity
        The arrays of a state, in order.
    controls : tuple of Quantity
        The arrays of a control, in order.
    time, cost : str
        Their units.
    """

    states: tuple[Quantity, ...]
    controls: tuple[Quantity, ...]
    time: str = ""
    cost: str = ""

    @classmethod
    def of(cls, manifold: Manifold, controls: Manifold, labels: Any, units: Any) -> Self:
        """The quantities with the labels and units of a user; raises ``InvalidInputError`` for names that do not
        fit.

        Parameters
        ----------
        manifold, controls : Manifold
            The manifolds of states and controls.
        labels, units : mapping
            As in ``OptimalControlProblem``.
        """
        if isinstance(labels, cls):
            return labels
        given = {"labels": _check_words("labels", labels, ABOUT), "units": _check_words("units", units, UNITS)}
        own: Any = {
            about: _quantities(about, space, given["labels"].get(about), given["units"].get(about))
            for about, space in zip(ABOUT, (manifold, controls), strict=True)
        }
        rest: Any = {name: _word(f"units[{name!r}]", given["units"].get(name, "")) for name in ("time", "cost")}
        return cls(**own, **rest)

    @classmethod
    def unnamed(cls, states: list[tuple[int, ...]], controls: list[tuple[int, ...]]) -> Self:
        """The quantities of unnamed arrays.

        Parameters
        ----------
        states, controls : list of tuple of int
            The shapes of the arrays.
        """

        def own(symbol: str, shapes: list[tuple[int, ...]]) -> tuple[Quantity, ...]:
            pairs = zip(_names(symbol, shapes), shapes, strict=True)
            return tuple(Quantity(name, ("",), _places(shape), "") for name, shape in pairs)

        return cls(own("q", states), own("u", controls))

    def bounded(self, lower: tuple[float, ...], upper: tuple[float, ...]) -> Self:
        """The quantities, with bounds of the control entries.

        Parameters
        ----------
        lower, upper : tuple of float
            The bounds of all entries, infinite where there is none; empty without bounds.
        """
        bounds = tuple(zip(lower, upper, strict=True))
        is_fit = len(self.controls) == 1 and len(bounds) in (0, len(self.controls[0].entries))
        return replace(self, controls=(replace(self.controls[0], bounds=bounds),)) if is_fit else self

    def with_rates(self) -> Self:
        """The quantities of a problem whose controls are states, and whose new controls are their rates."""
        time = self.time or "unit of time"
        rates = (
            replace(own, name=f"rate of {own.name}", units=tuple(u and f"{u}/{time}" for u in own.units), bounds=())
            for own in self.controls
        )
        return replace(self, states=(*self.states, *self.controls), controls=tuple(rates))

    def factors(self, count: int) -> list[str]:
        """The names of the factors of a state: their labels, or ``factor 0`` for a factor without one.

        Parameters
        ----------
        count : int
            The number of factors.
        """
        names = [factor_name(k) for k in range(count)]
        if len(self.states) == count:
            pairs = zip(names, self.states, _names("q", self.states), strict=True)
            names = [name if own.name == default else own.name for name, own, default in pairs]
        return names

    def labelled(self, name: str, count: int) -> str:
        """A name that begins with ``factor k``, with the label of this factor of a state instead.

        Parameters
        ----------
        name : str
            The name, such as ``factor 0, SO(3)``.
        count : int
            The number of factors.
        """
        return re.sub(r"^factor (\d+)", lambda found: self.factors(count)[int(found[1])], name)

    @property
    def text(self) -> str:
        """The text of the quantities in a file."""
        return json.dumps(asdict(self))

    @classmethod
    def from_text(cls, text: str) -> Self:
        """The quantities with this ``text``; raises ``InvalidInputError`` for another text.

        Parameters
        ----------
        text : str
            The text.
        """
        try:
            values = json.loads(text)
            own: Any = {about: tuple(_read(value) for value in values.pop(about)) for about in ABOUT}
            rest: Any = {name: _word(name, value) for name, value in values.items()}
            return cls(**own, **rest)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InvalidInputError(f"quantities are {brief(text)}, expected names and units ({error})") from error

    def require_fits(self, what: str, states: Any, controls: Any) -> None:
        """Raise an error unless arrays with a leading axis have as many entries as there are names.

        Parameters
        ----------
        what : str
            A word for the arrays.
        states, controls : array, or tuple of arrays
            The arrays.
        """
        for name, own, given in (("states", self.states, states), ("controls", self.controls, controls)):
            expected, got = (
                [len(quantity.entries) for quantity in own],
                [leaf[0].size for leaf in jax.tree.leaves(given)],
            )
            if expected != got:
                raise InvalidInputError(
                    f"{what}{name} have {got} entries, expected {expected}, of which quantities has names"
                )

    @property
    def lines(self) -> list[str]:
        """The names in words: a line for the states and a line for the controls, if they have names."""
        rows = {"q": self.states, "u": self.controls}
        defaults = {symbol: _names(symbol, each) for symbol, each in rows.items()}
        named = {
            s for s, each in rows.items() if [q.name for q in each] != defaults[s] or any(q.is_named for q in each)
        }
        return [f"{symbol}: {', '.join(map(_words, each))}" for symbol, each in rows.items() if symbol in named]


def with_unit(name: str, unit: str) -> str:
    """The name with its unit in brackets; the name alone for none."""
    return f"{name} [{unit}]" if unit else name


def _words(quantity: Quantity) -> str:
    if not quantity.is_named:
        return quantity.title
    return ", ".join(with_unit(entry, quantity.unit_of(k)) for k, entry in enumerate(quantity.entries))


def _check_words(what: str, given: Any, expected: tuple[str, ...]) -> dict[str, Any]:
    """The given words by their keys; raises for other keys."""
    if given is None:
        return {}
    if not isinstance(given, Mapping) or not set(given) <= set(expected):
        raise InvalidInputError(
            f"{what} must be a dictionary with keys among {', '.join(map(repr, expected))}, got {brief(given)}; try "
            f'{what}={{"controls": "{"torque" if what == "labels" else "N m"}"}}'
        )
    return dict(given)


def _quantities(about: str, manifold: Manifold, labels: Any, units: Any) -> tuple[Quantity, ...]:
    """The quantities that the arrays of a point are."""
    arrays = list(_arrays(manifold))
    defaults = _names("q" if about == "states" else "u", arrays)
    names = defaults if labels is None else _each(f"labels[{about!r}]", labels, arrays)
    own_units = [""] * len(arrays) if units is None else _each(f"units[{about!r}]", units, arrays)
    found = zip(arrays, names, own_units, defaults, strict=True)
    return tuple(_quantity(about, *row) for row in found)


def _each(what: str, given: Any, arrays: list[tuple[str, tuple[int, ...]]]) -> list[Any]:
    """The words for each of the arrays; raises for another number of words."""
    if len(arrays) == 1:
        return [given]
    if not isinstance(given, list | tuple) or len(given) != len(arrays):
        spaces = ", ".join(space for space, _ in arrays)
        raise InvalidInputError(f"{what} must be a tuple with one entry for each of {spaces}, got {brief(given)}")
    return list(given)


def _quantity(about: str, array: tuple[str, tuple[int, ...]], label: Any, unit: Any, default: str) -> Quantity:
    """One array with its label and unit, words or a tuple of a word for each entry."""
    space, shape = array
    places = _places(shape)
    units = (
        (_word(f"units[{about!r}]", unit),)
        if isinstance(unit, str)
        else _several(f"units[{about!r}]", unit, space, places)
    )
    if isinstance(label, str):
        return Quantity(label or default, units, places, space)
    return Quantity(default, units, _several(f"labels[{about!r}]", label, space, places), space)


def _places(shape: tuple[int, ...]) -> tuple[str, ...]:
    """The places of the entries of an array, row by row."""
    return tuple(",".join(map(str, place)) for place in product(*map(range, shape)))


def _several(what: str, given: Any, space: str, places: tuple[str, ...]) -> tuple[str, ...]:
    if (
        not isinstance(given, list | tuple)
        or len(given) != len(places)
        or not all(isinstance(word, str) for word in given)
    ):
        raise InvalidInputError(
            f"{what} of {space} must be a text, or a tuple of {len(places)} texts, one for each of its entries, got "
            f"{brief(given)}"
        )
    return tuple(given)


def _word(what: str, given: Any) -> str:
    if not isinstance(given, str):
        raise InvalidInputError(f"{what} must be a text, got {brief(given)}")
    return given


def _names(symbol: str, arrays: Any) -> list[str]:
    return [symbol] if len(arrays) == 1 else [f"{symbol}[{k}]" for k in range(len(arrays))]


def _arrays(manifold: Manifold) -> Iterator[tuple[str, tuple[int, ...]]]:
    """The spaces and shapes of the arrays of a point."""
    if isinstance(manifold, Product):
        for factor in manifold.factors:
            yield from _arrays(factor)
        return
    leaves = jax.tree.leaves(manifold.ambient)
    for k, leaf in enumerate(leaves):
        yield (str(manifold) if len(leaves) == 1 else f"{manifold}, array {k}"), leaf.shape


def _read(value: Any) -> Quantity:
    """A quantity from a file."""
    units, entries = (tuple(_word(name, word) for word in value[name]) for name in ("units", "entries"))
    if len(units) not in (1, len(entries)):
        raise ValueError(f"{len(units)} units of {len(entries)} entries")
    bounds = tuple((float(low), float(high)) for low, high in value.get("bounds", ()))  # absent in former files
    if len(bounds) not in (0, len(entries)):
        raise ValueError(f"{len(bounds)} bounds of {len(entries)} entries")
    return Quantity(_word("name", value["name"]), units, entries, _word("space", value["space"]), bounds)
