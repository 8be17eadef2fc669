"""Whether a problem is regular or singular with the parameters of a call, found out once for each of them."""

from typing import Any, final

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ..problem import OptimalControlProblem, resting_control
from ..singular import Classification, classify
from .arguments import structure_of
from .end_points import NodeCondition
from .members import Member


@final
class Regularity:
    """The classification of a problem with the parameters that it was last asked for."""

    def __init__(self, refusal: str = "") -> None:
        """``refusal``: words for a singular problem, where that is not to be solved."""
        self.refusal = refusal
        self._classes: dict[Any, tuple[Any, Classification | None]] = {}  # with the parameters that it belongs to

    def classification(
        self, problem: OptimalControlProblem, conditions: tuple[NodeCondition, NodeCondition], member: Member
    ) -> Classification | None:
        """The classification of a singular problem, None of a regular one; raises for functions that cannot be solved with."""
        first, last = conditions
        values = tuple(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(member.parameters))
        key = structure_of(member.parameters), last.parts
        if key not in self._classes or self._classes[key][0] != values:
            known = first.point if member.guess is None else jax.tree.map(lambda leaf: np.asarray(leaf[0]), member.guess.states)
            regular = problem.check(known, resting_control(problem.controls))
            # Where there are inequalities the barrier determines the controls that the Hamiltonian leaves open.
            regular = regular or problem.limits.along
            if not regular and self.refusal:
                raise InvalidInputError(self.refusal)
            problem.require_cost(known, last.point, last.fixed_leaves)
            excluded = None if problem.abnormal or problem.is_steep_at(last.fixed_leaves) else False
            self._classes[key] = values, None if regular else classify(problem, exclude_zero_costate=excluded)
        return self._classes[key][1]

    def was_regular(self, conditions: tuple[NodeCondition, NodeCondition], member: Member) -> bool:
        """Whether the problem was regular with the parameters before: then a solution can show that it is with these."""
        key = structure_of(member.parameters), conditions[1].parts
        return key in self._classes and self._classes[key][1] is None
