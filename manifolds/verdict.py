"""Answers with their reasons."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Verdict:
    """The answer to a membership question: true or false, with the reason in words.

    Attributes
    ----------
    holds : bool
        Whether the largest violation is ``<= tolerance``; ``bool(verdict)``.
    reason : str
        The reason.

    Examples
    --------
    >>> verdict = Sphere(2).contains(jnp.array([1.0, 0.0, 0.0]))
    >>> bool(verdict), verdict.reason
    (True, 'a point of the manifold to 1e-08')
    """

    holds: bool
    reason: str

    def __bool__(self) -> bool:
        return self.holds
