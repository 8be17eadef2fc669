"""Hamiltonians whose derivatives do not tell how they change."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...indices import require_indices
from ...manifolds import InvalidInputError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import working_precision
from ...reading import one_reading
from ...retractions import Retraction
from ..compilation import call_compiled
from ..functions import real_number
from ..jumps import program_of
from ..stages.hamiltonian import Hamiltonian
from ..stopped import BASES, MOVE, SPANS, Line, near, own_rules, usually_missed


def require_true_hamiltonian(hamiltonian: Hamiltonian, retraction: Retraction, q: Ambient, p: Ambient) -> None:
    """Raise if a Hamiltonian reads entries that its arguments do not have, or changes near ``(q, p)`` in a way that its
    derivative does not tell."""

    def read() -> tuple[list[str], Hamiltonian]:
        program = program_of(hamiltonian, q, p)
        require_indices(program, "the Hamiltonian")
        return own_rules(program), hamiltonian

    with one_reading() as reading:
        found = reading.once(("rules of", id(hamiltonian)), read)[0]
    if not found:
        return
    draw, kind = np.random.default_rng(0).standard_normal, working_precision()
    ways = draw((BASES, 2, 2, retraction.manifold.dimension)).astype(kind)
    lines: Any = jax.tree.map(
        np.asarray, call_compiled(_lines, hamiltonian, retraction, q, p, ways, SPANS.astype(kind))[0]
    )
    for about, line in zip(("states", "momenta"), lines, strict=True):
        wrong = float(usually_missed(line)[0])
        if wrong > 0:
            raise InvalidInputError(
                f"the Hamiltonian changes with the {about} at another rate than its derivative, which is off by "
                f"{wrong:.1e} of it, where it uses {' and '.join(found)}; expected the derivatives of the values, "
                "because Hamilton's equations are made of them; try it without, or a rule that agrees with the values"
            )


def _lines(
    hamiltonian: Hamiltonian, retraction: Retraction, q: Ambient, p: Ambient, ways: Array, spans: Array
) -> tuple[Line, Line]:
    """Lines through several points near a state, along which the point and the covector move."""

    def one(way: Array) -> tuple[Line, Line]:
        base, covector = near(retraction, q, MOVE * way[0, 0]), _moved(retraction, q, p, MOVE * way[0, 1])
        by_state, by_covector = (
            lambda s: real_number("the Hamiltonian", hamiltonian(near(retraction, base, s * way[1, 0]), covector))[
                None
            ],
            lambda s: real_number(
                "the Hamiltonian", hamiltonian(base, _moved(retraction, base, covector, s * way[1, 1]))
            )[None],
        )
        return _along(by_state, spans), _along(by_covector, spans)

    return jax.vmap(one)(ways)


def _along(value: Any, spans: Array) -> Line:
    slope = jax.jvp(value, (jnp.zeros_like(spans[0]),), (jnp.ones_like(spans[0]),))[1]
    return Line(jax.vmap(value)(-spans), jax.vmap(value)(spans), slope)


def _moved(retraction: Retraction, q: Ambient, p: Ambient, way: Array) -> Ambient:
    """The covector moved, in units of the sizes of its coordinates."""
    frame = retraction.manifold.basis(q)
    return vec.add(p, vec.combine(frame, way * jnp.maximum(jnp.abs(vec.components(frame, p)), MOVE)))
