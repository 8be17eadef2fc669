"""Packages that are imported where they are used."""

from importlib import import_module
from typing import Any

from .errors import RetraxError


class MissingPackageError(RetraxError, ImportError):
    """The error of a function that needs a package that is not installed."""


def require_package(name: str, what: str) -> Any:
    """The module of a package; raises ``MissingPackageError`` with the line that installs it where it is not
    installed."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.partition(".")[0] != name.partition(".")[0]:
            raise
        package = name.partition(".")[0]
        raise MissingPackageError(
            f"{what} needs the package {package}, which is not installed; try: pip install {package}"
        ) from error
