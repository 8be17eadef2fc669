"""Retractions made of other retractions."""

from .power import PowerRetraction
from .product import ProductRetraction
from .second_order import SecondOrder, acceleration
from .stabilized import RestoredAfter

__all__ = ["PowerRetraction", "ProductRetraction", "RestoredAfter", "SecondOrder", "acceleration"]
