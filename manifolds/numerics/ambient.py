"""Arithmetic in the ambient vector space: points, tangent vectors and covectors are pytrees of arrays.

A *frame* is a pytree of the same structure whose leaves carry one extra leading axis: its k-th slice is the k-th
vector.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import get_opaque_trace_state
from jaxtyping import Array, ArrayLike, Float, PyTree

if TYPE_CHECKING:
    # Type checkers take PyTree for unknown, and with it the functions that users call.
    Ambient: TypeAlias = Any
    Frame: TypeAlias = Any
else:
    Ambient = Frame = PyTree[Array]
Coordinates = Float[Array, " k"]
NUMBERS = int, float, np.number, np.ndarray, jax.Array


def is_traced(*trees: object) -> bool:
    """Whether any array in the arguments is a JAX tracer, on whose values nothing can be checked."""
    for leaf in jax.tree.leaves(trees):  # noqa: SIM110  # a generator takes twice the time
        if isinstance(leaf, Tracer):
            return True
    return False


def shared_hash(self: PyTree) -> int:
    """A hash that equal trees share, in which arrays count by their shapes and kinds.

    Raises
    ------
    TypeError
        For a tree with arrays under ``jit``, where nothing tells whether two arrays are equal.
    """
    leaves, structure = jax.tree.flatten(self)
    of_arrays = [isinstance(leaf, np.ndarray | jax.Array) for leaf in leaves]
    if any(of_arrays) and is_jitting():
        raise TypeError(f"unhashable type: {type(self).__name__!r} with arrays under jit")
    keys = [(a.shape, a.dtype) if is_array else a for a, is_array in zip(leaves, of_arrays, strict=True)]
    return hash((structure, *keys))


def is_jitting() -> bool:
    """Whether this is the body of a function under ``jit``, where the value of no operation is known."""
    return is_traced(jax.device_put(0.0))


def is_transformed(*arguments: Any) -> bool:
    """Whether JAX is transforming the caller or values in the arguments, on which nothing can be checked."""
    return get_opaque_trace_state() != _untransformed() or is_traced(arguments)


@cache
def _untransformed() -> Any:
    """The state of JAX outside of ``jit``, ``vmap`` and ``grad``, which a new thread has."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(get_opaque_trace_state).result()


def is_count(x: object) -> bool:
    """Whether ``x`` is a whole number of at least 1."""
    return isinstance(x, (int, np.integer)) and not isinstance(x, bool) and bool(x >= 1)


def is_finite_number(x: object) -> bool:
    """Whether ``x`` is one finite real number; True and False are none."""
    if isinstance(x, bool) or not isinstance(x, NUMBERS):
        return False
    if not isinstance(x, (int, float)) and (np.ndim(x) or not np.isrealobj(x)):
        return False
    try:
        return math.isfinite(x)
    except OverflowError:  # a whole number that is larger than any of them
        return False


def pairing(a: Ambient, b: Ambient) -> Array:
    """Pairing ``<a, b>`` of a covector with a vector: the real part of the sum of products of entries (Frobenius)."""
    terms = jax.tree.map(lambda s, t: jnp.sum(jnp.real(jnp.conj(s) * t)), a, b)
    return sum(jax.tree.leaves(terms), start=jnp.zeros(()))


def gradient(function: Callable[[Ambient], Array], x: Ambient) -> Ambient:
    """Gradient for the pairing: ``<gradient, a>`` is the derivative of a real function along ``a``.

    JAX's own gradient is its complex conjugate.
    """
    return conjugate(jax.grad(function)(x))


def pullback(
    function: Callable[..., Ambient], *points: Ambient
) -> tuple[Ambient, Callable[[Ambient], tuple[Ambient, ...]]]:
    """Value of ``function``, and the pullback of covectors, ``<pull(p), d> = <p, Df d>``."""
    value, pull = jax.vjp(function, *points)
    return value, lambda p: conjugate(pull(conjugate(p)))


def conjugate(a: Ambient) -> Ambient:
    """Complex conjugate, entry by entry."""
    return jax.tree.map(jnp.conj, a)


def add(a: Ambient, b: Ambient) -> Ambient:
    """Sum ``a + b``."""
    return jax.tree.map(jnp.add, a, b)


def subtract(a: Ambient, b: Ambient) -> Ambient:
    """Difference ``a - b``."""
    return jax.tree.map(jnp.subtract, a, b)


def scale(s: ArrayLike, a: Ambient) -> Ambient:
    """Multiple ``s a`` by a scalar."""
    return jax.tree.map(lambda leaf: s * leaf, a)


def entries(tree: Any, index: Any) -> Any:
    """``leaf[index]`` of every array of a tree in a function of JAX, where arrays may be traced."""
    return jax.tree.map(lambda leaf: leaf[index], tree)


