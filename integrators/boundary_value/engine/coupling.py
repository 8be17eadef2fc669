"""The functions of the ends by the names of the engine."""

from ..transcription.functions.linked_ends import Link, LinkageFunctions
from ..transcription.functions.linked_ends import LinkedEnds as Coupled

Coupling = LinkageFunctions
Coupling._function = property(lambda self: self.function)  # pyright: ignore[reportAttributeAccessIssue]

__all__ = ["Coupled", "Coupling", "Link"]
