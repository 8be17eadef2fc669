"""Integration in pieces: the numbers of one loop, whatever the pieces; compiled once; interrupted with what was
reached."""

import logging
import signal
import subprocess
import sys
import time
from itertools import product
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    Composition,
    DiracIntegrator,
    DiracSystem,
    OptimalControlProblem,
    PresymplecticIntegrator,
    Result,
    SymplecticIntegrator,
    Trajectory,
    integrate,
    integrate_many,
)
from retrax.integrators.initial_value import interruptible_loop
from retrax.integrators.initial_value.tape_steps import TapeSteps
from retrax.integrators.initial_value.xla_steps import XlaSteps
from retrax.manifolds import Euclidean
from retrax.retractions import CotangentLift, Exponential, Midpoint

from tests.support.numerics import norm

PLANE = Euclidean(2)
LIFT = CotangentLift(Midpoint(Exponential(PLANE)))
MIDPOINT = SymplecticIntegrator(LIFT)
START = np.array([1.0, 0.0]), np.array([0.0, 0.6])
STEPS, NODES = 24, 3


def quartic(q, p):
    """A nonlinear oscillator."""
    return p @ p / 2 + (q @ q) ** 2 / 4 + q[0] ** 2


def shear(q):
    """The one-form ``y dx + dy``."""
    return jnp.array([[q[1], 1.0]])


CONTROLLED = OptimalControlProblem(
    PLANE, lambda q, u: jnp.array([q[1], u[0] - q[0] ** 3]), lambda q, u: u @ u / 2 + q @ q, 1
)
CONSTRAINED = DiracSystem(PLANE, quartic, shear)
SYSTEMS = {
    "Hamiltonian": (quartic, MIDPOINT, START),
    "composition of controls": (CONTROLLED, Composition(PresymplecticIntegrator(LIFT)), START),
    "constraints": (CONSTRAINED, DiracIntegrator(LIFT), (START[0], np.zeros(2))),
}


@pytest.fixture
def taken(monkeypatch):
    """The numbers of steps of the pieces, which keep three nodes at most."""
    taken = []

    def counted(piece):
        def counting(steps, done, count, *rest):
            taken.append(count)
            return piece(steps, done, count, *rest)

        return counting

    for kind in (TapeSteps, XlaSteps):
        monkeypatch.setattr(kind, "piece", counted(kind.piece))
    monkeypatch.setattr(interruptible_loop, "PIECE_NODES", NODES)
    return taken


def thinned(path: Trajectory, every: int) -> Trajectory:
    """What ``save_every`` keeps of a trajectory."""
    nodes = jax.tree.map(lambda a: a[::every], (path.times, path.q, path.p))
    controls, stage_times = jax.tree.map(lambda a: a[every - 1 :: every], (path.controls, path.stage_times))
    return Trajectory(*nodes, controls, stage_times, path.result, path.failed_step)


def require_same(path: Trajectory, other: Trajectory) -> None:
    """Equal to rounding."""
    assert jax.tree.structure(path) == jax.tree.structure(other)
    for mine, theirs in zip(jax.tree.leaves(path), jax.tree.leaves(other), strict=True):
        assert mine.shape == theirs.shape
        assert mine.dtype == theirs.dtype
        assert norm(mine - theirs) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_pieces_are_the_one_loop_that_is_traced(name, taken, monkeypatch):
    """Through pieces that end within blocks of ``save_every`` steps, at their ends, and where no more can be kept."""
    system, method, start = SYSTEMS[name]
    whole = jax.jit(lambda: integrate(system, method, start, 0.1, STEPS))()
    for every, first, growth in product((1, 2, 3, 8, STEPS), (1, 5, 8, STEPS), (0, 2)):
        taken.clear()
        monkeypatch.setattr(interruptible_loop, "FIRST_PIECE", first)
        monkeypatch.setattr(interruptible_loop, "PIECE_SECONDS", 100.0)
        monkeypatch.setattr(interruptible_loop, "MOST_GROWTH", growth)
        require_same(integrate(system, method, start, 0.1, STEPS, save_every=every), thinned(whole, every))
        assert sum(taken) == STEPS
        assert taken[0] == min(first, NODES * every, STEPS)
        assert max(taken) <= NODES * every


class BelowHeight(eqx.Module):
    """A particle's energy, which is a number only below a height."""

    height: jax.Array

    def __call__(self, q, p):
        return p @ p / 2 + q[0] + jnp.sqrt(self.height - q[1])


