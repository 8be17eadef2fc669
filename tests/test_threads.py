"""Threads of XLA, whose number the user sets: decompositions of a batch wait for one another if there are too few."""

import os
import subprocess
import sys

import pytest

TWO_AT_ONCE = """
import jax, jax.numpy as jnp
from retrax.manifolds import SO, U
from retrax.retractions import Exponential

jax.config.update("jax_enable_x64", True)
groups = SO(6), U(4), SO(5), U(3)
keys = [jax.random.split(jax.random.key(k), 2000) for k in (0, 1)]
starts, ends = ([jax.vmap(group.random_point)(some) for group in groups] for some in keys)
all_at_once = jax.jit(lambda x, y: [jax.vmap(Exponential(group).inverse)(a, b) for group, a, b in zip(groups, x, y)])
for _ in range(5):
    jax.block_until_ready(all_at_once(starts, ends))
"""
UNCHANGED = """
import os, jax
before = dict(os.environ)
import retrax, retrax.integrators, retrax.plotting, retrax.problems, retrax.sweeps
assert dict(os.environ) == before, set(os.environ.items()) ^ set(before.items())
"""


def run(source, **environment):
    ran = subprocess.run(
        [sys.executable, "-c", source], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert ran.returncode == 0, ran.stderr


def test_an_import_sets_no_environment_variable():
    run(UNCHANGED, **{name: value for name, value in os.environ.items() if name != "PJRT_NPROC"})


@pytest.mark.parametrize("asked", ["8", "16"])
@pytest.mark.slow
def test_decompositions_of_a_batch_do_not_wait_for_ever_with_the_threads_of_the_page_on_limits(asked):
    run(TWO_AT_ONCE, **os.environ | {"PJRT_NPROC": asked})
