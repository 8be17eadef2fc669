"""Options of XLA for single functions, which shorten compilation."""

from functools import cache

import jax

Option = str | bool


def known_options(wishes: dict[str, Option]) -> dict[str, Option]:
    """The requested options that this XLA knows, none of them on other devices than the CPU.

    Nothing global is set: they are given with each function.
    """
    if jax.default_backend() != "cpu":
        return {}
    return (
        wishes if _knows(*wishes.items()) else {name: value for name, value in wishes.items() if _knows((name, value))}
    )


@cache
def _knows(*options: tuple[str, Option]) -> bool:
    try:
        jax.jit(lambda x: x).lower(0.0).compile(dict(options))
    except jax.errors.JaxRuntimeError:
        return False
    return True
