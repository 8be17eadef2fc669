"""Pages of the documentation, run one after the other in one process, each with names and settings of its own.

As a script it reads a JSON line ``[code, folder]`` for each page, and writes one ``[what it printed, its traceback]``.
"""

import contextlib
import io
import json
import os
import subprocess
import sys
import traceback
from pathlib import Path
from types import ModuleType


class Pages:
    """A process that runs pages."""

    def __init__(self) -> None:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen([sys.executable, __file__], **pipes)

    def run(self, code: str, folder: Path) -> list[str]:
        """What a page prints, and the traceback of its error or nothing."""
        self.process.stdin.write(json.dumps([code, str(folder)]) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def close(self) -> None:
        """Let the process end."""
        self.process.communicate(timeout=60)


def printed(code: str, folder: str) -> tuple[str, str]:
    """What code prints that runs as a program in a folder, and the traceback of its error; settings are put back."""
    import jax
    import numpy as np

    settings, page, text, error = dict(jax.config.values), ModuleType("__main__"), io.StringIO(), ""
    ours, sys.modules["__main__"] = sys.modules["__main__"], page
    with contextlib.redirect_stdout(text), contextlib.chdir(folder), np.printoptions():
        try:
            exec(compile(code, "page", "exec"), vars(page))
        except BaseException:
            error = traceback.format_exc()
    sys.modules["__main__"] = ours
    for name, value in settings.items():
        if jax.config.values[name] != value:
            jax.config.update(name, value)
    return text.getvalue(), error


if __name__ == "__main__":
    # What pages write to the file of standard output itself, as their own processes do, is not an answer.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        answers.write(json.dumps(printed(*json.loads(line))) + "\n")
        answers.flush()
