"""Spaces of other libraries that we do not have, through functions on the host."""

from .checks import wrap
from .manifold import HostSpace, WrappedManifold, WrappedRetraction

__all__ = ["HostSpace", "WrappedManifold", "WrappedRetraction", "wrap"]
