"""Settings of the peers' tests on our classes: double precision, seeds, and what is expected to fail."""

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from geomstats.test.conf import pytest_collection_modifyitems, pytest_make_parametrize_id  # noqa: E402, F401


@pytest.fixture(autouse=True)
def seed():
    """The seed of pymanopt's own conftest, whose tests draw from NumPy's global state."""
    np.random.seed(42)  # noqa: NPY002
