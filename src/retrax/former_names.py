"""Former public names and fields, which work for one more release with a ``DeprecationWarning``."""

import warnings
from collections.abc import Mapping
from importlib import import_module
from operator import attrgetter
from typing import Any


def former(module: str, names: Mapping[str, str], name: str) -> Any:
    """The object of a module that had this name.

    ``names``: the present names by the former ones. Raises ``AttributeError`` for a name that the module never had.
    """
    if name not in names:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(f"{module}.{name} is deprecated; use {names[name]}", DeprecationWarning, stacklevel=3)
    return attrgetter(names[name])(import_module(module))


def former_field(owner: str, former_name: str, name: str) -> property:
    """The property of a class that returns a field by its former name."""

    def read(instance: Any) -> Any:
        warnings.warn(f"{owner}.{former_name} is deprecated; use {name}", DeprecationWarning, stacklevel=2)
        return getattr(instance, name)

    return property(read, doc=f"The former name of ``{name}``.")
