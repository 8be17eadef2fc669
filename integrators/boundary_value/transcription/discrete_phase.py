"""Phases of a batch of trajectories: functions, prescribed ends, and data."""

from functools import cached_property
from typing import final

import numpy as np

from .functions.collocation import CollocationFunctions
from .functions.linked_ends import LinkageFunctions
from .functions.nodes import NodeFunctions
from .functions.one_stage import OneStageFunctions
from .iterate import Data, Ends, Iterate, LinkedIterate


@final
class DiscretePhase:
    """A phase of a batch of trajectories, which is a whole trajectory where there is one phase.

    ``transcription``: functions of the steps; ``at_nodes``: functions of the nodes.
    """

    def __init__(
        self, transcription: OneStageFunctions | CollocationFunctions, nodes: NodeFunctions, ends: Ends, data: Data
    ) -> None:
        self.transcription, self.at_nodes, self.ends, self.data = transcription, nodes, ends, data

    def of(self, members: np.ndarray) -> "DiscretePhase":
        """The phase of some members."""
        if len(members) == len(self.data.steps):
            return self
        ends = Ends(self.ends.start[members], self.ends.end[members], *self.ends[2:])
        asked = None if self.data.asked is None else self.data.asked[members]
        data = Data(self.data.steps[members], self.data.parameters[members], asked)
        return DiscretePhase(self.transcription, self.at_nodes, ends, data)

    def end_nodes(self, iterate: Iterate) -> tuple[np.ndarray, np.ndarray]:
        """The first and the last node of an iterate."""
        begins, finishes = self.transcription.ends(iterate.unknowns, self.data)
        first = np.where(self.ends.start_entries, self.ends.start, begins[:, 0])
        return first, np.where(self.ends.end_entries, self.ends.end, finishes[:, -1])

    @cached_property
    def fixed(self) -> np.ndarray:
        """1 for the coordinates of nodes that are prescribed or have to meet, 0 for the coordinates of free ends."""
        fixed = np.ones((len(self.data.steps), self.data.steps.shape[1] + 1, len(self.ends.start_coordinates)))
        fixed[:, 0], fixed[:, -1] = self.ends.start_coordinates, self.ends.end_coordinates
        return fixed


@final
class LinkedPhases:
    """The phases of a batch of trajectories, and the functions of their ends, among which are equations.

    A single phase has equations between its own ends, boundary constraints or a periodic end, or none.
    """

    def __init__(self, phases: tuple[DiscretePhase, ...], coupling: LinkageFunctions | None) -> None:
        self.phases, self.coupling = phases, coupling

    @property
    def free(self) -> np.ndarray:
        """The mask of the free coordinates of all ends."""
        masks = ((phase.ends.start_coordinates, phase.ends.end_coordinates) for phase in self.phases)
        return np.concatenate([mask == 0 for pair in masks for mask in pair])

    def guess(self, parts: tuple[Iterate, ...]) -> LinkedIterate:
        """A guess of the phases, with the multipliers that fit their costates at the ends best."""
        coupling, count = self.coupling, len(parts[0].costates)
        if coupling is None:
            return LinkedIterate(parts, np.zeros((count, 0)))
        none = LinkedIterate(parts, np.zeros((count, sum(coupling.sizes))))
        if not any(np.any(part.costates) for part in parts):
            return none
        nodes = [phase.end_nodes(part) for phase, part in zip(self.phases, parts, strict=True)]
        given = [phase.data.parameters for phase in self.phases]
        linked = coupling([end for pair in nodes for end in pair], given, none.multipliers)
        frames, asked = [], []
        for phase, part, ends in zip(self.phases, parts, nodes, strict=True):
            for side, node in zip((1, -1), ends, strict=True):
                covector = part.costates[:, 0 if side > 0 else -1]
                every = np.ones((count, 1, phase.at_nodes.dimension))
                at = phase.at_nodes.in_frames(node[:, None], every, np.zeros_like(node)[:, None], covector[:, None])
                frames.append(at[0][:, 0])
                asked.append(side * at[2][:, 0])
        free, wanted = self.free, np.concatenate(asked, axis=1) - linked.slope
        multipliers = [np.linalg.lstsq(j[:, free].T, a[free])[0] for j, a in zip(linked.jacobian, wanted, strict=True)]
        return none._replace(multipliers=coupling.lift(np.stack(multipliers), frames))
