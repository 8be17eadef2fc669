"""Newton's method on the KKT system, made global: nothing is taken that does not improve, and every step descends.

A trial is accepted inside a funnel, a bound on the infeasibility that only narrows [Kiessling, Leyffer, Vanaret 2025]:
where the step promises less cost by more than a share of the squared infeasibility, if the cost decreases as Armijo
asks, but for rounding; else if it comes well into the funnel. The cost is that of the Lagrangian with the multipliers
of the trial: the bare cost refuses good steps along curved constraints [Ulbrich 2004]. But these multipliers are others
each time, and from far off nearly all steps lower it, round and round: so they narrow the funnel too, a little.
Accepted too is what brings the KKT residual below nine tenths of the best so far while nothing alone lacks more than
the funnel. Indefinite reduced Hessians: the diagonal is raised until the inertia is that of a minimum, else the way to
one leads past saddles, and further after steps that had to be cut, so that the next is as long as what was taken. Where
constraints depend on each other no inertia is: from some shift on positive curvature along the step is enough [Chiang,
Zavala 2016].
"""

from collections.abc import Callable
from typing import Any, final

import numpy as np

from ....manifolds.numerics.ambient import joined, taken
from ....manifolds.numerics.tolerances import EPS
from ..transcription.iterate import Iterate, Slacks
from ..transcription.iteration import Iteration, stops
from .acceptance import SHORTEST, WIDE, Funnel, Judgement, State
from .aside import aside, is_lost, violates
from .batches import merged
from .conditions import Conditions
from .extent import ends_meet
from .falling import Fall
from .first_multipliers import has_flat_controls, with_first_multipliers
from .found import Found
from .kkt_system import Assembled, Residuals, Step
from .own_units import renewed
from .pursuit import EXACT, JAMMED, SHRINKS, STIFF, pursued, set_out
from .regularising import regularised, solvable
from .widening import rewritten

ROUND = 40  # trials, after which units are measured again
SHORTER = 0.5  # what a shift has to shorten a step to
GROWN = 1e6  # times what its data ask for: then a trajectory near a singular system follows its null vector
GAINED = 0.1  # times the residual: a step that leads to less is Newton's own, near what it leads to, be that a saddle
SLOW = 1e-6  # a share of a step that is cut no further
SETTLING = 5  # trials beyond the limit


