"""Arrays in one vector are where kernels look for them."""

import numba
import numpy as np
import pytest
from retrax.integrators.boundary_value.engine.fields import Fields
from retrax.linked import array, laid

SHAPES = {"a": (2, 3), "none": (0, 4), "flags": (5,), "places": (3,), "b": (1, 2, 2)}
KINDS = {"flags": bool, "places": int}
FORM = (array(2), array(2)), array(1, numba.types.boolean), (array(1, numba.types.int64), array(3))


@pytest.mark.parametrize("lined", [False, True])
def test_what_is_laid_out_is_what_was_filled_in(lined):
    """Numbers, flags and integers, after rows of something else."""
    fields, lay = Fields(SHAPES, KINDS, lined), laid(FORM, 1)
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "none": np.zeros((0, 4)),
        "flags": np.array([True, False, True, True, False]),
        "places": np.array([7, -8, 9]),
        "b": np.array([[[1.5, 2.5], [3.5, 4.5]]]),
    }
    rows = np.concatenate([fields.rows([("b", (4,))]), fields.all_rows])

    @numba.njit
    def copied(numbers: np.ndarray, rows: np.ndarray) -> tuple:
        (a, none), flags, (places, b) = lay(numbers, rows)
        return a.copy(), none.copy(), flags.copy(), places.copy(), b.copy()

    numbers, v = fields.in_rows(3)
    for name, own in arrays.items():
        v[name][:] = ~own if own.dtype == bool else -own
        v[name][1] = own
    for found, expected in zip(copied(numbers[1], rows), arrays.values(), strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    if lined:
        assert all(begin % 8 == 0 for begin in fields.begins.values())


def test_an_array_in_another_shape():
    """The same numbers as a vector."""
    fields, lay = Fields(SHAPES, KINDS), laid(array(1))
    place = fields.place()
    place.v["b"][...] = [[[1.0, 2.0], [3.0, 4.0]]]

    @numba.njit
    def turned(numbers: np.ndarray, rows: np.ndarray) -> float:
        b = lay(numbers, rows)
        b[0] = 5.0
        return b.sum()

    assert turned(place.numbers, fields.rows([("b", (4,))])) == 14.0
    assert place.v["b"][0, 0, 0] == 5.0
