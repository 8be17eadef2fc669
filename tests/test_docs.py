"""The code of the documentation runs as it stands, page by page, and prints what the pages say."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import pytest
from retrax import Cayley, Euclidean, Midpoint, OptimalControlProblem, manifolds, problems, retractions, solve
from retrax.integrators.boundary_value.solution.report import report_text
from retrax.retractions import families

from tests.support.pages import Pages

ROOT = Path(__file__).parents[1]
SLOW = (
    "README.md",
    "accuracy.md",
    "boundary_conditions.md",
    "conformance.md",
    "constraints.md",
    "conventions.md",
    "dirac.md",
    "estimation.md",
    "feedback.md",
    "from_casadi.md",
    "from_geometry.md",
    "integration.md",
    "integration_batches.md",
    "minimum_time.md",
    "new_manifold.md",
    "obstacles.md",
    "optimal_control.md",
    "own_manifold.md",
    "paper.md",
    "paper_control.md",
    "parameter_studies.md",
    "phases.md",
    "pictures.md",
    "problems.md",
    "receding_horizon.md",
    "several_bodies.md",
    "singular.md",
    "sweeps.md",
    "warm_starts.md",
)
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path, language: str) -> list[str]:
    """Fenced blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)


def marked(page: Path):
    return pytest.param(page, id=page.name, marks=[pytest.mark.slow] if page.name in SLOW else [])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tests_and_files_that_a_page_names_exist(page):
    """``tests/a/test_b.py::test_c`` in a page, a file of the repository, and what the README links to."""
    text = page.read_text()
    for path, name in re.findall(r"`((?:tests|examples|retrax/testing)/[\w/]+\.py)(?:::(\w+))?`", text):
        file = ROOT / path if not path.startswith("retrax/") else ROOT / "src" / path
        assert file.exists(), path
        assert not name or f"def {name}(" in file.read_text(), f"{path} has no {name}"
    for target in re.findall(r"\]\((?!https?:)([^)#\s]+)", text):
        assert (page.parent / target).exists(), target


def test_the_page_of_manifolds_has_all_of_them_with_their_retractions():
    rows = re.findall(r"^\| `(\w+\([^`]*\))`.*\|([^|]*)\|$", (ROOT / "docs" / "manifolds.md").read_text(), re.MULTILINE)
    names = {**vars(manifolds), "M": manifolds.Sphere(2), "c": lambda x: x[:1]}
    here = {name: eval(name, names) for name, _ in rows}
    for name, words in rows:
        known = [family.name for family in families.FAMILIES if family.knows(here[name])]
        assert re.findall("Exponential|Projection|Cayley|Polar|QR", words) == known or "retractions of `M`" in words, (
            name
        )
    given = {type(manifold).__name__ for manifold in here.values()}
    public = [
        kind for kind in vars(manifolds).values() if inspect.isclass(kind) and issubclass(kind, manifolds.Manifold)
    ]
    others = {"Product", *(kind.__name__ for kind in public if inspect.isabstract(kind))}  # in other words
    assert given | others == {kind.__name__ for kind in public}


def texts() -> str:
    """All texts of the library, with ``...`` in the place of what is filled in."""
    found = []
    for room in ("manifolds", "retractions", "integrators", "src/retrax"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.JoinedStr):
                    found.append(
                        "".join(part.value if isinstance(part, ast.Constant) else "..." for part in node.values)
                    )
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.append(node.value)
    return "\n".join(found)


