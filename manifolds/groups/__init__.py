"""Matrix Lie groups."""

from .special_orthogonal import SO, hat, skew_basis, vee

__all__ = ["SO", "hat", "skew_basis", "vee"]
