"""Rules of JAX's primitives that only move entries of arrays."""

import itertools
import math
from collections.abc import Callable, Iterator
from functools import partial, reduce
from typing import Any

import casadi as ca
import numpy as np

from ..constant_folding import reshape
from .arrays import Complex, Entries, Scalars, column, is_complex, is_known, join, move_entries, parts, scalars, take
from .choice import select
from .elementwise import elementwise

OUTSIDE_ENTRY = -1  # the place of an entry that lies outside of the array


def _broadcast(params: dict[str, Any], x: Entries) -> Entries:
    shape, dimensions = params["shape"], params["broadcast_dimensions"]

    def move(a: np.ndarray) -> np.ndarray:
        full = [1] * len(shape)
        for axis, size in zip(dimensions, a.shape, strict=True):
            full[axis] = size
        return np.broadcast_to(a.reshape(full), shape)

    return move_entries(x, move)


def _slice(params: dict[str, Any], x: Entries) -> Entries:
    strides = params["strides"] or (1,) * len(params["start_indices"])
    part = tuple(map(slice, params["start_indices"], params["limit_indices"], strides))
    return move_entries(x, lambda a: a[part])


def _split(params: dict[str, Any], x: Entries) -> list[Entries]:
    ends = np.cumsum(params["sizes"])[:-1]
    count = len(params["sizes"])
    return [move_entries(x, lambda a, k=k: np.split(a, ends, params["axis"])[k]) for k in range(count)]


def _unstack(params: dict[str, Any], x: Entries) -> list[Entries]:
    count = x.shape[params["axis"]]
    return [move_entries(x, lambda a, k=k: np.take(a, k, params["axis"])) for k in range(count)]


def concatenate(arrays: list[Entries], axis: int) -> Entries:
    """The arrays one after the other along an axis."""
    starts = np.cumsum([0, *(math.prod(a.shape) for a in arrays)])
    places = [s + np.arange(math.prod(a.shape)).reshape(a.shape) for s, a in zip(starts, arrays, strict=False)]
    order = np.concatenate(places, axis)
    return join(arrays, order.shape, order)


def stack(arrays: list[Entries]) -> Entries:
    """The arrays along a new first axis."""
    return join(arrays, (len(arrays), *arrays[0].shape))


def _pad(params: dict[str, Any], x: Entries, value: Entries) -> Entries:
    places = np.arange(math.prod(x.shape)).reshape(x.shape)
    for axis, (low, high, inside) in enumerate(params["padding_config"]):
        size = places.shape[axis]
        wide = np.full(
            (*places.shape[:axis], size + max(size - 1, 0) * inside, *places.shape[axis + 1 :]), OUTSIDE_ENTRY
        )
        wide[(slice(None),) * axis + (slice(None, None, inside + 1),)] = places
        around = [(0, 0)] * places.ndim
        around[axis] = (max(low, 0), max(high, 0))
        wide = np.pad(wide, around, constant_values=OUTSIDE_ENTRY)
        cut = slice(max(-low, 0), wide.shape[axis] - max(-high, 0))
        places = wide[(slice(None),) * axis + (cut,)]
    return _fill(x, places, value)


def _fill(x: Entries, places: np.ndarray, value: Entries) -> Entries:
    """Entries at places, ``value`` where a place is outside."""
    count = math.prod(x.shape)
    return join([x, value], places.shape, np.where(places == OUTSIDE_ENTRY, count, places))


def _clamp(starts: list[Any], shape: tuple[int, ...], sizes: tuple[int, ...]) -> list[int | ca.SX]:
    """Starts of a window, moved into the array."""
    found: list[int | ca.SX] = []
    for start, full, size in zip(starts, shape, sizes, strict=True):
        last = full - size
        known = not isinstance(start, Scalars)
        found.append(int(np.clip(int(start), 0, last)) if known else ca.fmin(ca.fmax(start.values, 0), last))
    return found


def _window(x: Entries, starts: list[int | ca.SX], sizes: tuple[int, ...]) -> Entries:
    """The part of an array of these sizes that starts at an index; one that depends on the input selects among all."""
    return _choose([(c, move_entries(x, lambda a, part=part: a[part])) for c, part in _parts(starts, x.shape, sizes)])


