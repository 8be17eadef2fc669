"""The constants of a posed problem as C source, and the lines that depend on which arrays it has."""

from ctypes import sizeof
from textwrap import indent

import numpy as np

from ....compute.binding.block_elimination import block_workspace
from ....compute.binding.search import search_memory, wave_amplitudes
from ....compute.binding.structs import LayoutStruct, MultiphaseStruct, ProblemStruct
from .c_text import braces, constant, fill_template, number
from .function_source import functions_text, most_numbers, table_text
from .posed_problem import PosedProblem

ALIGNMENT = 64  # bytes, as in workspace.h
POINTER = 8  # bytes of the largest pointers
# Fields of a guess: the array of the core, the names of its lengths, and its contents.
FIELDS = {
    "centres": ("CENTRES", ("STEPS", "STATE_NUMBERS"), "states amid the steps"),
    "velocities": ("VELOCITIES", ("STEPS", "POINTS", "DIMENSION"), "of the points in the chart of their step"),
    "controls": ("CONTROLS", ("STEPS", "POINTS", "CONTROL_NUMBERS"), "at the points of the steps"),
    "point_costates": ("POINT_COSTATES", ("STEPS", "POINTS", "STATE_NUMBERS"), "multipliers of the dynamics there"),
    "costates": ("COSTATES", ("STEPS + 1", "STATE_NUMBERS"), "multipliers of the nodes"),
    "multipliers": ("LIMIT_MULTIPLIERS", ("MULTIPLIERS",), "of the inequalities; all zero where none is known"),
}
OF_COLLOCATION = "velocities", "point_costates"
LOOP = """\
add_executable(loop loop.c)
target_link_libraries(loop PRIVATE {0})
add_test(NAME loop COMMAND loop)"""
CONTROLLER_ROW = """\
| `{0}_controller.h`, `{0}_controller.c` | the receding horizon controller: `{0}_begin`, `{0}_step` |
| `loop.c` | an example of its loop, which a test runs too |
"""
GAINS_FIELD = """\
    /* Derivatives of the controls at the points of a step by the state at its first node: u + gains (q - state) is optimal
     * to first order, while the same limits hold. Rows belong to the basis of the controls. */
    double gains[@NAME@_STEPS][@NAME@_POINTS][@NAME@_CONTROL_DIMENSION][@NAME@_STATE_NUMBERS];
"""  # noqa: E501
METHODS = {
    False: "Controls, and the states that are called centres, stand inside the steps, one in each.",
    True: "Controls stand at the collocation points, @NAME@_POINTS in each step.",
}


def templates(posed: PosedProblem, name: str) -> dict[str, str]:
    """The texts that fill the templates."""
    upper, programs, bytes_ = name.upper(), posed.transcription.programs, _workspace_bytes(posed)
    inputs, outputs = most_numbers(programs)
    return {
        "name": name,
        "NAME": upper,
        "version": posed.words["version"],
        "title": posed.words["title"],
        "method": METHODS[posed.transcription.sizes.points > 1].replace("@NAME@", upper),
        "entries": _entries_text(posed),
        "free_start": _free_text(posed, "START"),
        "free_end": _free_text(posed, "END"),
        "horizon": posed.words["horizon"],
        "sizes": _sizes_text(posed, upper, bytes_),
        "workspace": str(bytes_),
        "guess": _guess_text(posed, upper),
        "parameters": _parameters_text(posed, upper),
        "constants": _constants_text(posed, name),
        "problem": _problem_text(posed),
        "write_input": _writing_text(posed, upper),
        "read_output": _reading_text(posed),
        "duration": _duration_text(posed),
        "strict": "found.strict",
        "gains": fill_template("gains.c", {"name": name, "NAME": upper}) if posed.gains else "",
        "read_gains": "    read_gains(own, &found, output);" if posed.gains else "",
        "gains_field": GAINS_FIELD.replace("@NAME@", upper) if posed.gains else "",
        "gains_bytes": str(_room(posed)[0]),
        "room_bytes": str(sum(_room(posed))),
        "function_count": str(len(table_text(programs).split("\n"))),
        "most_inputs": str(inputs),
        "most_outputs": str(outputs),
        "functions": functions_text(programs),
        "table": table_text(programs),
        "expected": _expected_text(posed),
    }


