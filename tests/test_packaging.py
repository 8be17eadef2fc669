"""The package that is installed is the folders of the repository, layered downward, importable under one name only."""

import ast
import importlib
import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import retrax

ROOT = Path(__file__).parents[1]
LAYERS = ("manifolds", "retractions", "integrators")
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())


def folders_with_code() -> set[str]:
    """Import names of all folders of the layers and of the front door that hold modules."""
    names = {
        f"retrax.{path.parent.relative_to(ROOT).as_posix().replace('/', '.')}"
        for layer in LAYERS
        for path in (ROOT / layer).rglob("*.py")
    }
    front = ROOT / "src" / "retrax"
    inner = {path.parent.relative_to(front).as_posix() for path in front.rglob("*.py")}
    return names | {"retrax" if name == "." else f"retrax.{name.replace('/', '.')}" for name in inner}


def test_every_folder_is_packaged():
    assert set(SETTINGS["tool"]["setuptools"]["packages"]) == folders_with_code()


def test_the_version_is_the_distribution_s():
    assert retrax.__version__ == importlib.metadata.version("retrax")


def test_the_oldest_versions_that_are_tested_are_those_that_are_claimed():
    project = SETTINGS["project"]
    claims = project["dependencies"] + [claim for extra in project["optional-dependencies"].values() for claim in extra]
    parts = [re.split(r"(?:\[\w+\])?>=|[,;]", claim)[:2] for claim in claims]
    lines = [line for line in (ROOT / "tests" / "oldest.txt").read_text().splitlines() if not line.startswith("#")]
    tested = dict(line.split("==") for line in lines)
    assert {(name, version) for name, version in parts if name in tested} == {*tested.items()} - {
        ("pyparsing", "3.1.4")
    }
    assert {name for name, _ in parts[: len(project["dependencies"])]} <= {*tested}


def test_the_package_is_typed():
    assert (Path(retrax.__file__).parent / "py.typed").exists()


def imported_layers(path: Path, layer: str) -> set[str]:
    """Layers, other than its own, that a module imports."""
    depth = len(path.relative_to(ROOT / layer).parts)
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            name = node.module or ""
            if node.level == depth + 1:
                found.add(name.split(".")[0])
            elif node.level == 0 and name.startswith("retrax"):
                found.add([*name.split("."), ""][1])
        elif isinstance(node, ast.Import):
            found |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("retrax.")}
    return found & set(LAYERS)


@pytest.mark.parametrize("layer", LAYERS)
def test_imports_point_downward(layer):
    below = set(LAYERS[: LAYERS.index(layer)])
    for path in (ROOT / layer).rglob("*.py"):
        above = imported_layers(path, layer) - below - {layer}
        assert not above, f"{path.relative_to(ROOT)} imports {above}"


def test_the_tape_stands_below_the_layers():
    modules = (ROOT / "src" / "retrax" / "tape").rglob("*.py")
    nodes = [node for path in modules for node in ast.walk(ast.parse(path.read_text()))]
    beside = (
        "compute.binding.tape_machine",
        "newton_constants",
        "jaxpr_tools",
        "errors",
        "constant_folding",
        "tracing",
        "compute.threads",
    )
    assert not [
        n for n in nodes if isinstance(n, ast.ImportFrom) and n.level > 1 and n.module not in (*beside, "undisturbed")
    ]
    assert not [node for node in nodes if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("retrax")]


IMPORTING = """
import sys
import jax
before = dict(jax.config.values)
import retrax
print(dict(jax.config.values) == before)
import retrax.integrators
print(*sorted({"casadi"} & set(sys.modules)))
"""


@pytest.fixture(scope="module")
def imported():
    """Whether the settings of JAX are unchanged in a new process that imports the project, and what it has not to
    import."""
    run = subprocess.run([sys.executable, "-c", IMPORTING], capture_output=True, text=True, check=True, timeout=120)
    return run.stdout.split("\n")[:2]


def test_importing_retrax_does_not_import_casadi(imported):
    assert imported[1] == ""


def test_the_downward_test_sees_an_upward_import(tmp_path):
    assert imported_layers(ROOT / "integrators" / "boundary_value" / "inputs" / "inputs.py", "integrators") >= {
        "manifolds",
        "retractions",
    }


@pytest.mark.parametrize("layer", LAYERS)
def test_a_bare_import_says_what_to_import(layer):
    process = subprocess.run(
        [sys.executable, "-c", f"import {layer}"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=120
    )
    assert process.returncode != 0
    assert f"retrax.{layer}" in process.stderr


def test_importing_changes_no_setting_of_jax(imported):
    assert imported[0] == "True"


def test_public_names_exist():
    for layer in LAYERS:
        module = importlib.import_module(f"retrax.{layer}")
        assert len(set(module.__all__)) == len(module.__all__)
        for name in module.__all__:
            assert getattr(module, name).__doc__, name