def _parts(
    starts: list[Any], shape: tuple[int, ...], sizes: tuple[int, ...]
) -> Iterator[tuple[Any, tuple[slice, ...]]]:
    """All windows into an array of this shape, each with its condition, which is None for known starts."""
    unknown = [k for k, start in enumerate(starts) if not isinstance(start, int)]
    for choice in itertools.product(*(range(shape[k] - sizes[k] + 1) for k in unknown)):
        at = dict(enumerate(starts)) | dict(zip(unknown, choice, strict=True))
        conditions = [starts[k] == index for k, index in zip(unknown, choice, strict=True)]
        part = tuple(slice(at[k], at[k] + size) for k, size in enumerate(sizes))
        yield reduce(ca.logic_and, conditions) if conditions else None, part


def _choose(found: list[tuple[Any, Entries]]) -> Entries:
    if len(found) == 1:
        return found[0][1]
    if any(is_complex(value) for _, value in found):
        halves = ([(c, parts(value)[k]) for c, value in found] for k in (0, 1))
        return Complex(*(_choose(half) for half in halves))
    shape, value = found[0][1].shape, column(found[-1][1])
    for condition, part in reversed(found[:-1]):
        value = select(condition, column(part), value)
    return scalars(value, shape)


def _dynamic_slice(params: dict[str, Any], x: Entries, *starts: Entries) -> Entries:
    sizes = params["slice_sizes"]
    return _window(x, _clamp(list(starts), x.shape, sizes), sizes)


def _dynamic_update_slice(params: dict[str, Any], x: Entries, update: Entries, *starts: Entries) -> Entries:
    at = _clamp(list(starts), x.shape, update.shape)
    return _choose([(c, _combine("scatter", x, part, update)) for c, part in _parts(at, x.shape, update.shape)])


def _entry(indices: Entries, at: tuple[int, ...], k: int) -> Any:
    """Entry ``(*at, k)`` of an array of indices: a number, or scalars."""
    if isinstance(indices, np.ndarray):
        return int(indices[(*at, k)])
    flat = int(np.ravel_multi_index((*at, k), indices.shape))
    return take(indices, np.array(flat))


def _starts(
    numbers: Any, indices: Entries, at: tuple[int, ...], rank: int, batching: tuple[tuple[int, int], ...]
) -> list[Any]:
    """Where the window of one batch position begins."""
    starts: list[Any] = [0] * rank
    for k, axis in enumerate(numbers):
        starts[axis] = _entry(indices, at, k)
    for axis, of in batching:
        starts[axis] = at[of]
    return starts


def _is_outside(starts: list[Any], shape: tuple[int, ...], sizes: tuple[int, ...]) -> bool:
    known = [(s, n, size) for s, n, size in zip(starts, shape, sizes, strict=True) if isinstance(s, int)]
    return any(s < 0 or s + size > n for s, n, size in known)


def _filling(params: dict[str, Any], x: Entries) -> np.ndarray:
    """The value of ``gather`` for indices outside of an array."""
    value = np.nan if params["fill_value"] is None else params["fill_value"]
    return np.asarray(value, x.dtype if isinstance(x, np.ndarray) else complex if is_complex(x) else float)


def _window_or(filling: np.ndarray, x: Entries, starts: list[Any], sizes: tuple[int, ...]) -> Entries:
    """The part of an array of these sizes that starts at an index, all ``filling`` for an index without such a part.

    A window that is partly outside is not moved into the array.
    """
    nothing = np.broadcast_to(filling, sizes)
    if _is_outside(starts, x.shape, sizes):
        return nothing
    at = _columns(starts)
    found = [(c, move_entries(x, lambda a, part=part: a[part])) for c, part in _parts(at, x.shape, sizes)]
    return found[0][1] if found[0][0] is None else _choose([*found, (None, nothing)])


def _columns(starts: list[Any]) -> list[int | ca.SX]:
    """Starts of a window as numbers, or expressions."""
    return [s.values if isinstance(s, Scalars) else s for s in starts]


def _gather(params: dict[str, Any], x: Entries, indices: Entries) -> Entries:
    d, sizes = params["dimension_numbers"], tuple(params["slice_sizes"])
    batch = indices.shape[:-1]
    batching = tuple(zip(d.operand_batching_dims, d.start_indices_batching_dims, strict=True))
    dropped = {*d.collapsed_slice_dims, *d.operand_batching_dims}
    kept = [size for axis, size in enumerate(sizes) if axis not in dropped]
    filling = _filling(params, x) if "FILL" in str(params["mode"]) else None
    windows: list[Entries] = []
    for at in np.ndindex(*batch):
        starts = _starts(d.start_index_map, indices, at, len(x.shape), batching)
        if filling is None:
            window = _window(x, _clamp(starts, x.shape, sizes), sizes)
        else:
            window = _window_or(filling, x, starts, sizes)
        windows.append(move_entries(window, lambda a: a.reshape(kept)))
    rank = len(batch) + len(kept)
    outer = [axis for axis in range(rank) if axis not in d.offset_dims]
    order = np.argsort([*outer, *d.offset_dims])
    if not windows:
        return np.transpose(np.zeros((*batch, *kept), complex if is_complex(x) else float), order)
    whole = move_entries(stack(windows), lambda a: a.reshape((*batch, *kept)))
    return move_entries(whole, lambda a: np.transpose(a, order))


