"""Hamiltonians whose derivatives do not tell how they change."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.jit_cache import call_compiled
from ....index_bounds import require_indices
from ....manifolds import InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import working_precision
from ....retractions import Retraction
from ....tracing import one_tracing
from ...problem.user_functions import real_number
from ...stages.hamiltonian import Hamiltonian
from .derivative_check import (
    DIFFERENCE_SPANS,
    POINT_DISTANCE,
    RANDOM_BASES,
    Line,
    median_missed_share,
    moved_along,
    own_rules,
)
from .step_primitives import program_of


def require_correct_hamiltonian_derivatives(
    hamiltonian: Hamiltonian, retraction: Retraction, q: Ambient, p: Ambient
) -> None:
    """Raise if a Hamiltonian reads entries that its arguments do not have, or changes near ``(q, p)`` in a way that its
    derivative does not tell."""

    def read() -> tuple[list[str], Hamiltonian]:
        program = program_of(hamiltonian, q, p)
        require_indices(program, "the Hamiltonian")
        return own_rules(program), hamiltonian

    with one_tracing() as reading:
        found = reading.once(("rules of", id(hamiltonian)), read)[0]
    if not found:
        return
    draw, kind = np.random.default_rng(0).standard_normal, working_precision()
    ways = draw((RANDOM_BASES, 2, 2, retraction.manifold.dimension)).astype(kind)
    lines: Any = jax.tree.map(
        np.asarray, call_compiled(_lines, hamiltonian, retraction, q, p, ways, DIFFERENCE_SPANS.astype(kind))[0]
    )
    for about, line in zip(("states", "momenta"), lines, strict=True):
        wrong = float(median_missed_share(line)[0])
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
        base, covector = (
            moved_along(retraction, q, POINT_DISTANCE * way[0, 0]),
            _move(retraction, q, p, POINT_DISTANCE * way[0, 1]),
        )
        by_state, by_covector = (
            lambda s: real_number(
                "the Hamiltonian", hamiltonian(moved_along(retraction, base, s * way[1, 0]), covector)
            )[None],
            lambda s: real_number(
                "the Hamiltonian", hamiltonian(base, _move(retraction, base, covector, s * way[1, 1]))
            )[None],
        )
        return _along(by_state, spans), _along(by_covector, spans)

    return jax.vmap(one)(ways)


def _along(value: Any, spans: Array) -> Line:
    slope = jax.jvp(value, (jnp.zeros_like(spans[0]),), (jnp.ones_like(spans[0]),))[1]
    return Line(jax.vmap(value)(-spans), jax.vmap(value)(spans), slope)


def _move(retraction: Retraction, q: Ambient, p: Ambient, way: Array) -> Ambient:
    """The covector moved, in units of the sizes of its coordinates."""
    frame = retraction.manifold.basis(q)
    return vec.add(p, vec.combine(frame, way * jnp.maximum(jnp.abs(vec.components(frame, p)), POINT_DISTANCE)))
