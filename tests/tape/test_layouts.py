"""Where numbers of points stand in memory that the machine reads and writes."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.tape import Tape

# Of some numbers: where that of the first of some points stands in memory, and how far the next is.
LAYOUTS = {
    "rows": lambda size, count: [(i, size) for i in range(size)],
    "columns": lambda size, count: [(i * count, 1) for i in range(size)],
    "rows with gaps": lambda size, count: [(i + i // 5, size + size // 5) for i in range(size)],
    "rows of two arrays": lambda size, count: [
        (i, 10) if i < 10 else (10 * count + i - 10, size - 10) for i in range(size)
    ],
}


@pytest.mark.parametrize(("given", "found"), list(zip(LAYOUTS, [*LAYOUTS][::-1], strict=True)))
def test_numbers_of_points_stand_anywhere_in_memory(given, found):
    """In groups of sixteen, of four, and alone; as many points as there are lanes, and not."""

    def mixed(x):
        return x[::-1] * jnp.arange(1.0, size + 1) - jnp.roll(x, 2)

    size = 31
    tape = Tape.trace(mixed, np.ones(size))
    for count in (*range(1, 10), 15, 64, 67, 130):
        sources, targets = (np.array(LAYOUTS[name](size, count)) for name in (given, found))
        inputs = np.random.default_rng(count).standard_normal(2 * size * count)
        outputs = np.full(2 * size * count, np.nan)
        tape.run(count, (inputs, sources, outputs, targets))
        x, y = (a[ends[:, :1] + ends[:, 1:] * np.arange(count)] for a, ends in ((inputs, sources), (outputs, targets)))
        expected = x[::-1] * np.arange(1.0, size + 1)[:, None] - np.roll(x, 2, axis=0)
        np.testing.assert_allclose(y, expected, rtol=1e-13, atol=1e-13)
        assert np.count_nonzero(np.isfinite(outputs)) == size * count