def _scatter(name: str, params: dict[str, Any], x: Entries, indices: Entries, updates: Entries) -> Entries:
    """``x`` with windows set to the updates, or increased by them; updates outside of the array are dropped."""
    windows = _windows(params, x.shape, indices, updates.shape)
    if name == "scatter" and is_known(indices):  # entries that only move are moved at once
        count = math.prod(x.shape)
        order = np.arange(count).reshape(x.shape)
        for starts, sizes, of in windows:
            ((_, into),) = _parts(starts, x.shape, sizes)
            order[into] = count + of
        return join([x, updates], x.shape, order)
    result = x
    for starts, sizes, of in windows:
        update = take(updates, of)
        found = [(c, _combine(name, result, into, update)) for c, into in _parts(starts, x.shape, sizes)]
        result = found[0][1] if found[0][0] is None else _choose([*found, (None, result)])
    return result


def _windows(params: dict[str, Any], shape: tuple[int, ...], indices: Any, updated: tuple[int, ...]) -> list[tuple]:
    """For each update window: where it begins, its sizes, and the places of the updates."""
    d = params["dimension_numbers"]
    batching = tuple(zip(d.operand_batching_dims, d.scatter_indices_batching_dims, strict=True))
    dropped = {*d.inserted_window_dims, *d.operand_batching_dims}
    outer = [axis for axis in range(len(updated)) if axis not in d.update_window_dims]
    places = np.transpose(np.arange(math.prod(updated)).reshape(updated), [*outer, *d.update_window_dims])
    sizes = [1] * len(shape)
    windows = iter(updated[axis] for axis in d.update_window_dims)
    for axis in range(len(shape)):
        sizes[axis] = 1 if axis in dropped else next(windows)
    found = []
    for at in np.ndindex(*indices.shape[:-1]):
        starts = _starts(d.scatter_dims_to_operand_dims, indices, at, len(shape), batching)
        if "CLIP" in str(params["mode"]):
            starts = _clamp(starts, shape, tuple(sizes))
        if not _is_outside(starts, shape, tuple(sizes)):
            found.append((_columns(starts), tuple(sizes), np.reshape(places[at], sizes)))
    return found


def _combine(name: str, x: Entries, into: tuple[slice, ...], update: Entries) -> Entries:
    """``x`` with a window combined with an update of its shape."""
    window = move_entries(x, lambda a: a[into])
    function = name.removeprefix("scatter-")
    new: Any = update
    if function != "scatter" and is_known(window, update):
        new = {"add": np.add, "mul": np.multiply, "min": np.minimum, "max": np.maximum}[function](window, update)
    elif function != "scatter":
        new = elementwise(function, {}, [window, update])
    order = np.arange(math.prod(x.shape)).reshape(x.shape)
    order[into] = math.prod(x.shape) + np.arange(math.prod(update.shape)).reshape(update.shape)
    return join([x, new], x.shape, order)


Rule = Callable[..., Entries | list[Entries]]

STRUCTURAL_RULES: dict[str, Rule] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda params, *a: concatenate(list(a), params["dimension"]),
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "pad": _pad,
    "reshape": lambda params, x: move_entries(x, lambda a: reshape(params, a)),
    "rev": lambda params, x: move_entries(x, lambda a: np.flip(a, params["dimensions"])),
    "slice": _slice,
    "split": _split,
    "stack": lambda params, *a: move_entries(stack(list(a)), lambda b: np.moveaxis(b, 0, params["axis"])),
    "squeeze": lambda params, x: move_entries(x, lambda a: np.squeeze(a, tuple(params["dimensions"]))),
    "tile": lambda params, x: move_entries(x, lambda a: np.tile(a, params["reps"])),
    "transpose": lambda params, x: move_entries(x, lambda a: np.transpose(a, params["permutation"])),
    "unstack": _unstack,
    **{
        name: partial(_scatter, name)
        for name in ("scatter", "scatter-add", "scatter-mul", "scatter-min", "scatter-max")
    },
}
