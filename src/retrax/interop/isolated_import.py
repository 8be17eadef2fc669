"""Importing pymanopt and geomstats without what they do to the settings of the whole process.

Found in pymanopt 2.2.1: it turns on JAX's double precision. Found in geomstats 2.8.0: it sets the level and a handler
of the root logger, adds a finder to ``sys.meta_path`` whose use warns, and its dependencies change warning filters and
environment variables. Everything is as before when the import is done; a library that the user has imported already is
left alone.
"""

import importlib
import logging
import os
import random
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import jax
import numpy as np


def import_peer(name: str) -> ModuleType:
    """The module ``name`` of pymanopt or geomstats, or one of ours that imports them, with all global settings kept."""
    with keep_settings():
        return importlib.import_module(name, __package__)


@contextmanager
def keep_settings() -> Iterator[None]:
    """Put the global settings of Python, NumPy and JAX back to what they were."""
    before, finders, environment = dict(jax.config.values), list(sys.meta_path), dict(os.environ)
    level, handlers = logging.root.level, list(logging.root.handlers)
    drawn, drawn_by_numpy, errors = random.getstate(), np.random.get_state(), np.geterr()  # noqa: NPY002
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        _restore_jax(before)
        sys.meta_path[:] = finders
        for key in set(os.environ) - set(environment):
            del os.environ[key]
        os.environ.update(environment)
        logging.root.setLevel(level)
        logging.root.handlers[:] = handlers
        random.setstate(drawn)
        np.random.set_state(drawn_by_numpy)  # noqa: NPY002
        np.seterr(**errors)


@contextmanager
def seed_numpy(seed: int) -> Iterator[None]:
    """NumPy's global random state set to a seed, and put back afterwards: both libraries draw from it."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def _restore_jax(before: dict[str, Any]) -> None:
    for key, value in before.items():
        if jax.config.values[key] != value:
            jax.config.update(key, value)
