"""What tests of compiled passes look at."""

from typing import Any

import pytest
from retrax.integrators.boundary_value.engine.trial import Trial


@pytest.fixture
def pursuits(monkeypatch) -> list[Any]:
    """Those that are run from now on; None where a search does not set out."""
    made, pursue, set_out = list[Any](), Trial.pursue, Trial.set_out

    def heard(self: Trial, *given: Any) -> Any:
        made.append(pursue(self, *given))
        return made[-1]

    def begun(self: Trial, *given: Any) -> Any:
        found = set_out(self, *given)
        made.append(found and found.pursuit)
        return found

    monkeypatch.setattr(Trial, "pursue", heard)
    monkeypatch.setattr(Trial, "set_out", begun)
    return made
