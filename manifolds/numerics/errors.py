"""Errors raised for a user's mistake: what came, what was expected, what to try."""


class RetraxError(Exception):
    """Base of every error that this library raises."""


class InvalidInputError(RetraxError, ValueError):
    """An argument has the wrong value, shape or structure."""


class NotOnManifoldError(InvalidInputError):
    """A point is off its manifold, or a vector is not tangent."""


class UnknownRetractionError(RetraxError, TypeError):
    """No retraction of the requested name is known on a manifold."""


class DomainError(InvalidInputError):
    """A point lies outside the image of a retraction or of a discretization map."""


class ConvergenceError(RetraxError, RuntimeError):
    """An iteration ended without meeting the conditions that its result claims."""
