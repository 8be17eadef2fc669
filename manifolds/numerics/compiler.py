"""What XLA is asked for by function, so that it compiles in less time."""

from functools import cache

import jax

Option = str | bool


def known_options(wishes: dict[str, Option]) -> dict[str, Option]:
    """The options that this XLA knows, of those that are wished for; none of them where it compiles for no CPU.

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
