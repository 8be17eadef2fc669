"""Nothing is imported before a door is opened, and opening it changes no setting of the process."""

import subprocess
import sys

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
import retrax.interop
assert not {"pymanopt", "geomstats", "sklearn"} & set(sys.modules)
from retrax.interop import to_geomstats, to_pymanopt
from retrax.manifolds import SO
before = settings()
for door, peer in ((to_pymanopt, "pymanopt"), (to_geomstats, "geomstats")):
    door(SO(3))
    assert peer in sys.modules
    after = settings()
    assert before == after, [key for key in before if before[key] != after[key]]
"""


def test_a_door_imports_its_library_when_opened_and_changes_no_setting():
    command = [sys.executable, "-W", "error", "-c", SETTINGS + CODE]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
