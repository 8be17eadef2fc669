"""Threads that XLA has, and that wait for one another where there are too few."""

import os
import subprocess
import sys

import pytest

TWO_AT_ONCE = """
import retrax
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
print(__import__("os").environ.get("PJRT_NPROC"))
"""


@pytest.mark.parametrize("asked", [None, "16"])
@pytest.mark.slow
def test_decompositions_of_a_batch_do_not_wait_for_ever(asked):
    environment = {name: value for name, value in os.environ.items() if name != "PJRT_NPROC"}
    environment |= {} if asked is None else {"PJRT_NPROC": asked}
    ran = subprocess.run(
        [sys.executable, "-c", TWO_AT_ONCE], env=environment, capture_output=True, text=True, timeout=300
    )
    assert ran.returncode == 0, ran.stderr
    expected = "8" if (os.cpu_count() or 1) < 8 else None
    assert ran.stdout.split()[-1] == str(asked or expected)