@pytest.mark.slow
def test_a_step_that_fails_in_any_piece_ends_the_trajectory_there(taken, monkeypatch):
    """The height is swept, so that the step that fails goes through all ends of blocks and of pieces."""
    heights = jnp.append(jnp.linspace(0.02, 2.6, 32), 9.0)

    def run(height, every=1) -> Trajectory:
        return integrate(
            BelowHeight(height), MIDPOINT, (np.zeros(2), np.array([0.0, 1.0])), 0.1, STEPS, every, throw=False
        )

    whole = jax.jit(jax.vmap(run))(heights)
    failed = set()
    for (i, height), every in product(enumerate(heights), (1, 4)):
        monkeypatch.setattr(interruptible_loop, "FIRST_PIECE", 1 + i % 7)
        path = run(height, every)
        require_same(path, thinned(jax.tree.map(lambda a, i=i: a[i], whole), every))
        failed.add(int(path.failed_step))
    assert failed >= set(range(-1, 19))


@pytest.fixture
def compilations():
    """What XLA compiles, as it happens."""
    names = []

    def listen(name: str, *_: float, **__: str) -> None:
        if "backend_compile" in name:
            names.append(name)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.parametrize(
    "name", ["Hamiltonian", *(pytest.param(name, marks=pytest.mark.slow) for name in list(SYSTEMS)[1:])]
)
def test_another_number_of_steps_compiles_nothing(name, compilations):
    system, method, start = SYSTEMS[name]
    integrate(system, method, start, 0.1, 3)
    compilations.clear()
    for steps in (1, 2, 7, 8, 9, 63, 64, 65, 1000):
        for every in {1, steps}:
            integrate(system, method, start, 0.01, steps, save_every=every)
    assert not compilations
    jax.jit(lambda x: x + 1)(0.0)  # the listener hears what is compiled
    assert compilations


@pytest.mark.parametrize("piece", range(5))
@pytest.mark.usual(1)
def test_an_interruption_has_the_trajectory_until_then(piece, taken, monkeypatch):
    """Ctrl-C in each of the pieces."""
    whole, go_on = integrate(quartic, MIDPOINT, START, 0.1, STEPS, save_every=2), TapeSteps.piece
    taken.clear()

    def interrupted(steps, *arguments):
        value = go_on(steps, *arguments)
        if len(taken) > piece:
            raise KeyboardInterrupt
        return value

    monkeypatch.setattr(TapeSteps, "piece", interrupted)
    monkeypatch.setattr(interruptible_loop, "FIRST_PIECE", 3)
    with pytest.raises(KeyboardInterrupt) as stopped:
        integrate(quartic, MIDPOINT, START, 0.1, STEPS, save_every=2, throw=piece % 2 == 0)
    path, blocks = stopped.value.args[0], sum(taken[:-1]) // 2
    assert path.result == Result.interrupted
    assert path.failed_step == -1
    nodes, stages = jax.tree.map(lambda a: a[: blocks + 1], (whole.times, whole.q, whole.p)), whole.stage_times[:blocks]
    require_same(path, Trajectory(*nodes, None, stages, path.result, path.failed_step))


# What runs in the background of a script ignores interrupts, and so do its children unless they say otherwise.
WAITING = """
import signal
import time
import jax
signal.signal(signal.SIGINT, signal.default_int_handler)
jax.config.update("jax_enable_x64", True)
from tests.integrators.test_pieces import MIDPOINT, START, integrate, quartic
integrate(quartic, MIDPOINT, START, 0.1, 1)
print("ready", flush=True)
try:
    integrate(quartic, MIDPOINT, START, 1e-3, 10**12, save_every=10**9)
except KeyboardInterrupt as stopped:
    print(stopped.args[0].times, time.monotonic())
    raise
"""


def test_ctrl_c_ends_a_long_run():
    """A real signal, within one block of 10^9 steps: the process ends as after any Ctrl-C."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": Path(__file__).parents[2]}
    with subprocess.Popen([sys.executable, "-c", WAITING], **options) as process:
        assert process.stdout.readline() == "ready\n"
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.5)
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=60)
    assert out.startswith("[0.]")
    assert "KeyboardInterrupt: Trajectory(" in error
    assert process.returncode == -signal.SIGINT
    assert float(out.split()[-1]) - began < 3.0  # seconds: a fraction of one where nothing else runs


@pytest.mark.parametrize("steps", [1, 8, 9, 4000])
@pytest.mark.parametrize("verbose", [False, True])
@pytest.mark.usual(2)
def test_the_progress_of_an_integration_is_shown_where_it_is_asked_for(steps, verbose, caplog):
    with caplog.at_level(logging.INFO, "retrax"):
        path = integrate(quartic, MIDPOINT, START, 1e-3, steps, verbose=verbose)
        integrate_many(quartic, MIDPOINT, [part[None] for part in START], 1e-3, steps, verbose=verbose)
    assert path.result == Result.successful
    lines = [record.getMessage().partition(",")[0] for record in caplog.records]
    assert lines == [f"integrate: {steps} of {steps} steps"] * 2 * verbose
