"""Ways in which a function holds a parameter that changes later, without the function being written anew."""

from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp

Held = tuple[Callable[[Any], Any], Callable[[float], None]]  # x -> k x, and what changes k

HELD = {"k": jnp.zeros(())}


def _closure(k: Any) -> Held:
    def change(value: float) -> None:
        nonlocal k
        k = jnp.asarray(value)

    return lambda x: k * x, change


def _in_a_global(body: Callable[[Any], Any], k: Any) -> Held:
    def change(value: float) -> None:
        HELD["k"] = jnp.asarray(value)

    change(k)
    return body, change


def _in_an_attribute(holder: Any, k: Any) -> Held:
    holder.k = k
    return lambda x: holder.k * x, lambda value: setattr(holder, "k", jnp.asarray(value))


def scaled(x: Any) -> Any:
    """``k x`` with the global ``k``."""
    return HELD["k"] * x


@jax.jit
def _jitted(x: Any) -> Any:
    return HELD["k"] * x


@jax.custom_jvp
def _ruled(x: Any) -> Any:
    return HELD["k"] * x


_ruled.defjvp(lambda at, along: (_ruled(*at), _jitted(*along)))


def _body(carry: Any, _: Any) -> Any:
    return HELD["k"] * carry, None


def _looped(x: Any) -> Any:
    return jax.lax.scan(_body, x, None, length=1)[0]


def _chosen(x: Any) -> Any:
    return jax.lax.cond(jnp.sum(x) > 0, scaled, scaled, x)


def _product(holder: Any, x: Any) -> Any:
    return holder["k"] * x


def _partial(k: Any) -> Held:
    holder = {"k": k}
    return partial(_product, holder), lambda value: holder.update(k=jnp.asarray(value))


class _Slotted:
    __slots__ = ("k",)

    def __call__(self, x: Any) -> Any:
        return self.k * x


class _Scale:
    k: Any

    def __call__(self, x: Any) -> Any:
        return self.k * x


def _object(kind: type, k: Any) -> Held:
    holder = kind()
    holder.k = k
    return holder, lambda value: setattr(holder, "k", jnp.asarray(value))


def _method(k: Any) -> Held:
    holder, change = _object(_Scale, k)
    return holder.__call__, change


def _default(k: Any) -> Held:
    def product(x: Any, k: Any = k) -> Any:
        return k * x

    return product, lambda value: setattr(product, "__defaults__", (jnp.asarray(value),))


WAYS: dict[str, Callable[[Any], Held]] = {
    "variable of a closure": _closure,
    "global variable": partial(_in_a_global, scaled),
    "attribute of a class": lambda k: _in_an_attribute(type("Constants", (), {}), k),
    "attribute of a module": lambda k: _in_an_attribute(ModuleType("constants"), k),
    "partial": _partial,
    "callable object": partial(_object, _Scale),
    "method": _method,
    "slots": partial(_object, _Slotted),
    "default argument": _default,
    "helper that reads a global": partial(_in_a_global, lambda x: scaled(x)),
    "jitted helper": partial(_in_a_global, lambda x: _jitted(x)),
    "jitted helper of a derivative": partial(_in_a_global, _ruled),
    "jitted function": partial(_in_a_global, _jitted),
    "body of a loop": partial(_in_a_global, _looped),
    "branch": partial(_in_a_global, _chosen),
}


def held(way: str, k: float) -> Held:
    """A function ``x -> k x`` that holds ``k`` in a way, and a function that changes ``k`` in it."""
    return WAYS[way](jnp.asarray(k))
