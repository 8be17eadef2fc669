"""Random programs of tapes, and a plain interpreter of them that runs one instruction after the other in NumPy."""

import ctypes
import ctypes.util

import numpy as np
from retrax.tape.instructions import CODES, NAMES, OPERANDS
from retrax.tape.program import FOUR, Program

ARGUMENTS = {
    **dict.fromkeys(NAMES[CODES["IF_ELSE_ZERO"] : CODES["NEG"]], 2),
    **dict.fromkeys(NAMES[CODES["NEG"] :], 1),
    **dict.fromkeys(("ADD", "SUB", "MUL", "DIV"), 2),
    **dict.fromkeys(("MUL_ADD", "MUL_SUB", "SUB_MUL", "ADD_ADD", "SELECT"), 3),
    **dict.fromkeys(("MUL_ADD_ADD", "TWO_MUL", "MUL_SUB_MUL"), 4),
    "TWO_MUL_ADD": 5,
    "THREE_MUL": 6,
    "THREE_MUL_ADD": 7,
    "CONST": 0,
    **dict.fromkeys(("ADD_CONST", "MUL_CONST", "CONST_SUB", "CONST_DIV", "STATE", "NEXT", "OUTPUT", "REPEAT"), 1),
}
# Those that stand anywhere; COPYSIGN would show the sign of NaN, which processors choose.
FREE = [name for name in ARGUMENTS if name not in ("STATE", "NEXT", "OUTPUT", "REPEAT", "COPYSIGN")]
HARD = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e308, -1e308, 5e-324, 0.5, -2.5]


class _Writer:
    """Instructions that read only what is written before them; ``kept``: registers that stay."""

    kept = ()

    def __init__(self, rng, size):
        self.rng, self.size = rng, size
        self.codes, self.registers, self.values, self.known = [], [], [], []

    def add(self, name, operands=(), value=0.0, to=None):
        if to is None and name not in ("OUTPUT", "LOOP", "REPEAT"):
            to = self.rng.choice([r for r in range(self.size) if r not in operands and r not in self.kept])
            self.known.append(int(to))
        self.codes.append(CODES[name])
        self.registers.append([to or 0, *operands, *[0] * (OPERANDS - len(operands))])
        self.values.append(value)

    def free(self, count):
        for _ in range(count):
            name = str(self.rng.choice(FREE))
            self.add(name, [int(k) for k in self.rng.choice(self.known, ARGUMENTS[name])], number(self.rng))

    def loop(self):
        state = [int(k) for k in self.rng.choice(self.known, 2, replace=False)]
        first = len(self.codes)
        for _ in state:
            self.add("STATE", [int(self.rng.choice(self.known))])
        state = [self.registers[k][0] for k in (first, first + 1)]
        self.kept = tuple(state)
        self.add("LOOP", value=float(self.rng.integers(1, 6)))
        begin = len(self.codes)
        self.free(6)
        new = [int(self.rng.choice([k for k in self.known if k not in state])) for _ in state]
        for to, k in zip(state, new, strict=True):
            self.add("NEXT", [k], to=to)
        self.kept = ()
        self.add("REPEAT", [int(self.rng.choice(self.known))], float(begin))


def number(rng):
    """A number that may be infinite or none."""
    return float(rng.choice(HARD)) if rng.random() < 0.3 else float(rng.normal())


def random_program(rng, length=30):
    """A program of some inputs, outputs, and loops."""
    inputs, outputs = int(rng.integers(2, 12)), int(rng.integers(1, 12))
    own = _Writer(rng, size=inputs + int(rng.integers(10, 20)))
    for place in range(inputs):
        own.add("INPUT", value=float(place), to=place)
        own.known.append(place)
    own.free(length)
    for _ in range(int(rng.integers(0, 3))):
        own.loop()
        own.free(3)
    for place in range(outputs):
        own.add("OUTPUT", [int(rng.choice(own.known))], float(place))
    registers = np.array(own.registers, np.uint32)
    for begin, count in ((0, inputs), (len(own.codes) - outputs, outputs)):
        for k in range(begin, begin + count - FOUR + 1, FOUR):
            registers[k, 2] = FOUR if rng.random() < 0.7 else 0
    return Program(np.array(own.codes, np.uint8), registers, np.array(own.values), inputs, outputs, own.size)


def _of_libm(name):
    function = getattr(ctypes.CDLL(ctypes.util.find_library("m")), {"CONSTPOW": "pow"}.get(name, name.lower()))
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * ARGUMENTS.get(name, 3)
    return lambda v, *arguments: np.array([function(*point) for point in zip(*arguments, strict=True)])


TWO_NUMBERS = ("POW", "CONSTPOW", "FMOD", "COPYSIGN", "ATAN2", "HYPOT")


