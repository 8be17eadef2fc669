"""Numerics that the facts are stated with: compiled kernels, flat coordinates, slopes, differences, random draws."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st
from jax.flatten_util import ravel_pytree
from retrax.manifolds import CotangentBundle, Manifold, TangentBundle
from retrax.manifolds.numerics import ambient as vec

SEEDS = st.integers(0, 2**31 - 1)
FRACTIONS = st.one_of(st.just(0.0), st.floats(0.0, 1.0))

# The kernels run a few times each: compiling them takes longer than running them, so the compiler is asked for less.
# An XLA that does not know an option does without.
_WISHES = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
}


@lru_cache
def _compiler_options() -> dict[str, int | bool]:
    def known(option: str) -> bool:
        try:
            jax.jit(lambda x: x + 1, compiler_options={option: _WISHES[option]})(1.0)
        except jax.errors.JaxRuntimeError:
            return False
        return True

    return {option: value for option, value in _WISHES.items() if known(option)}


def compiled(function: Callable) -> Callable:
    """``function`` compiled quickly, with numpy arrays as its values."""
    fast = jax.jit(function, compiler_options=_compiler_options())
    return lambda *arguments: jax.tree.map(np.asarray, fast(*arguments))


def _real_parts(leaf: jax.Array) -> tuple[jax.Array, ...]:
    return (jnp.real(leaf), jnp.imag(leaf)) if jnp.iscomplexobj(leaf) else (leaf,)


def flat(a: Any) -> jax.Array:
    """The entries of an ambient vector, or of several, as one real vector: complex arrays by real and imaginary parts."""
    return ravel_pytree(jax.tree.map(_real_parts, a))[0]


def unflat(manifold: Manifold) -> Callable:
    """The map from real vectors to ambient vectors of a manifold."""
    leaves, structure = jax.tree.flatten(vec.zeros(manifold.ambient))
    split = ravel_pytree([_real_parts(leaf) for leaf in leaves])[1]

    def unravel(a: jax.Array) -> Any:
        return jax.tree.unflatten(structure, [p[0] + 1j * p[1] if len(p) == 2 else p[0] for p in split(a)])

    return unravel


def ambient_size(manifold: Manifold) -> int:
    """Real dimension of the ambient space."""
    return flat(vec.zeros(manifold.ambient)).size


def norm(a: Any) -> float:
    """Largest absolute entry of an ambient vector; NaN if any entry is."""
    return float(max(np.max(np.abs(leaf), initial=0.0) for leaf in jax.tree.leaves(a)))


# Differences of order 6: f'(0) = sum_k w_k f(k h) / h.
NODES = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0


def differences(values: np.ndarray, h: float) -> np.ndarray:
    """Derivative at 0, to order ``h^6``, of a function with these ``values`` at ``h NODES``."""
    return np.tensordot(WEIGHTS, values, 1) / h


def slope(t: np.ndarray, errors: np.ndarray, floor: float) -> float:
    """Slope of ``log error`` over ``log t``, where the errors are above the rounding ``floor``; infinite where none is."""
    seen = errors > floor
    return float(np.polyfit(np.log(t[seen]), np.log(errors[seen]), 1)[0]) if seen.sum() >= 3 else np.inf


@lru_cache
def _sampler(manifold: Manifold) -> Callable:
    def sample(seed: jax.Array) -> tuple:
        first, second = jax.random.split(jax.random.key(seed))
        x = manifold.random_point(first)
        return flat(x), flat(manifold.random_tangent(second, x)), vec.flatten_frame(manifold.basis(x))

    return compiled(sample)


def draw_point(manifold: Manifold, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A random point and a random tangent vector there, flat, and the orthonormal basis of the tangent space, by rows."""
    return _sampler(manifold)(seed)


def draw_tangent(rng: np.random.Generator, basis: np.ndarray, length: float) -> np.ndarray:
    """A tangent vector of this Euclidean length in a random direction."""
    c = rng.standard_normal(basis.shape[0])
    return length * (c / np.linalg.norm(c)) @ basis


@lru_cache
def _nearest(manifold: Manifold) -> Callable:
    unravel = unflat(manifold)
    return compiled(lambda a: jax.lax.fori_loop(0, 6, lambda _, a: flat(manifold.restore(unravel(a))), a))


def draw_near(manifold: Manifold, x: np.ndarray, rng: np.random.Generator, distance: float) -> np.ndarray:
    """A point of the manifold about this far from ``x``, reached through the ambient space."""
    a = rng.standard_normal(x.size)
    return _nearest(manifold)(x + distance * a / np.linalg.norm(a))


@lru_cache
def _bundle_frames(manifold: Manifold) -> tuple[Callable, Callable]:
    cotangent = CotangentBundle(manifold)
    of_base, of_bundle = unflat(manifold), unflat(cotangent)

    def over_base(x: jax.Array, p: jax.Array) -> tuple:
        q = of_base(x)
        z = q, manifold.projection(q, of_base(p))
        return flat(z), vec.flatten_frame(cotangent.basis(z))

    def over_bundle(z: jax.Array, zdot: jax.Array) -> jax.Array:
        return vec.flatten_frame(TangentBundle(cotangent).spanning_frame((of_bundle(z), of_bundle(zdot))))

    return compiled(over_base), compiled(over_bundle)


def draw_bundle_tangent(manifold: Manifold, seed: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A random point of ``TT*Q``, flat ``(x, p, xdot, pdot)``, and a frame of its tangent space, by rows.

    The second half of the frame is ``(0, e_i)`` with an orthonormal basis ``e_i`` of the tangent space of ``T*Q``.
    ``length`` is the Euclidean length of ``(xdot, pdot)``.
    """
    rng = np.random.default_rng(seed)
    over_base, over_bundle = _bundle_frames(manifold)
    x, p, _ = draw_point(manifold, seed)
    z, basis = over_base(x, p)
    zdot = draw_tangent(rng, basis, length)
    return np.concatenate([z, zdot]), over_bundle(z, zdot)
