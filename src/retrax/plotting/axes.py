"""Axes that are given, or made; and how histories are drawn on them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..integrators.problem.quantities import with_unit
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError
from ..named_columns import NamedColumn, join_names
from .series import Panel, PictureSeries

PANEL = 4.6, 3.2  # inches
MOST_LEGEND_ENTRIES = 12  # entries that a legend still names
STYLES = "-", "--", ":", "-."  # of records in one picture
CROWD = {"linewidth": 0.8, "alpha": 0.6}  # of more records than styles, or of records without names


def one(ax: Any, projection: str | None = None) -> Any:
    """The given axes, or the axes of a new figure.

    Raises ``InvalidInputError`` for flat axes if the picture is spatial.
    """
    if ax is None:
        from matplotlib import pyplot

        size = (6.0, 6.0) if projection else (6.4, 4.0)
        return pyplot.figure(figsize=size, layout="constrained").add_subplot(projection=projection)
    if not hasattr(ax, "plot") or (projection == "3d") != hasattr(ax, "get_zlim"):
        kind = "axes of matplotlib in three dimensions" if projection else "flat axes of matplotlib"
        hint = 'figure.add_subplot(projection="3d")' if projection else "figure.add_subplot()"
        raise InvalidInputError(f"ax must be {kind}, got {brief(ax)}; try {hint}")
    return ax


def several(ax: Any, count: int, columns: int | None = None, panel: tuple[float, float] = PANEL) -> np.ndarray:
    """The given axes, or axes of a new figure, one for each panel, with a common horizontal axis.

    Panels go row by row; the last panel fills its row.
    """
    if ax is None:
        from matplotlib import pyplot

        columns = columns or (1 if count < 4 else 2)
        rows = -(-count // columns)
        figure = pyplot.figure(figsize=(panel[0] * columns, panel[1] * rows), layout="constrained")
        grid, made = figure.add_gridspec(rows, columns), []
        for k in range(count):
            row, column = divmod(k, columns)
            place = grid[row, column:] if k == count - 1 else grid[row, column]
            made.append(figure.add_subplot(place, sharex=made[0] if made else None))
        return np.array(made, dtype=object)
    given = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    if len(given) != count:
        raise InvalidInputError(
            f"ax must be {count} axes, one for each panel, got {len(given)}; try ax=None for a new figure"
        )
    return np.array([one(each) for each in given], dtype=object)


def draw(ax: Any, panel: Panel, every: PictureSeries, name: str = "") -> Any:
    """Histories of some records: entries in colours, records in line styles, bounds dashed.

    Of channels with several titles each line has the name of its channel, and the axis that which is given.
    """
    titles = list(dict.fromkeys(history.channel.title for own in panel for history in own))
    first = next(history.channel for own in panel for history in own)
    is_one = len(titles) == 1 and first.labels == [""]  # a colour for each record
    colours: dict[tuple[str, int, int], str] = {}
    for record, (own, style) in enumerate(zip(panel, styles(every), strict=True)):
        for history in own:
            names = [every.names[record]] if is_one else _names(history.channel, len(titles) > 1)
            for k, values in enumerate(history.channel.values.T):
                key = history.channel.title, k, record if is_one else 0
                is_named = (
                    key not in colours and names[k] and max(len(names), len(panel) * is_one) <= MOST_LEGEND_ENTRIES
                )
                more: dict[str, Any] = {"color": colours[key]} if key in colours else {}
                more |= {"drawstyle": "steps-post"} if history.is_held else {}
                (line,) = ax.plot(history.times, values, label=names[k] if is_named else None, **style, **more)
                colours[key] = line.get_color()
    _bounds(ax, {bound for own in panel for history in own for pair in history.channel.bounds for bound in pair})
    ax.set_ylabel(titles[0] if len(titles) == 1 else name)
    time_axis(ax, every.time, every.borders)
    legend(ax, [] if is_one else record_handles(every))
    return ax


def time_axis(ax: Any, unit: str, borders: Sequence[float] = ()) -> None:
    """The name and unit of the time, and lines where phases meet."""
    ax.set_xlabel(with_unit("time", unit))
    for border in borders:
        ax.axvline(border, color="0.7", linewidth=0.8, zorder=0)


def styles(every: PictureSeries) -> list[dict[str, Any]]:
    """The style of each record: solid of one, lines that differ of a few with names, thin lines of many."""
    count = len(every.names)
    if count == 1 or (count <= len(STYLES) and any(every.names)):
        return [{"linestyle": style} for style in STYLES[:count]]
    return [CROWD] * count


def record_handles(every: PictureSeries) -> list[Any]:
    """Lines of a legend that name the records."""
    from matplotlib.lines import Line2D

    if len(every.names) == 1 or len(every.names) > len(STYLES):
        return []
    pairs = zip(every.names, styles(every), strict=True)
    return [Line2D([], [], color="0.3", label=name, **style) for name, style in pairs if name]


def legend(ax: Any, more: Sequence[Any] = ()) -> None:
    """The legend, beside flat axes and below spatial axes, so that no curve is hidden; no legend without names."""
    handles = [*ax.get_legend_handles_labels()[0], *more]
    beside = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.3}
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "borderaxespad": 0.3, "ncols": 3}
    if handles:
        ax.legend(handles=handles, fontsize="small", **(below if hasattr(ax, "get_zlim") else beside))


def _names(channel: NamedColumn, is_mixed: bool) -> list[str]:
    """The names of the entries of a channel, in a panel of several channels with units and a name of the channel."""
    if not is_mixed:
        return channel.labels
    name = "" if channel.name == join_names(channel.entries) else channel.name
    return [with_unit(f"{name} {label}".strip(), channel.unit) for label in channel.labels]


def _bounds(ax: Any, bounds: set[float]) -> None:
    """Dashed lines at bounds; a distant bound does not change the scale of the axis."""
    from matplotlib.lines import Line2D

    across = ax.get_yaxis_transform()
    for bound in filter(np.isfinite, bounds):
        line = Line2D([0, 1], [bound, bound], transform=across, color="0.4", linestyle="--", linewidth=0.8, zorder=1)
        ax.add_artist(line)
