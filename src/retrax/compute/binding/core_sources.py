"""The C sources of the compiled core, which the package carries for programs that are exported."""

from importlib.util import find_spec
from pathlib import Path

from .library import MissingCoreError


def core_sources() -> list[Path]:
    """The files of the core, and its license: in the package, or in the source tree that it is imported from."""
    spec = find_spec("retrax._core")
    package = Path("." if spec is None or spec.origin is None else spec.origin).parent
    own, tree = package / "core_source", package.parent / "core"
    found = sorted(own.iterdir()) if own.is_dir() else sorted([*tree.glob("*.[ch]"), package.parents[1] / "LICENSE"])
    if not any(path.name == "retrax_core.h" for path in found):
        raise MissingCoreError(
            f"the C sources of the core are not installed: expected them in {own}; try: "
            "pip install --force-reinstall --no-deps retrax"
        )
    return found