def taken(tree: Any, index: Any) -> Any:
    """``leaf[index]`` of every array of a tree, as one of NumPy: nothing is compiled for it."""
    kind = type(tree)  # these in half the time of ``jax.tree.map``
    if kind is np.ndarray:
        return tree[index]
    if kind is dict:
        return {name: taken(part, index) for name, part in tree.items()}
    if kind is tuple:
        return tuple([taken(part, index) for part in tree])
    if isinstance(tree, tuple) and hasattr(kind, "_make"):
        return kind._make([taken(part, index) for part in tree])
    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


def joined(trees: Sequence[Any]) -> Any:
    """Trees of NumPy arrays one after the other, along their leading axes; one alone as it is."""
    return trees[0] if len(trees) == 1 else jax.tree.map(lambda *leaves: np.concatenate(leaves), *trees)


def stacked(trees: Sequence[Any]) -> Any:
    """Trees of NumPy arrays beside each other, along a new leading axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


def zeros(ambient: PyTree) -> Ambient:
    """Zero of the ambient space described by a pytree of shapes (or of arrays)."""
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), ambient)


def normal(key: Array, ambient: PyTree) -> Ambient:
    """Ambient vector with independent standard normal entries."""
    leaves, structure = jax.tree.flatten(ambient)
    keys = jax.random.split(key, max(len(leaves), 1))
    drawn = [jax.random.normal(k, leaf.shape, leaf.dtype) for k, leaf in zip(keys, leaves, strict=False)]
    return jax.tree.unflatten(structure, drawn)


def largest(a: Array, axis: int | None = None) -> Array:
    """Largest absolute entry along an axis, by default of all; NaN if one is, and zero if there are none."""
    # Maxima of some thousand arrays at once pass over entries that are NaN (XLA 0.10 on processors).
    unknown = jnp.any(jnp.isnan(a), axis)
    return jnp.where(unknown, jnp.nan, jnp.max(jnp.abs(a), axis, initial=0.0))


def size(a: Ambient) -> Array:
    """Largest absolute entry ``max |a_i|``; NaN if any entry is."""
    leaves = [largest(leaf) for leaf in jax.tree.leaves(a) if leaf.size]
    return largest(jnp.stack(leaves)) if leaves else jnp.zeros(())


def combine(frame: Frame, coordinates: Coordinates) -> Ambient:
    """Vector ``sum_k c_k E_k`` with coordinates ``c``, shape ``(k,)``, in a frame."""
    return jax.tree.map(lambda leaf: jnp.tensordot(coordinates, leaf, 1), frame)


def combine_each(frame: Frame, coordinates: Float[Array, "m k"]) -> Frame:
    """The frame of ``m`` vectors with these coordinates, one row each, in a frame of ``k``."""
    return jax.tree.map(lambda leaf: jnp.tensordot(coordinates, leaf, 1), frame)


def components(frame: Frame, a: Ambient) -> Coordinates:
    """Pairings ``<E_k, a>``, shape ``(k,)``: the coordinates of ``a`` if the frame is orthonormal."""

    def one(e: Array, leaf: Array) -> Array:
        return jnp.real(jnp.conj(e.reshape(e.shape[0], leaf.size)) @ leaf.reshape(leaf.size))

    terms = jax.tree.map(one, frame, a)
    return sum(jax.tree.leaves(terms), start=jnp.zeros(()))


def coordinate_sizes(frame: Frame, a: Ambient) -> Coordinates:
    """Typical size, shape ``(k,)``, of the coordinates in a frame of vectors as large as ``a``, array by array."""
    largest = jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.max(jnp.abs(leaf), initial=0.0), leaf.shape), a)
    return components(jax.tree.map(jnp.abs, frame), largest)


def flatten_frame(frame: Frame) -> Float[Array, "k N"]:
    """Matrix whose rows are the vectors of a frame, real and imaginary parts side by side."""
    leaves = [leaf.reshape(leaf.shape[0], math.prod(leaf.shape[1:])) for leaf in jax.tree.leaves(frame)]
    parts = [part for leaf in leaves for part in ((leaf.real, leaf.imag) if jnp.iscomplexobj(leaf) else (leaf,))]
    return jnp.concatenate(parts, axis=1)


def orthonormalise(frame: Frame) -> Frame:
    """Orthonormal frame of the same span by the rule of Gram and Schmidt, a smooth function of the frame."""
    r = jnp.linalg.qr(flatten_frame(frame).T, mode="r")
    # The signs that LAPACK gives to the rows jump where an entry that may be zero by structure changes its sign.
    mixing = jnp.linalg.inv(jnp.where(jnp.diagonal(r) < 0, -1.0, 1.0)[:, None] * r)
    return jax.tree.map(lambda leaf: jnp.tensordot(mixing.T.astype(leaf.dtype), leaf, 1), frame)
