"""The lines that tests/mutation/equivalent.toml names are in the library."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_lines_of_equivalent_mutants_are_in_their_files():
    mutants = tomllib.loads((ROOT / "tests" / "mutation" / "equivalent.toml").read_text())["equivalent"]
    texts = {one["file"]: (ROOT / one["file"]).read_text() for one in mutants}
    lines = {file: {line.strip() for line in text.splitlines()} for file, text in texts.items()}
    gone = [(one["file"], one["line"]) for one in mutants if one["line"] not in lines[one["file"]]]
    assert not gone, f"renew or delete these: {gone}"
    assert all(one["mutant"] != one["line"] and one["reason"] for one in mutants)
