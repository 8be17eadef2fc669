"""Axes that are given, or made; and how a history is drawn on them."""

from typing import Any

import numpy as np

from ..channels import Channel, View
from ..integrators.quantities import with_unit
from ..integrators.text import brief
from ..manifolds import InvalidInputError

PANEL = 4.6, 3.2  # inches
MANY = 12  # entries that a legend still names


def one(ax: Any, projection: str | None = None) -> Any:
    """The axes that were given, or those of a new figure. Raises ``InvalidInputError`` for flat ones where they are
    spatial."""
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
    """As many axes with a common horizontal axis as there are panels: those given, or those of a new figure, row by
    row."""
    if ax is None:
        from matplotlib import pyplot

        columns = columns or (1 if count < 3 else 2)
        rows = -(-count // columns)
        size = (panel[0] * columns, panel[1] * rows)
        figure, made = pyplot.subplots(rows, columns, figsize=size, sharex=True, squeeze=False, layout="constrained")
        for each in made.flat:  # every panel names its time, and there may be none below it
            each.tick_params(labelbottom=True)
        for spare in made.flat[count:]:
            figure.delaxes(spare)
        return made.flat[:count]
    given = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    if len(given) != count:
        raise InvalidInputError(
            f"ax must be {count} axes, one for each panel, got {len(given)}; try ax=None for a new figure"
        )
    return np.array([one(each) for each in given], dtype=object)


def draw(ax: Any, times: np.ndarray, channel: Channel, found: View, **style: Any) -> Any:
    """A history with its name, units and the names of its entries."""
    _lines(ax, times, channel, channel.labels, **style)
    ax.set_ylabel(channel.title)
    time_axis(ax, found)
    return ax


def draw_controls(ax: Any, channels: list[Channel], found: View) -> Any:
    """Histories of controls: as steps where each step has one, which holds along it. Of several arrays each line has
    the name."""
    if len(channels) == 1:
        draw(ax, *_held(channels[0], found), found, **_style(found))
        return ax
    for channel in channels:
        names = [with_unit(f"{channel.name} {label}".rstrip(), channel.unit) for label in channel.labels]
        _lines(ax, *_held(channel, found), names, **_style(found))
    ax.set_ylabel("controls")
    time_axis(ax, found)
    return ax


def _held(channel: Channel, found: View) -> tuple[np.ndarray, Channel]:
    """Times and values of controls: those of a step from its beginning on."""
    if not found.is_held:
        return found.stage_times, channel
    return found.times, channel._replace(values=np.concatenate([channel.values, channel.values[-1:]]))


def _style(found: View) -> dict[str, str]:
    return {"drawstyle": "steps-post"} if found.is_held else {}


def _lines(ax: Any, times: np.ndarray, channel: Channel, names: list[str], **style: Any) -> None:
    shown = len(names) <= MANY and any(names)
    for column, name in zip(channel.values.T, names, strict=True):
        ax.plot(times, column, label=name if shown else None, **style)
    if shown:
        ax.legend(fontsize="small")


def time_axis(ax: Any, found: View) -> None:
    """The name and unit of the time."""
    ax.set_xlabel(with_unit("time", found.quantities.time))
