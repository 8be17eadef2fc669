"""Notices of JAX about hardware reach no user of retrax; its other lines do."""

import subprocess
import sys

import pytest

NOTICED = """
{load}
import logging
from jax._src import hardware_utils, xla_bridge
hardware_utils.has_visible_nvidia_gpu = lambda: True
import jax
jax.numpy.zeros(1)
logging.getLogger(xla_bridge.__name__).warning("CUDA backend failed to initialize")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="JAX looks for hardware on Linux alone")
@pytest.mark.parametrize(("load", "notices"), [("import retrax", 0), ("", 1)])
def test_a_gpu_without_its_jaxlib_is_not_noticed(load, notices):
    found = subprocess.run(
        [sys.executable, "-c", NOTICED.format(load=load)], capture_output=True, text=True, check=True
    )
    assert found.stderr.count("An NVIDIA GPU may be present") == notices
    assert found.stderr.count("CUDA backend failed to initialize") == 1
