"""Functions as tapes of scalar operations: traced from JAX, differentiated by CasADi, run on many points at once."""

from .arrays import NotTraceableError
from .tape import Tape
from .trace import Flat, flat

__all__ = ["Flat", "NotTraceableError", "Tape", "flat"]