@final
class Descent:
    """The members on their way, and those that have left."""

    def __init__(
        self,
        conditions: Conditions,
        tolerance: float,
        max_iterations: int,
        callback: Callable[[Iteration], Any] | None,
        as_it_is: bool = False,
        width: float = WIDE,
        firm: float = 1.0,
    ) -> None:
        self.conditions, self.tolerance = conditions, tolerance
        self.max_iterations, self.callback = max_iterations, callback
        self.funnel, self.firm = Funnel(tolerance, width), firm
        self.as_it_is, self.lost = as_it_is, np.zeros(0, bool)  # which guesses are moved aside
        self.state: State | None = None
        self._own: tuple[np.ndarray, Conditions] | None = None
        self.left: list[tuple[State, int]] = []
        self.fall, self.unit = Fall(), np.ones(0)
        self.trials = 0
        self.stopped = False

    def ended(self, guess: Iterate) -> Found:
        """The result of the search from a guess, which an interrupt ends."""
        try:
            self.run(guess)
        except KeyboardInterrupt:
            self.stopped = True
            if self.state is None:  # what the first pass has found takes milliseconds to find again
                self.state = self.first_state(guess)
        return self.found()

    def failed(self, found: Found) -> np.ndarray:
        """Which members have ended without success from guesses that nothing moved aside."""
        return ~(found.claimed | found.contradictory | self.lost | self.stopped | self.conditions.joint)

    def moved_aside(self) -> tuple[Iterate, np.ndarray]:
        """The guesses moved aside; and which members are worth a search from there, shape (B,)."""
        first = self.first()
        moved, held = aside(self.conditions, *first)
        return moved, held | violates(first[0].slacks, held)

    def run(self, guess: Iterate) -> None:
        """Iterate until all members have left, or are stopped."""
        state = self.first_state(guess)
        while True:
            self.state = state
            self.fall.note(self.trials, state.member, state.assembled.cost)
            finished, after_round = self.finished(state), self.trials % ROUND == 0
            if finished.any() or after_round:
                state = renewed(self, state, finished, after_round)
                self.state, self._own = state, None
                finished = self.finished(state)
            self.report(state, state.descends)
            state = self.leave(state, finished)
            if state is None or self.stopped:
                return
            state = self.pursued(state) or self.next(state)

    def first_state(self, guess: Iterate) -> State:
        """The state that the search begins with, in whose unit of the cost a fall of the cost is judged."""
        state = self.set_out(guess)
        self.unit = np.array(self.conditions.judging.cost)
        return state

    def set_out(self, guess: Iterate) -> State:
        """The state at the guess, or after whole steps from there."""
        if self.as_it_is or self.callback is not None or self.lost.size:
            return self.begun(guess)
        found = set_out(self.conditions, guess, self.max_iterations, self.tolerance)
        if found is None:
            return self.begun(guess)
        state, trials, costs, known = found
        if state is None:
            return self.begun(guess, known()[:2])
        self.fall.note_all(1, state.member, costs)
        self.first, self.lost, self.trials = lambda: known()[:2], np.zeros(1, bool), trials + 1
        return self.settled_after(state, self.conditions)

    def pursued(self, state: State) -> State | None:
        """The state after whole steps that are taken; None where the next is not one of these."""
        if len(state.member) > 1 or self.trials > self.max_iterations:
            return None
        most = 1 if self.callback else min(self.max_iterations + 1 - self.trials, ROUND - self.trials % ROUND)
        conditions = self.own(state)
        found = pursued(conditions, state, self.trials == 1, most, self.tolerance)
        if found is None:
            return None
        state, trials, costs = found
        self.fall.note_all(self.trials + 1, state.member, costs)
        self.trials += trials
        return self.settled_after(state, conditions)

    def standing(
        self,
        conditions: Conditions,
        member: np.ndarray,
        at: tuple[Iterate, Assembled],
        step: Step,
        shift: np.ndarray,
        descends: np.ndarray,
    ) -> State:
        """The state at an iterate with its system, with a step that is not tried yet."""
        residuals, merit, count = conditions.residuals(*at), self.funnel.value(conditions, *at), len(member)
        promise = descends, *self.funnel.slope(conditions, *at, step), merit
        one, far, no = np.ones(count), np.full(count, np.inf), np.zeros(count, bool)
        numbers = self.funnel.width(merit), one, shift, residuals.largest, far, no, no, no
        state = State(member, *at, residuals, step, *promise, *numbers)
        return self.settled(state, residuals.final <= self.tolerance, conditions)

    def own(self, state: State) -> Conditions:
        """The conditions of the members on their way, the same ones as long as these are the same."""
        if self._own is None or self._own[0] is not state.member:
            self._own = state.member, self.conditions.of(state.member)
        return self._own[1]

    def settled_after(self, state: State, conditions: Conditions) -> State:
        """The state after whole steps, settled where that was not done on the way."""
        if state.done[0] or state.isolated[0]:
            return state
        return self.settled(state, state.residuals.final <= self.tolerance, conditions)

    def begun(self, given: Iterate, known: tuple[Iterate, Assembled] | None = None) -> State:
        """The state at the guess, with a first step; ``known``: the guess with its system, whose units are taken."""
        conditions = self.conditions
        guess, assembled = bare = known or conditions.begin(given, self.firm)
        count = len(assembled.cost)
        zero = np.zeros(count)
        # The first step is Newton's own: where it gains two digits, the problem is nearly linear and has one extremal.
        linear = np.full(count, guess.slacks is None)
        step, shift, descends = regularised(conditions, guess, assembled, zero, linear, linear)
        # With inequalities the inertia has told already.
        flat = ~descends | (shift > 0) | (linear & ~step.strict & has_flat_controls(assembled))
        guess = with_first_multipliers(conditions, guess, assembled, flat)
        if guess is not bare[0]:
            assembled = conditions.assemble(guess)
            step, shift, descends = regularised(conditions, guess, assembled, zero, linear, linear)
        self.first = lambda: (guess, conditions.assemble(guess))  # again where it is wanted: a system takes most memory
        if not self.lost.size:
            looked = not (conditions.joint or self.as_it_is)
            self.lost = is_lost(conditions, guess, assembled, step) if looked else np.zeros(count, bool)
            if self.lost.any():
                moved, _ = aside(conditions, *bare)
                if given.slacks is not None:
                    moved = moved._replace(slacks=Slacks.none(given.slacks.slacks.shape))
                return self.begun(merged(self.lost, moved, given))
        self.trials = 1
        return self.standing(conditions, np.arange(count), (guess, assembled), step, shift, descends)

    def next(self, state: State) -> State:
        """Assemble the trial, judge it, and compute the next step."""
        conditions = self.own(state)
        trial, assembled = conditions.tried(state.iterate, state.assembled, state.step, state.fraction)
        found = conditions.residuals(trial, assembled)
        before = state
        state, good, again = self.judged(conditions, before, trial, assembled, found)
        if trial.slacks is not None and not good.all():
            met = self.met(conditions, good, (trial, assembled, found))
            state, good, again = self.judged(conditions, before, *met) if met else (state, good, again)
        # What rounding refuses beside a solution tells nothing about units.
        refused = again & ~good & ~before.isolated
        state, wider = rewritten(self.funnel, (self.conditions, conditions), before, state, assembled, refused)
        self.trials += 1
        state, lowered = self.lowered(conditions, state)
        again |= lowered
        residual = state.residuals.largest
        arrived = state.residuals.final <= self.tolerance
        # What Newton's last step leads to is looked at, and not stepped from once more.
        reached = before.isolated & good & arrived
        if not (again & ~reached).any():
            return state._replace(done=reached)
        # This near to a solution, and while its steps are taken, Newton's method leads to it, be it a minimum or a
        # saddle; where they gain a digit it does if they have positive curvature.
        keep = arrived | (good & (residual <= np.sqrt(self.tolerance)))
        gains = good & (residual <= GAINED * before.residuals.largest) & (trial.slacks is None)
        shift = np.where(arrived, 0.0, state.shift)
        step, shift, descends = regularised(conditions, state.iterate, state.assembled, shift, keep, gains)
        # No shift shortens what the constraints ask for: there the same step is cut further.
        vain = again & ~(good | lowered | wider) & before.descends & (before.fraction > SLOW)
        vain &= before.fraction / 2 < SHORTEST
        if vain.any():
            vain &= conditions.length(step) > SHORTER * conditions.length(state.step)
        if vain.any():
            least = conditions.least_step(state.iterate, state.assembled)
            vain &= conditions.length(least) > SHORTER * conditions.length(state.step)
        if vain.any():
            step, shift, descends = merged(vain, (before.step, before.shift, before.descends), (step, shift, descends))
            state = state._replace(fraction=np.where(vain, before.fraction / 2, state.fraction))
        promise, turned = self.funnel.slope(conditions, state.iterate, state.assembled, step)
        state = state._replace(step=step, shift=shift, descends=descends, promised=promise, turned=turned)
        return self.settled(state, arrived, conditions)

    def met(
        self, conditions: Conditions, good: np.ndarray, tried: tuple[Iterate, Assembled, Residuals]
    ) -> tuple[Iterate, Assembled, Residuals] | None:
        """The trials, those that are not good with slacks that meet their inequalities; None if they do.

        Slacks went by the slopes of the inequalities: with those of their values the step may be a good one.
        """
        iterate, assembled, _ = tried
        other = conditions.met(iterate, assembled)
        if other is iterate:
            return None
        system = conditions.assemble(other)
        return merged(good, tried, (other, system, conditions.residuals(other, system)))

    def lowered(self, conditions: Conditions, state: State) -> tuple[State, np.ndarray]:
        """The state with a lower barrier where its problem is solved, with elastic inequalities where their steps are
        short.

        What was reached counts no more there.
        """
        if state.iterate.slacks is None:
            return state, np.zeros(len(state.shift), bool)
        iterate, changed, cheap = conditions.lowered(state.iterate, state.assembled, state.residuals, self.tolerance)
        stuck = (state.shift >= STIFF) | (state.fraction * state.step.reach <= JAMMED) | ~state.step.finite
        stuck &= state.residuals.largest > np.sqrt(self.tolerance)
        if stuck.any():
            stuck &= conditions.is_hard(iterate, state.assembled)
        if stuck.any():
            # Once more from the guess: multipliers that grew against a bound would hold the trajectory where it jammed.
            first, assembled = taken(self.first(), state.member)
            iterate = merged(stuck, conditions.softened(first, assembled, stuck), iterate)
            state = state._replace(shift=np.where(stuck, 0.0, state.shift))
        if (stuck | cheap).any():
            state = state._replace(assembled=conditions.assemble(iterate))
        changed = changed | stuck | cheap
        if not changed.any():
            return state, changed
        residuals = conditions.residuals(iterate, state.assembled)
        merit = self.funnel.value(conditions, iterate, state.assembled)
        state = state._replace(
            iterate=iterate,
            residuals=residuals,
            merit=merit,
            funnel=np.where(changed, self.funnel.width(merit), state.funnel),
            best=np.where(changed, residuals.largest, state.best),
            fraction=np.where(changed, 1.0, state.fraction),
        )
        return state, changed

    def judged(
        self, conditions: Conditions, state: State, trial: Iterate, assembled: Assembled, found: Residuals
    ) -> tuple[State, np.ndarray, np.ndarray]:
        """The state with the trial where it improves, whether it does, and whether the step has to be computed
        again."""
        merit = self.funnel.value(conditions, trial, assembled)
        reached_now = found.largest, conditions.shortfall(trial, assembled), assembled.cost
        found_now = self.funnel.accepts(state, merit, reached_now, self.trials == 1 and trial.slacks is None)
        new, old = (trial, assembled, found, merit), (state.iterate, state.assembled, state.residuals, state.merit)
        iterate, kept, reached, merit = merged(found_now.good, new, old)
        going_on = dict(zip(Judgement._fields[:4], found_now[:4], strict=True))
        state = state._replace(iterate=iterate, assembled=kept, residuals=reached, merit=merit, **going_on)
        return state, found_now.good, found_now.done_with

    def settled(self, state: State, arrived: np.ndarray, conditions: Conditions | None = None) -> State:
        """The state with what is decided where the residuals meet the tolerance, given the step that is still wanted
        there.

        Newton's steps shrink where the residuals vanish, unless the system is singular to rounding. Then the trajectory
        is one of a family of extremals; or it has grown along the null vector until rounding hides that there is none.
        """
        if not arrived.any():
            return state
        wanted, grown = (conditions or self.conditions).wanted(state.iterate, state.assembled, state.step)
        isolated = arrived & (wanted <= np.sqrt(self.tolerance))
        stuck = arrived & (wanted > SHRINKS * state.correction)
        claimed = isolated | (stuck & (grown <= GROWN))
        wanted = np.where(arrived, wanted, state.correction)
        # The step that is known is made if more than rounding is left: it costs an evaluation and doubles the digits.
        exact = state.isolated | (state.residuals.largest <= EXACT * EPS)
        return state._replace(correction=wanted, isolated=isolated, claimed=claimed, done=(isolated & exact) | stuck)

    def finished(self, state: State) -> np.ndarray:
        """Which members are done, or have no reason to go on."""
        if state.done.all():
            return state.done
        # Where all but the barrier meets the tolerance at the limit, a few steps tell what the iterate is.
        arrived = (state.residuals.steady <= self.tolerance) & (self.trials <= self.max_iterations + SETTLING)
        limited = (self.trials > self.max_iterations) & ~arrived
        finished = state.done | self.hopeless(state) | limited | self.elsewhere(state)
        return finished | self.contradictory(state)

    def hopeless(self, state: State) -> np.ndarray:
        """Whether no step is left, be it from the guess once more with elastic inequalities."""
        stuck = ~solvable(state)
        if stuck.any():
            stuck &= ~self.conditions.of(state.member).is_hard(state.iterate, state.assembled)
        return stuck

    def elsewhere(self, state: State) -> np.ndarray:
        """Whether the equations hold at points of which one is not at its end: from there Newton's method does not
        move.

        Near the end, or where all was met before, the normal part of what is missing is the square of its size: from
        there it moves.
        """
        conditions, residuals = self.conditions.of(state.member), state.residuals
        stays = (residuals.stationarity <= self.tolerance) & (residuals.gap > np.sqrt(self.tolerance))
        stays &= np.isinf(state.correction)
        return stays & conditions.is_met(state.iterate, state.assembled, self.tolerance) if stays.any() else stays

    def contradictory(self, state: State) -> np.ndarray:
        """Whether inequalities contradict each other, or the ends."""
        conditions = self.conditions.of(state.member)
        return conditions.is_infeasible(state.iterate, state.assembled, state.residuals, self.tolerance)

    def report(self, state: State, accepted: np.ndarray) -> None:
        """Show the state to the callback; where that returns something true, of a batch for all members, stop."""
        if self.callback is None:
            return
        residuals, length = state.residuals, state.fraction * state.step.reach
        barrier = self.conditions.of(state.member).barriers(state.iterate)
        violation = np.maximum(residuals.violation, residuals.excess)
        seen = residuals.gap, residuals.stationarity, state.shift, length, accepted, violation, barrier
        self.stopped = stops(self.callback(Iteration(self.trials - 1, state.member, state.assembled.cost, *seen)))

    def leave(self, state: State, finished: np.ndarray) -> State | None:
        """The state without the members that have finished; None without members."""
        if not finished.any():
            return state
        if finished.all():
            self.left.append((state, self.trials))
            self.state = None
            return None
        self.left.append((taken(state, np.flatnonzero(finished)), self.trials))
        self.state = taken(state, np.flatnonzero(~finished))
        return self.state

    def found(self) -> Found:
        """All members in their order."""
        if self.state is not None:
            self.left.append((self.state, self.trials))
        states = [state for state, _ in self.left]
        counts = [np.full(len(state.member), trials) for state, trials in self.left]
        whole, iterations = states[0], counts[0]
        if len(states) > 1:
            order = np.argsort(np.concatenate([state.member for state in states]))
            whole, iterations = taken(joined(states), order), np.concatenate(counts)[order]
        strict = whole.step.strict & (whole.shift == 0)
        if whole.iterate.slacks is not None:
            strict = self.conditions.is_isolated_minimum(whole.iterate, whole.assembled)
        missing, unit = whole.assembled.extent.lacking / self.conditions.judging.nodes, self.conditions.judging.cost
        claimed = whole.claimed & (whole.residuals.final <= self.tolerance)  # it may have gone on from where it was
        if not self.conditions.joint:
            claimed &= ends_meet(whole.assembled, self.conditions.at_nodes.layout.in_arrays, self.tolerance)
        ended = strict & whole.isolated, iterations - 1, iterations > self.max_iterations, claimed, solvable(whole)
        told = self.stopped, missing, self.contradictory(whole), unit, self.fall.lasts(~claimed, self.unit)
        return Found(whole.iterate, whole.assembled, whole.residuals, *ended, *told)
