"""The base of all errors, below tape and layers."""


class RetraxError(Exception):
    """Base of every error that this library raises.

    >>> issubclass(InvalidInputError, RetraxError), issubclass(ConvergenceError, RetraxError)
    (True, True)
    """


class CompilingInterrupted(KeyboardInterrupt):
    """An interrupt while a kernel is compiled: there is nothing yet that could be returned."""


class NotDifferentiableError(RetraxError, ValueError):
    """JAX cannot differentiate a user's function: costates and Newton's method need its derivatives, forward and
    backward.

    >>> issubclass(NotDifferentiableError, ValueError)
    True
    """