def files(posed: PosedProblem, name: str, loops: tuple[str, ...] = ()) -> dict[str, str]:
    """The texts of the files of the problem, by their names.

    ``loops``: the program of a controller, if there is one.
    """
    values = templates(posed, name)
    values |= {"controller": f"{name}_controller.c" if loops else "", "loop": LOOP.format(name) if loops else ""}
    values["controller_row"] = CONTROLLER_ROW.format(name) if loops else ""
    files = {f"{name}{ending}": f"problem{ending}" for ending in (".h", ".c", "_functions.h", "_functions.c")}
    files |= {other: other for other in ("CMakeLists.txt", "README.md", "main.c")}
    return {file: fill_template(template, values) for file, template in files.items()}


def _limits(posed: PosedProblem) -> int:
    return len(posed.shares)


def _shapes(posed: PosedProblem) -> dict[str, tuple[int, ...]]:
    """The fields of a guess that are not empty, with their shapes."""
    sizes = {name: value for name, (value, _) in _sizes(posed).items()}
    sizes["STEPS + 1"] = sizes["STEPS"] + 1
    shapes = {field: tuple(sizes[length] for length in lengths) for field, (_, lengths, _) in FIELDS.items()}
    absent = OF_COLLOCATION if posed.transcription.sizes.points == 1 else ()
    return {field: shape for field, shape in shapes.items() if np.prod(shape) and field not in absent}


def _guess_text(posed: PosedProblem, upper: str) -> str:
    """The fields of a guess."""
    rows = []
    for field in _shapes(posed):
        _, lengths, words = FIELDS[field]
        rows.append(f"    double {field}{''.join(f'[{upper}_{length}]' for length in lengths)}; /* {words} */")
    return "\n".join(rows)


def _lengths(shape: tuple[int, ...]) -> str:
    return "".join(f"[{length}]" for length in shape)


