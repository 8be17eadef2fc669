"""Draws mutants of the library, and counts how many of them the fast tests notice.

``python tests/mutation/run.py --count 300 --seed 1`` prints a line for each mutant, those that no test notices, and the
share of the others. A mutant is noticed where a test fails that runs the changed line; a test that does not end has not
noticed. ``--part K/M``: every M-th mutant, from the K-th on. ``--map FOLDER``: what each test runs, measured there by a
first run. Mutants that change nothing that anybody can see stand in ``equivalent.toml``, each with the reason.
"""

import argparse
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.mutation.covering import Covering  # noqa: E402
from tests.mutation.mutants import drawn  # noqa: E402
from tests.mutation.project_copy import Outcome, ProjectCopy  # noqa: E402

EQUIVALENT = Path(__file__).with_name("equivalent.toml")
LONGEST = 60.0  # seconds of a processor for all tests of one mutant


def equivalent() -> set[tuple[str, str, str]]:
    """Mutants that nobody can see: file, line and changed line."""
    return {(one["file"], one["line"], one["mutant"]) for one in tomllib.loads(EQUIVALENT.read_text())["equivalent"]}


def main() -> int:
    """Draw, run, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", default="0/1")
    parser.add_argument("--map", type=Path, default=ROOT / "build" / "coverage")
    options = parser.parse_args()
    first, step = map(int, options.part.split("/"))
    covering, aside = Covering(ROOT, options.map.resolve()), equivalent()
    outcomes: dict[Outcome, list[str]] = {outcome: [] for outcome in Outcome}
    with tempfile.TemporaryDirectory() as folder:
        copy = ProjectCopy(Path(folder))
        for mutant in drawn(ROOT, options.count, options.seed)[first::step]:
            right, wrong = mutant.difference(ROOT)
            if (mutant.file, right, wrong) in aside or not mutant.is_python(ROOT):
                continue
            begin, tests = time.monotonic(), covering.tests(mutant.file, mutant.line)
            anew = covering.is_imported(mutant.file, mutant.line)
            outcome, output = copy.run_with(mutant.file, mutant.code(ROOT)[1], anew, tests, LONGEST)
            words = f"{mutant.file}:{mutant.line}\n          {right}\n          {wrong}"
            print(f"{time.monotonic() - begin:6.1f} s  {outcome.value}  {words}", flush=True)
            if outcome is Outcome.NO_TEST:
                print(output)
            outcomes[outcome].append(words)
    killed, all_of_them = len(outcomes[Outcome.KILLED]), sum(map(len, outcomes.values()))
    print(
        f"{killed} of {all_of_them} killed; not:",
        *(w for o, ws in outcomes.items() if o is not Outcome.KILLED for w in ws),
        sep="\n  ",
    )
    return all_of_them - killed


if __name__ == "__main__":
    sys.exit(main())
