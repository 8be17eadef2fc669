"""The door to pymanopt. Importing it imports pymanopt."""

from .conventions import conventions_of, typical_distance
from .manifold import RetraxManifold
from .spaces import counterpart

__all__ = ["RetraxManifold", "conventions_of", "counterpart", "typical_distance"]