def _products(fused):
    """Instructions of products and sums, by ``fused(x, y, z)``, which is ``x y + z``, rounded once or twice."""
    return {
        "MUL_ADD": lambda v, x, y, z: fused(x, y, z),
        "MUL_SUB": lambda v, x, y, z: fused(x, y, -z),
        "SUB_MUL": lambda v, x, y, z: fused(-x, y, z),
        "MUL_ADD_ADD": lambda v, x, y, z, t: fused(x, y, z) + t,
        "TWO_MUL": lambda v, x, y, z, t: fused(z, t, x * y),
        "TWO_MUL_ADD": lambda v, x, y, s, z, t: fused(z, t, fused(x, y, s)),
        "MUL_SUB_MUL": lambda v, x, y, z, t: fused(z, t, -(x * y)),
        "THREE_MUL": lambda v, x, y, z, t, q, r: fused(q, r, fused(z, t, x * y)),
        "THREE_MUL_ADD": lambda v, x, y, s, z, t, q, r: fused(q, r, fused(z, t, fused(x, y, s))),
    }


# What each instruction computes of its constant and its arguments; products and sums are rounded each.
MEANING = {
    **{name: _of_libm(name) for name in (*TWO_NUMBERS, "FLOOR", "CEIL", *NAMES[CODES["SIN"] :])},
    "ADD": lambda v, x, y: x + y,
    "SUB": lambda v, x, y: x - y,
    "MUL": lambda v, x, y: x * y,
    "DIV": lambda v, x, y: x / y,
    **_products(lambda x, y, z: x * y + z),
    "ADD_ADD": lambda v, x, y, z: x + y + z,
    "ADD_CONST": lambda v, x: x + v,
    "MUL_CONST": lambda v, x: x * v,
    "CONST_SUB": lambda v, x: v - x,
    "CONST_DIV": lambda v, x: v / x,
    "SELECT": lambda v, x, y, z: np.where(x != 0, y, z),
    "IF_ELSE_ZERO": lambda v, x, y: np.where(x != 0, y, 0.0),
    "STATE": lambda v, x: x,
    "NEXT": lambda v, x: x,
    "ASSIGN": lambda v, x: x,
    "LT": lambda v, x, y: 1.0 * (x < y),
    "LE": lambda v, x, y: 1.0 * (x <= y),
    "EQ": lambda v, x, y: 1.0 * (x == y),
    "NE": lambda v, x, y: 1.0 * (x != y),
    "AND": lambda v, x, y: 1.0 * ((x != 0) & (y != 0)),
    "OR": lambda v, x, y: 1.0 * ((x != 0) | (y != 0)),
    "NOT": lambda v, x: 1.0 * (x == 0),
    "FMIN": lambda v, x, y: np.where((x < y) | np.isnan(y), x, y),
    "FMAX": lambda v, x, y: np.where((x > y) | np.isnan(y), x, y),
    "NEG": lambda v, x: -x,
    "SQ": lambda v, x: x * x,
    "TWICE": lambda v, x: x + x,
    "SQRT": lambda v, x: np.sqrt(x),
    "INV": lambda v, x: 1.0 / x,
    "FABS": lambda v, x: np.abs(x),
    "SIGN": lambda v, x: np.where(x > 0, 1.0, np.where(x < 0, -1.0, x)),
}

FUSED_MEANING = MEANING | _products(lambda *arguments: _of_libm("FMA")(None, *arguments))


@np.errstate(all="ignore")
def interpreted(program, inputs, fused=False):
    """Outputs of a program, shape ``(points, outputs)``, all points being one lane; it works for every program.

    ``fused``: a product and a sum are rounded once.
    """
    meaning = FUSED_MEANING if fused else MEANING
    registers, outputs = np.full((program.size, len(inputs)), np.nan), np.empty((len(inputs), program.outputs))
    k = left = 0
    while k < len(program.codes):
        name, value, (to, *operands) = NAMES[program.codes[k]], program.values[k], program.registers[k].tolist()
        if name == "INPUT":
            registers[to] = inputs[:, int(value)]
        elif name == "OUTPUT":
            outputs[:, int(value)] = registers[operands[0]]
        elif name == "CONST":
            registers[to] = value
        elif name == "LOOP":
            left = int(value)
        elif name == "REPEAT":
            left -= 1
            if left > 0 and (registers[operands[0]] == 0).any():
                k = int(value) - 1
        else:
            registers[to] = meaning[name](value, *(registers[i] for i in operands[: ARGUMENTS[name]]))
        k += 1
    return outputs


def assert_same_numbers(found, expected):
    """The numbers are the same to the last bit; NaN has no sign."""
    np.testing.assert_array_equal(found, expected)
    numbers = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found)[numbers], np.signbit(expected)[numbers])