def _workspace_bytes(posed: PosedProblem) -> int:
    """Bytes of a workspace where pointers take 8 bytes; where they take fewer, it needs less."""
    structs = sizeof(ProblemStruct) + sizeof(LayoutStruct) + sizeof(MultiphaseStruct) + POINTER
    layout, search = posed.transcription.layout_memory, search_memory(posed.transcription, posed.max_iterations)
    functions = len(table_text(posed.transcription.programs).split("\n"))
    head = structs + POINTER + functions * 3 * POINTER + 8 * sum(most_numbers(posed.transcription.programs))
    return sum(-(-part // ALIGNMENT) * ALIGNMENT for part in (head, layout, search, sum(_room(posed)), ALIGNMENT))


def _room(posed: PosedProblem) -> tuple[int, int]:
    """Bytes of the arrays of the gains, and of their elimination."""
    if not posed.gains:
        return 0, 0
    sizes = posed.transcription.sizes
    n, z = sizes.state_size, sizes.state_size + sizes.points * sizes.control_size
    numbers = 2 * sizes.steps * z * n + 2 * (sizes.steps + 1) * n * n + 2 * z + 2 * n
    return -(-8 * numbers // ALIGNMENT) * ALIGNMENT, block_workspace(sizes.steps, n, z, n)


def _sizes(posed: PosedProblem) -> dict[str, tuple[int, str]]:
    """The sizes of the problem by their names, with words."""
    sizes = posed.transcription.sizes
    return {
        "STEPS": (sizes.steps, "steps"),
        "POINTS": (sizes.points, "points of a step"),
        "GIVEN_NUMBERS": (posed.given_numbers, "numbers of a state"),
        "STATE_NUMBERS": (sizes.state_numbers, "the same, with what the solver adds to a state"),
        "DIMENSION": (sizes.state_size, "of the manifold of states, with what the solver adds"),
        "CONTROL_NUMBERS": (sizes.control_numbers, "numbers of a control"),
        "CONTROL_DIMENSION": (sizes.control_size, "of the manifold of controls"),
        "PARAMETERS": (sizes.parameters, "numbers of the parameters"),
        "MULTIPLIERS": (_limits(posed), "multipliers of the inequalities"),
        "MAX_ITERATIONS": (posed.max_iterations, "the largest number of iterations"),
    }


def _sizes_text(posed: PosedProblem, upper: str, bytes_: int) -> str:
    sizes = {**_sizes(posed), "WORKSPACE_BYTES": (bytes_, "bytes of a workspace")}
    return "\n".join(f"    {upper}_{name} = {value}, /* {words} */" for name, (value, words) in sizes.items())


def _entries_text(posed: PosedProblem) -> str:
    """The comment on the order of the entries of states, controls, and multipliers."""
    rows = [(what, names) for what, names in posed.columns.items() if names]
    return "\n".join(f" *     {what}: {', '.join(names)}" for what, names in rows)


def _free_text(posed: PosedProblem, end: str) -> str:
    free = np.flatnonzero(posed.given[f"{end}_ENTRIES"][: posed.given_numbers] == 0.0).tolist()
    return f"free, and not read: entries {', '.join(map(str, free))}" if free else "all of it is prescribed"


def _parameters_text(posed: PosedProblem, upper: str) -> str:
    if not posed.transcription.sizes.parameters:
        return ""
    return f"    double parameters[{upper}_PARAMETERS]; /* {posed.words['parameters']} */\n"


def _constants_text(posed: PosedProblem, name: str) -> str:
    core, given = posed.transcription, posed.given
    (matrix, weights), added = core.tableau, slice(posed.given_numbers, None)
    place, sizes = "retrax_index", core.sizes
    definitions = [
        f"/* Tolerance of the residuals. */\nstatic const double tolerance = {number(posed.tolerance)};\n",
        constant("double", "step_fractions", posed.fractions, "Lengths of the steps, relative to the horizon."),
        constant("double", "start_entries", given["START_ENTRIES"], "1 where an entry of the start is prescribed."),
        constant("double", "end_entries", given["END_ENTRIES"], "The same of the end."),
        constant("double", "added_start", given["START"][added], "The start of what the solver adds to a state."),
        constant("double", "added_end", given["END"][added], "The same at the end."),
        constant("double", "fixed", given["FIXED"], "1 where an equation of a node counts."),
        constant("double", "limit_shares", posed.shares, "Weights of the inequalities, relative to their steps."),
        constant(place, "limit_steps", posed.limit_steps, "Steps that the inequalities belong to."),
        constant("double", "tableau_matrix", matrix, "Tableau of the method.") if sizes.points > 1 else "",
        constant("double", "tableau_weights", weights, "Weights of the points of a step."),
        constant(place, "columns", core.groups[0], "Columns of matrices that the entries of a state belong to."),
        constant(place, "arrays", core.groups[1], "Arrays that they belong to."),
        constant("double", "never_elastic", core.kept, "1 for a bound that no iterate leaves."),
        constant("double", "draws", wave_amplitudes(sizes).ravel(), "Waves by which a degenerate guess is perturbed."),
    ]
    if core.control_groups is not None:
        definitions += [
            constant(place, "control_columns", core.control_groups[0], "Columns of the entries of a control."),
            constant(place, "control_arrays", core.control_groups[1], "Arrays that they belong to."),
        ]
    return "\n".join([*filter(None, definitions), _default_input(posed, name)])


def _default_input(posed: PosedProblem, name: str) -> str:
    """The definition of the default input."""
    given, known = posed.given, slice(0, posed.given_numbers)
    rows = [f".start = {braces(given['START'][known])}", f".end = {braces(given['END'][known])}"]
    rows.append(f".horizon = {number(posed.horizon)}")
    if posed.transcription.sizes.parameters:
        rows.append(f".parameters = {braces(given['PARAMETERS'])}")
    guess = [f".{field} = {braces(given[FIELDS[field][0]].reshape(shape))}" for field, shape in _shapes(posed).items()]
    rows.append(f".guess = {_lines(guess)}")
    return f"const {name}_input {name}_default_input = {_lines(rows)};"


def _lines(fields: list[str]) -> str:
    """An initializer of some fields."""
    text = indent(",\n".join(fields), "    ")
    return f"{{\n{text}}}"


def _problem_text(posed: PosedProblem) -> str:
    """The fields of ``retrax_problem``."""
    transcription, sizes = posed.transcription, posed.transcription.sizes._asdict()
    curved = transcription.control_groups is not None
    fields = {name: str(value) for name, value in sizes.items()}
    if sizes["points"] > 1:
        fields["matrix"] = "&tableau_matrix[0][0]"
    fields |= {"weights": "tableau_weights", "columns": "columns", "arrays": "arrays"}
    if curved:
        fields |= {"curved_controls": "true", "control_columns": "control_columns", "control_arrays": "control_arrays"}
    if len(transcription.kept):
        fields["never_elastic"] = "never_elastic"
    fields["bounds"] = str(transcription.bounds)
    return "\n".join(f"        .{name} = {value}," for name, value in fields.items())


def _writing_text(posed: PosedProblem, upper: str) -> str:
    """The lines that write what is given and the guess."""
    rows = ["WRITE(input->start, START);", "WRITE(input->end, END);"]
    if posed.transcription.sizes.state_numbers > posed.given_numbers:
        for end in ("start", "end"):
            array = f"ARRAY({end.upper()}) + {upper}_GIVEN_NUMBERS"
            rows.append(f"memcpy({array}, added_{end}, sizeof(added_{end}));")
    rows += ["WRITE(start_entries, START_ENTRIES);", "WRITE(end_entries, END_ENTRIES);", "WRITE(fixed, FIXED);"]
    if posed.transcription.sizes.parameters:
        rows.append("WRITE(input->parameters, PARAMETERS);")
    if posed.transcription.sizes.node_costs:
        rows += [
            f"for (retrax_index k = 0; k < {upper}_STEPS; k++) {{",
            "    ARRAY(NODE_INDICES)[k] = (double)(k + 1);",
            "}",
        ]
    rows += [f"WRITE(input->guess.{field}, {FIELDS[field][0]});" for field in _shapes(posed)]
    if _limits(posed):
        rows += [
            f"for (retrax_index i = 0; i < {upper}_MULTIPLIERS; i++) {{",
            "    ARRAY(LIMIT_WEIGHTS)[i] = ARRAY(STEP_SIZE)[limit_steps[i]] * limit_shares[i];",
            "}",
        ]
    return "\n".join(f"    {row}" for row in rows)


def _reading_text(posed: PosedProblem) -> str:
    """The lines that read the unknowns of the solution."""
    return "\n".join(f"    READ(output->solution.{field}, {FIELDS[field][0]});" for field in _shapes(posed))


def _duration_text(posed: PosedProblem) -> str:
    """The duration of the trajectory of an output."""
    if posed.horizon_entry is None:
        return "input->horizon"
    return f"input->horizon * exp(output->states[0][{posed.horizon_entry}] - {number(posed.at_guess)})"


def _expected_text(posed: PosedProblem) -> str:
    numbers = {"cost": posed.cost, "horizon": posed.duration}
    return "\n".join(
        [
            f"static const double expected_states{_lengths(posed.states.shape)} = {braces(posed.states)};",
            *(f"static const double expected_{name} = {number(value)};" for name, value in numbers.items()),
        ]
    )
