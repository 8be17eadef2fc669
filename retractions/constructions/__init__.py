"""Retractions made of other retractions."""

from .power import PowerRetraction
from .product import ProductRetraction
from .second_order import SecondOrder, acceleration
from .stabilized import Stabilized

__all__ = ["PowerRetraction", "ProductRetraction", "SecondOrder", "Stabilized", "acceleration"]
