"""The base of all errors, below tape and layers."""


class RetraxError(Exception):
    """Base of every error that this library raises.

    >>> issubclass(InvalidInputError, RetraxError), issubclass(ConvergenceError, RetraxError)
    (True, True)
    """
