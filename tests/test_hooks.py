"""Functions that a lower floor calls are defined by the files that they name, once the library is imported."""

import sys

import pytest
from retrax.hooks import Hook


def hooks() -> dict[str, Hook]:
    """The hooks of the library, by the module and the name where they are defined."""
    return {
        f"{module}.{name}": value
        for module, found in sorted(sys.modules.items())
        if module.startswith("retrax.")
        for name, value in vars(found).items()
        if isinstance(value, Hook)
    }


def test_every_hook_is_defined_by_the_file_that_it_names():
    assert len(hooks()) >= 6
    for name, hook in hooks().items():
        assert hook.work is not None, name
        module = hook.place.removeprefix("src/retrax/").removesuffix(".py").replace("/", ".")
        assert hook.work.__module__ == f"retrax.{module}", name


def test_a_call_before_the_import_names_the_file():
    with pytest.raises(RuntimeError, match=r"integrators/above\.py, which does this work, is not imported yet"):
        Hook("integrators/above.py")(1)
