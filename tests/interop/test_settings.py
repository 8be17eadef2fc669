"""Nothing is imported before a door is opened, and opening it changes no setting of the process."""

import subprocess
import sys

import pytest

SETTINGS = """
import logging, os, random, sys, warnings
import jax, matplotlib as mpl, numpy as np
def settings():
    return {
        "jax": dict(jax.config.values), "environment": dict(os.environ), "warnings": list(warnings.filters),
        "finders": list(sys.meta_path), "root logger": (logging.root.level, list(logging.root.handlers)),
        "numpy errors": np.geterr(), "numpy print": np.get_printoptions(), "numpy random": repr(np.random.get_state()),
        "random": random.getstate(), "matplotlib": dict(mpl.rcParams), "hooks": (sys.excepthook, sys.displayhook),
        "path": list(sys.path), "recursion": sys.getrecursionlimit(), "showwarning": warnings.showwarning,
    }
"""


CODE = """
import retrax.interop as doors
from retrax.manifolds import SO, InvalidInputError
assert not {"pymanopt", "geomstats", "sklearn"} & set(sys.modules)
before = settings()

def unchanged(what):
    after = settings()
    assert before == after, (what, [key for key in before if before[key] != after[key]])

for name in NAMES:
    library = name.split("_")[1]
    assert library not in sys.modules
    try:
        getattr(doors, name)(SO(3))  # of the wrong kind for the doors from a library
        assert name.startswith("to")
    except InvalidInputError:
        assert name.startswith("from")
    assert library in sys.modules
    unchanged(name)
for library in ("pymanopt", "geomstats"):
    to, back = getattr(doors, f"to_{library}"), getattr(doors, f"from_{library}")
    assert back(to(SO(3))).manifold == SO(3)
    unchanged(library)
"""


@pytest.mark.long("from_geomstats to_pymanopt")
@pytest.mark.parametrize("names", [("from_pymanopt", "to_geomstats"), ("from_geomstats", "to_pymanopt")], ids=" ".join)
def test_a_door_imports_its_library_when_opened_and_changes_no_setting(names):
    command = [sys.executable, "-W", "error", "-c", f"NAMES = {names}" + SETTINGS + CODE]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
