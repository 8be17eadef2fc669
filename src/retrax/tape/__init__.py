"""Functions as tapes of scalar operations: traced from JAX, differentiated by CasADi, run on many points at once."""

from .arrays import NotTraceableError
from .tape import Tape

__all__ = ["NotTraceableError", "Tape"]