def test_messages_of_the_troubleshooting_page_are_those_of_the_library():
    rows = re.findall(r"^\| `((?:[^`])+)` \|", (ROOT / "docs" / "troubleshooting.md").read_text(), re.MULTILINE)
    messages = [row.replace("\\|", "|") for row in rows if " " in row]
    library = texts()
    assert len(messages) > 30
    missing = [message for message in messages if not re.search(re.escape(message).replace(r"\.\.\.", ".*"), library)]
    assert not missing, missing


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.name)
def test_a_page_has_six_screens_at_most_and_code_of_80_columns(page):
    lines = page.read_text().splitlines()
    assert sum(max(1, -(-len(line) // 100)) for line in lines) <= 6 * 60
    assert [line for block in blocks(page, "python") for line in block.splitlines() if len(line) > 80] == []


def test_words_of_the_field_are_headings_and_index_entries_of_their_pages(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_site"))
    search = importlib.import_module("search")
    texts = {
        page.stem: re.sub(r"^```python\n.*?^```", "", page.read_text(), flags=re.DOTALL | re.M) for page in PAGES[1:]
    }
    headings = {title: name for name, text in texts.items() for title in re.findall(r"^#+ (.*)$", text, re.M)}
    entries = {
        entry.strip().removeprefix("! "): (name, entry.strip().startswith("! "))
        for name, text in texts.items()
        for line in re.findall(r"^```{index} (.*)$", text, re.M)
        for entry in line.split(",")
    }
    for word, page in search.WORDS.items():
        assert entries.get(word) == (page, True), word
        assert any(word.lower() in title.lower() and name == page for title, name in headings.items()), word
    docnames = [*texts]
    index = {
        "docnames": docnames,
        "alltitles": {title: [[docnames.index(name), ""]] for title, name in headings.items()},
        "indexentries": {text: [[docnames.index(name), "", main]] for text, (name, main) in entries.items()},
    }
    assert search.missed(index) == []
    assert search.missed({**index, "indexentries": {}, "alltitles": {}})


def test_the_glossary_has_the_quantities_of_the_solver_once_each():
    rows = re.findall(r"^\| ([^|]+) \|", (ROOT / "docs" / "glossary.md").read_text(), re.MULTILINE)
    terms = [term for row in rows for term in row.split(", ") if term not in ("term", "---")]
    assert len(terms) == len(set(terms)) > 100
    needed = (
        "defect, tangential defect, constraint values, elastic excess, penalty, elastic mode, slack, fraction to the "
        "boundary, step cap, trial point, iteration, regularisation, inertia correction, scaling, rescaling, "
        "control range, magnitudes, transcription, transcribed problem, boundary data, reformulation, termination "
        "status, audit, constraint qualification, linkage, bordered system, condensing, pullback, pushforward, "
        "globalisation, predicted reduction, perturbed guess, diverging, converged, batch"
    )
    assert set(needed.split(", ")) <= set(terms)


def test_links_that_lead_nowhere_are_found(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_site"))
    links = importlib.import_module("links")
    first, second = tmp_path / "first.html", tmp_path / "second.html"
    first.write_text(
        '<a id="here"></a><a href="#here"></a><a href="second.html#there"></a><a href="https://elsewhere#"></a>'
    )
    second.write_text(
        '<p id="there"></p><a href="first.html#gone"></a><a href="third.html"></a><a href="first.html"></a>'
    )
    found, count = links.broken(tmp_path, [first, second])
    assert count == 5
    assert [words.partition(",")[0] for words in found] == [
        "second.html links to first.html#gone",
        "second.html links to third.html",
    ]


def test_pages_of_the_gallery_show_no_times_of_the_computer(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_site"))
    gallery = importlib.import_module("gallery")
    plane = Euclidean(2)
    problem = OptimalControlProblem(plane, lambda q, u: u, lambda q, u: u @ u / 2, 2)
    found = solve(problem, [0.0, 0.0], [1.0, 0.0], 1.0, method=Midpoint(Cayley(plane)), steps=3)
    report = report_text(found)
    assert " ms to run" in report
    for name, expected in (("examples/slew", 1), ("start", 0)):
        source = [f"page\n\n{report}\nend"]
        gallery.process(None, name, source)
        assert len(f"page\n\n{report}\nend".splitlines()) - len(source[0].splitlines()) == expected
        assert (" ms to run" in source[0]) == (not expected)
        assert "iterations" in source[0]
        assert "horizon" in source[0]


def test_the_pages_that_use_a_name_are_found(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_site"))
    uses = importlib.import_module("uses")
    code = (
        "from retrax import plotting as p\nfrom retrax.manifolds import SO as G, hat\np.path(G(3)); p.path(x); "
        "other.path(G)"
    )
    assert uses.count(code) == {("plotting", "path"): 2, ("manifolds", "SO"): 2}
    code = "import retrax as rx\nrx.SO(3); rx.solve(x).states.SO; rx.plotting.path(rx.hat(x)); rx.load(x)"
    expected = [("manifolds", "SO"), ("integrators", "solve"), ("plotting", "path"), ("manifolds", "hat")]
    assert uses.count(code) == dict.fromkeys(expected, 1)
    assert "/singular" in uses.used("integrators", "classify")
    assert uses.used("integrators", "SO") == []


def test_every_retraction_is_in_the_table_of_the_site(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_site"))
    tables = importlib.import_module("tables")
    shown = {type(made) for manifold in tables.EXAMPLES for made in tables.retractions(manifold)}
    of_any_manifold = {
        *("BundleRetraction", "LevelSetProjection", "Orthographic", "PowerRetraction", "ProductRetraction"),
        *("ProjectionByNewton", "SecondOrder", "RestoredAfter", "Translated"),
    }
    public = {name: getattr(retractions, name) for name in retractions.__all__}
    kinds = {
        name for name, kind in public.items() if inspect.isclass(kind) and issubclass(kind, retractions.Retraction)
    }
    concrete = {name for name in kinds if not inspect.isabstract(public[name])}
    assert concrete - {kind.__name__ for kind in shown} == of_any_manifold


def test_pages_of_problems_set_the_formulas_of_their_records(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_site"))
    pages = importlib.import_module("problem_pages")
    assert pages.plain("a|b in R^2: $u_1 = |v|$") == r"a\|b in $R^2$: $u_1 = |v|$"
    for entry in problems.all():
        assert not re.search(r"=|\^|\b(sqrt|exp|pi)\b", re.sub(r"\$[^$]*\$", "", entry.origin)), entry.name


@pytest.fixture(scope="module")
def pages():
    running = Pages()
    yield running
    running.close()


@pytest.mark.parametrize("page", [marked(page) for page in PAGES if blocks(page, "python")])
def test_the_code_of_a_page_runs_and_prints_what_the_page_says(page, pages, tmp_path):
    if page.name == "several_bodies.md":
        pytest.importorskip("frax", reason="the extra bodies is not installed")
    text, error = pages.run("\n".join(blocks(page, "python")), tmp_path)  # pages write files
    assert not error
    for shown in blocks(page, "text"):
        pattern = re.escape(shown.strip()).replace(re.escape("..."), ".*")
        assert re.search(f"^{pattern}$", text, re.MULTILINE), f"expected\n{shown}\nin\n{text}"


@pytest.mark.slow
def test_a_page_has_names_and_settings_of_its_own(pages, tmp_path):
    change = "import jax\njax.config.update('jax_enable_x64', True)\nkept = jax.numpy.ones(1)\nprint(kept.dtype)"
    assert pages.run(change, tmp_path) == ["float64\n", ""]
    assert pages.run("import jax\nprint(jax.numpy.ones(1).dtype)", tmp_path) == ["float32\n", ""]
    text, error = pages.run("print(1)\nkept", tmp_path)
    assert text == "1\n"
    assert error.endswith("NameError: name 'kept' is not defined\n")
