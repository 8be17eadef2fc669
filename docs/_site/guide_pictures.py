"""The pictures of the guides, from the code of their pages: python docs/_site/guide_pictures.py [PAGE ...]."""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from picture import save
from retrax import plotting

DOCS = Path(__file__).parents[1]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def obstacles(names: dict[str, Any]) -> Any:
    """The ways around a disc, a cap and the cone of the Sun."""
    figure = plt.figure(figsize=(9, 3.2), layout="constrained")
    flat = figure.add_subplot(1, 3, 1)
    flat.plot(*names["around"].q[:, :2].T)
    flat.add_patch(plt.Circle(names["centre"], names["radius"], color="0.8"))
    flat.set(xlabel="x", ylabel="y", title="disc", aspect="equal")
    cap, sun = (figure.add_subplot(1, 3, place, projection="3d") for place in (2, 3))
    plotting.path(names["tour"], ax=cap, cones=[(names["pole"], 0.5)]).set_title("cap of the sphere")
    plotting.body_axes(names["slew"], ax=sun, cones=[(names["sun"], np.deg2rad(25))]).set_title("cone of the Sun")
    cap.view_init(50, -60)
    sun.view_init(25, 60)
    return figure


def minimum_time(names: dict[str, Any]) -> Any:
    """The bang-bang control of the cart, and the control with a singular arc."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 4), sharex="col", layout="constrained")
    plotting.histories(names["moving"], ax=axes[:, 0])
    plotting.histories(names["to_and_fro"], ax=axes[:, 1])
    axes[0, 0].legend(["position", "velocity"])
    axes[0, 0].set_title("bang-bang")
    axes[0, 1].set_title("with a singular arc from 1 to 2")
    return figure


def phases(names: dict[str, Any]) -> Any:
    """Speed and mass of the rocket with two stages."""
    figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
    plotting.histories(names["rocket"], ax=[axis])
    axis.legend(["speed", "mass"])
    return figure


def integration(names: dict[str, Any]) -> Any:
    """The path of the pendulum on the sphere, and the error of its energy."""
    figure = plt.figure(figsize=(9, 3.2), layout="constrained")
    sphere, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    plotting.path(names["path"], problem=names["S2"], ax=sphere)
    plotting.energy(names["path"], names["energy"], ax=flat)
    return figure


# What draws the picture of a page, and after how many blocks of its code.
PAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], int]] = {
    "obstacles": (obstacles, 3),
    "minimum_time": (minimum_time, 4),
    "phases": (phases, 2),
    "integration": (integration, 1),
}


def main(chosen: list[str]) -> None:
    """Run the code of the pages and write their pictures, ``docs/PAGE.png``."""
    for page in chosen or PAGES:
        draw, count = PAGES[page]
        names: dict[str, Any] = {"__name__": page}
        for block in BLOCK.findall((DOCS / f"{page}.md").read_text())[:count]:
            exec(block, names)
        with mpl.rc_context({"font.size": 8, "lines.linewidth": 1.2}):
            save(draw(names), DOCS / f"{page}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
