"""The picture of the README and of the first page, a slew: python docs/_site/picture.py writes docs/slew.png."""

import importlib.util
from pathlib import Path
from typing import Any

import matplotlib as mpl
from PIL import Image

ROOT = Path(__file__).parents[2]


def main() -> None:
    """Solve the example of the slew, and draw the paths of the body axes beside the histories."""
    spec = importlib.util.spec_from_file_location("attitude_slew", ROOT / "examples" / "attitude_slew.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    import matplotlib.pyplot as plt
    from retrax import plotting

    with mpl.rc_context({"font.size": 8, "lines.linewidth": 1.2}):
        figure = plt.figure(figsize=(9, 5), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(1, 1.25))
        solution = example.slew(50)
        plotting.body_axes(solution, ax=left.add_subplot(projection="3d"))
        panels = plotting.histories(solution, ax=right.subplots(3, 1, sharex=True))
        panels[0].set_ylabel("rotation vector [rad]")  # its whole name is longer than the panel is high
        for axis in panels:
            axis.get_legend().remove()
            axis.label_outer()
        right.align_ylabels()
        right.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)  # off the curves
        save(figure, ROOT / "docs" / "slew.png")


def save(figure: Any, path: Path) -> None:
    """Write a figure in few colours, which is a third of the size."""
    figure.savefig(path, dpi=200)
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(128).save(path, optimize=True)


if __name__ == "__main__":
    main()
