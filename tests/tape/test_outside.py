"""Entries at places that the input says, inside and outside of tables: what JAX gives there, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.tape import Tape

VECTOR = jnp.array([1.0, 2.0, -1.5])
MATRIX = jnp.arange(12.0).reshape(4, 3) - 5.0
COMPLEX = jnp.array([1 + 2j, 3j, -1.0])


def part(z):
    return jnp.real(z) + 2 * jnp.imag(z)


def by_xla(function, points):
    """Values and derivatives at points, as arrays of NumPy: one program."""
    return jax.device_get(jax.jit(jax.vmap(lambda x: (function(x), jax.jacfwd(function)(x)), -1, -1))(points))


# Functions of a table and a place.
READ = {
    "fill": lambda t, i: t.at[i].get(mode="fill", fill_value=0.5),
    "fill with NaN": lambda t, i: t.at[i].get(mode="fill"),
    "take": jnp.take,
    "take rows": lambda t, i: jnp.take(t, i, axis=0),
    "take columns": lambda t, i: jnp.take(t, i, axis=-1),
    "take and fill": lambda t, i: jnp.take(t, i, axis=0, mode="fill", fill_value=-2.0),
    "take several": lambda t, i: jnp.take(t, jnp.stack([i, jnp.ones_like(i), i + 1]), axis=0),
    "take and clip": lambda t, i: jnp.take(t, i, axis=0, mode="clip"),
    "take and wrap": lambda t, i: jnp.take(t, i, axis=0, mode="wrap"),
    "wrap none": lambda t, i: t.at[i].get(mode="fill", fill_value=0.5, wrap_negative_indices=False),
    "two places": lambda t, i: t.at[i, ..., -i].get(mode="fill", fill_value=0.5) if t.ndim > 1 else t[i],
    "index": lambda t, i: t[i],
}
TABLES = {"vector": VECTOR, "matrix": MATRIX, "complex": COMPLEX}
WHOLE = jnp.array([4, 7, -2])


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("name", READ)
@pytest.mark.usual(2)
def test_places_through_both_ends_of_a_table_give_what_jax_gives(name, table):
    read, entries = READ[name], TABLES[table]
    size = entries.size if name == "take" else max(entries.shape)
    # Places a little after whole numbers, from before where negative ones count from the end to behind the end.
    places = np.arange(-size - 3, size + 3)
    points = np.stack([places + np.where(places < 0, -0.25, 0.25), np.linspace(0.5, 1.5, len(places))])

    def known(x):
        return part(read(entries, x[0].astype(int))) * x[1]

    def scaled(x):
        return part(read(jnp.sin(x[1]) * entries, x[0].astype(int)))

    for function in (known, scaled):
        tape = Tape.trace(function, points[:, 0])
        values, slopes = by_xla(function, points)
        np.testing.assert_allclose(tape(points), values, rtol=1e-14)
        found = tape.jacobian()(points).reshape(slopes.shape)
        # By the place every slope is zero: JAX multiplies zero by the entries, and has NaN where they are.
        np.testing.assert_array_equal(found[..., 0, :], 0.0)
        found[..., 0, :] = np.where(np.isnan(slopes[..., 0, :]), np.nan, 0.0)
        np.testing.assert_allclose(found, slopes, rtol=1e-14, atol=1e-15)


def test_whole_numbers_and_known_places_are_filled_as_jax_fills_them():
    def function(x):
        i = x[0].astype(int)
        rows = jax.vmap(lambda row, k: row.at[k].get(mode="fill", fill_value=3.0))(jnp.outer(x, x), jnp.stack([i, -i]))
        return x[1] * WHOLE.at[i].get(mode="fill", fill_value=9) + rows + x[1] * WHOLE.at[5].get(mode="fill")

    points = np.stack([np.arange(-6, 7) * 1.125, np.linspace(0.5, 1.5, 13)])
    tape = Tape.trace(function, points[:, 0])
    np.testing.assert_allclose(tape(points), jax.vmap(function, -1, -1)(points), rtol=1e-14)
    slopes = jax.vmap(jax.jacfwd(function), -1, -1)(points)
    np.testing.assert_allclose(tape.jacobian()(points), slopes, rtol=1e-14)
