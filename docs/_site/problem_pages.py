"""Pages of the problems of the library, one for each, from what their records hold and from their solution."""

import importlib
import multiprocessing
import re
import shutil
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from retrax import plotting, problems
from retrax.integrators import Free
from retrax.problems import KnownProblem

SUBJECTS = {
    "geodesics": "Curves of least energy",
    "attitude": "Slews of a spacecraft",
    "vehicles": "Vehicles, rods, winds and obstacles",
    "machines": "Machines",
    "flat": "Problems in R^n",
    "control_limits": "Problems in R^n with limits",
    "flight": "Flight",
    "quantum": "Quantum systems",
}
UNITS = {"sqrt(l/g)": r"$\sqrt{l/g}$", "period / 2 pi": r"period$/2\pi$", "58.13 days": "58.13 days"}
UNITS["Larmor period / 2 pi"] = r"Larmor period$/2\pi$"
INDEX = """# Problem library

`retrax.problems` holds {count} optimal control problems from the literature, each with a page: equations, data, source,
optimum, code, and a comparison with the literature. See [problems with known answers](../problems.md) for their use.
"""


def write(folder: Path) -> None:
    """Write the page of each problem and the page that lists them."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    found = solutions(folder)
    for entry in problems.all():
        (folder / f"{entry.name}.md").write_text(page(entry, found[entry.name]))
    (folder / "index.md").write_text(index())


class Solved(NamedTuple):
    """What a page says of a solution with the default steps."""

    steps: int
    cost: float
    success: bool


def solutions(folder: Path) -> dict[str, Solved]:
    """Solutions and pictures of all problems, found by as many processes as there are processors."""
    names = problems.names()
    # Processes of their own: a process with threads of JAX must not be forked.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(mp_context=context, initializer=set_up) as processes:
        return dict(zip(names, processes.map(partial(solved, folder), names), strict=True))


def set_up() -> None:
    """Settings of a process that solves problems: double precision, and pictures without a window."""
    jax.config.update("jax_enable_x64", True)
    mpl.use("Agg")


def solved(folder: Path, name: str) -> Solved:
    """The solution of a problem, and its picture in the folder."""
    solution = problems.get(name).solve(accuracy=None, throw=False)
    plotting.histories(solution)[0].figure.savefig(folder / f"{name}.png", dpi=110)
    plt.close("all")
    return Solved(len(solution.times) - 1, float(solution.cost), bool(solution.success))


def index() -> str:
    """The page that lists the problems by subject, with links and optima."""
    lines = [INDEX.format(count=len(problems.names()))]
    for module, subject in SUBJECTS.items():
        entries = [entry for entry in problems.all() if entry.name in of_module(module)]
        lines += [f"## {subject}\n", "| name | problem | optimum | unit |", "|---|---|---|---|"]
        for entry in entries:
            unit = "" if entry.cost == "1" else units(entry.cost)
            lines.append(f"| [{entry.name}]({entry.name}.md) | {plain(entry.title)} | {optimum(entry)} | {unit} |")
        lines.append("")
    names = "\n".join(problems.names())
    return "\n".join(lines) + f"\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"


def of_module(module: str) -> set[str]:
    """The names of the problems that a module of the library makes."""
    made = vars(importlib.import_module(f"retrax.problems.{module}"))
    return {name for name in problems.names() if name.replace("-", "_") in made}


def page(entry: KnownProblem, solution: Solved) -> str:
    """The page of a problem."""
    title = entry.name.replace("-", " ").capitalize()
    equations = " \\\\\n".join(f"& {line}" for line in entry.equations)
    parts = [
        f"# {title}",
        f"{plain(sentence(entry.title))}.",
        f"$$\n\\begin{{aligned}}\n{equations}\n\\end{{aligned}}\n$$",
        "\n".join(data(entry)),
        "## Code",
        "```python\nimport jax\nfrom retrax import plotting, problems\n\n"
        'jax.config.update("jax_enable_x64", True)\n'
        f'solution = problems.get("{entry.name}").solve()\nplotting.histories(solution)\n```',
        f"![States and controls of {entry.name} over time]({entry.name}.png)",
        "## Optimum and literature",
        "\n".join(comparison(entry, solution)),
        f"Source: {plain(entry.source)}.",
        "[All problems](index.md)",
    ]
    return "\n\n".join(parts) + "\n"


def data(entry: KnownProblem) -> list[str]:
    """Rows with the states, the controls, the ends and the horizon."""
    unit = "" if entry.time == "1" else f" {units(entry.time)}"
    horizon = entry.horizon
    duration = f"free, guessed as {number(horizon.guess)}" if isinstance(horizon, Free) else number(horizon)
    rows = ["| | |", "|---|---|", f"| manifold | {latex_space(entry.problem.manifold)} |"]
    rows += [f"| state {symbols(key)} | {plain(words)} |" for key, words in entry.states.items() if words != "1"]
    rows += [f"| control {symbols(key)} | {plain(words)} |" for key, words in entry.controls.items() if words != "1"]
    rows += [f"| start | {point(entry.start)} |", f"| end | {point(entry.end)} |"]
    return [*rows, f"| horizon | {duration}{unit} |"]


def comparison(entry: KnownProblem, solution: Solved) -> list[str]:
    """Rows with the optimum, how it is known, and what the default steps of the library give."""
    unit = "" if entry.cost == "1" else f" {units(entry.cost)}"
    rows = ["| | |", "|---|---|", f"| optimum | {optimum(entry)}{unit}, {entry.digits} digits verified |"]
    if entry.formula:
        rows.append(f"| formula | ${entry.formula}$ |")
    rows.append(f"| how it is known | {plain(sentence(entry.origin))} |")
    method = plain(repr(entry.discretization).partition("(")[0])
    said = "converged" if solution.success else "not converged"
    off = f"{entry.distance(solution.cost):.0e} from the optimum"
    rows.append(f"| retrax, {solution.steps} steps of {method} | {solution.cost:.10g}, {off}, {said} |")
    refined = f" with `accuracy={entry.accuracy:g}`" if entry.accuracy else ""
    return [*rows, f"| error of `solve()`{refined} | at most {entry.error:.0e} |"]


def optimum(entry: KnownProblem) -> str:
    """The optimum with as many digits as are verified, ten at most."""
    return f"{entry.optimum:.{min(entry.digits, 10)}g}"


def sentence(text: str) -> str:
    """The text with a capital letter, unless it begins with a formula."""
    return text[0].upper() + text[1:] if re.match(r"[a-z]{2}|a ", text) else text


def plain(text: str) -> str:
    """The text with the signs of markup escaped, formulas as they are, and powers of spaces as formulas."""
    parts = re.split(r"(\$[^$]*\$)", text)
    parts[::2] = (re.sub(r"([|*_$<>])", r"\\\1", part) for part in parts[::2])
    parts[::2] = (re.sub(r"\b(T?[SR])\^(\d|n)\b", r"$\1^\2$", part) for part in parts[::2])
    return "".join(parts)


def units(text: str) -> str:
    """A unit with its powers set as such."""
    return UNITS.get(text) or "$\\mathrm{" + text.replace(" ", "\\,") + "}$"


def symbols(key: str) -> str:
    """Symbols as the equations have them."""
    one = re.sub(r"(\w)'", r"\\dot \1", key)
    one = re.sub(r"([a-zA-Z])_?(\d+|ij|(?<=v)[xy])\b", r"\1_{\2}", one)
    return f"${one}$"


def latex_space(manifold: Any) -> str:
    """The manifold as the library prints it, as a formula."""
    text = re.sub(r"\bR\^", r"\\mathbb R^", str(manifold)).replace(" x ", " \\times ").replace("*", "^*")
    return f"${text}$"


def point(value: Any) -> str:
    """An end: its arrays, or that it is free."""
    if value is None:
        return "free"
    if isinstance(value, tuple):
        return ", ".join(point(part) for part in value)
    array = np.asarray(value)
    if array.ndim < 2:
        cells = ", ".join(number(entry) for entry in array.reshape(-1))
        return f"$({cells})$" if array.size > 1 else f"${cells}$"
    if array.shape[0] == array.shape[1] and np.array_equal(array, np.eye(len(array))):
        return "$I$"
    return "$\\begin{pmatrix} " + " \\\\ ".join(" & ".join(map(number, row)) for row in array) + " \\end{pmatrix}$"


def number(value: Any) -> str:
    """A number with four digits at most, complex where it is."""
    real, imaginary = (round(float(part), 4) + 0.0 for part in (np.real(value), np.imag(value)))
    if not imaginary:
        return f"{real:.5g}"
    return f"{real:.5g} {imaginary:+.5g}i" if real else f"{imaginary:.5g}i"
