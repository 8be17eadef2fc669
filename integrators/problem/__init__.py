"""The problem as a user states it: problem, constraints, conditions on the ends, free quantities, units, notation."""

from typing import Any

from ...former_names import former_module


def __getattr__(name: str) -> Any:
    """The names of the module that this package was."""
    return former_module(__name__, name)
