"""Modules of Equinox whose constructors raise errors with short tracebacks."""

from typing import TYPE_CHECKING

import equinox as eqx

from .errors import concise

if TYPE_CHECKING:  # a checker knows the constructors by the fields
    Module = eqx.Module
else:

    class ConciseConstructor(type(eqx.Module)):
        """Classes whose constructor is ``concise``: Equinox has frames between it and ``__init__``."""

        __call__ = concise(type(eqx.Module).__call__)

    class Module(eqx.Module, metaclass=ConciseConstructor):
        """A module whose constructor is ``concise``."""
