"""Former public names and fields work with a ``DeprecationWarning``."""

import pytest
from retrax import integrators, retractions


@pytest.mark.parametrize("module", [integrators, retractions])
def test_former_names_are_the_present_objects(module):
    for former, present in module.FORMER.items():
        assert former not in dir(module)
        with pytest.warns(DeprecationWarning, match=rf"{former} is deprecated; use {present}") as caught:
            assert getattr(module, former) is getattr(module, present)
        assert caught[0].filename == __file__


@pytest.mark.parametrize("module", [integrators, retractions])
def test_names_that_never_were_are_missing(module):
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing
