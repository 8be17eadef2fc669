"""Errors below tape and layers."""

TRACEABLE = "try functions written in jax.numpy: jnp.sin in place of np.sin, jnp.where in place of if"


class RetraxError(Exception):
    """Base of every error that this library raises.

    >>> issubclass(InvalidInputError, RetraxError), issubclass(ConvergenceError, RetraxError)
    (True, True)
    """


class InvalidInputError(RetraxError, ValueError):
    """An argument has the wrong value, shape or structure.

    >>> Stiefel(2, 3)
    Traceback (most recent call last):
        ...
    retrax.errors.InvalidInputError: ...
    """


class CompilingInterrupted(KeyboardInterrupt):
    """An interrupt while a kernel is compiled: there is nothing yet that could be returned."""


class NotDifferentiableError(RetraxError, ValueError):
    """JAX cannot differentiate a user's function: costates and Newton's method need its derivatives, forward and
    backward.

    >>> issubclass(NotDifferentiableError, ValueError)
    True
    """
