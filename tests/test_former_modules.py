"""Former modules of public classes work with a ``DeprecationWarning``: imports, and pickles of records."""

import importlib
import pickle
import pickletools
import sys

import pytest
import retrax as rx
from retrax.former_names import MODULES

PACKAGES = {name for name, present in MODULES.items() if present.startswith(f"{name}.")}


@pytest.mark.parametrize("name", sorted(MODULES))
def test_a_former_module_has_the_classes_of_the_present_one(name):
    present = importlib.import_module(MODULES[name])
    own = [a for a, value in vars(present).items() if getattr(value, "__module__", None) == present.__name__]
    assert own
    if name not in PACKAGES:
        sys.modules.pop(name, None)
    with pytest.warns(DeprecationWarning, match=f"{name}.* is deprecated; use {present.__name__}"):
        assert own == [a for a in own if getattr(importlib.import_module(name), a) is getattr(present, a)]


def test_pickles_that_name_a_former_module_are_read():
    value = rx.Free(2.0, 1.0, 3.0)
    module = type(value).__module__
    former = next(name for name, present in MODULES.items() if present == module)
    data = pickle.dumps(value, protocol=0)
    assert module in [argument.split()[0] for _, argument, _ in pickletools.genops(data) if isinstance(argument, str)]
    sys.modules.pop(former, None)
    with pytest.warns(DeprecationWarning, match=f"{former} is deprecated"):
        found = pickle.loads(data.replace(module.encode(), former.encode()))
    assert isinstance(found, rx.Free)
    assert (found.guess, found.lower, found.upper) == (2.0, 1.0, 3.0)


def test_a_module_that_never_was_is_missing():
    with pytest.raises(ModuleNotFoundError, match="nothing"):
        importlib.import_module("retrax.integrators.nothing")
