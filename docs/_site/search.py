"""The words of the field, each with the page that a search for it has to list first."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

WORDS = {
    "MPC": "receding_horizon",
    "receding horizon": "receding_horizon",
    "warm start": "warm_starts",
    "real time": "warm_starts",
    "minimum time": "minimum_time",
    "free final time": "minimum_time",
    "torque limit": "constraints",
    "path constraint": "constraints",
    "infeasible": "constraints",
    "obstacle": "obstacles",
    "keep-out cone": "obstacles",
    "Euler angles": "pictures",
    "mesh refinement": "accuracy",
    "terminal cost": "boundary_conditions",
    "multistart": "parameter_studies",
    "CasADi": "from_casadi",
}
INDEXED, TITLE = 100, 15  # the scores of Sphinx's search for an index entry and for a heading that are the word itself


def first(index: dict[str, Any], word: str) -> str | None:
    """The page that a search lists first, by main index entries and headings that contain the word; None without."""
    scores: Counter[str] = Counter()
    for table, most in (("indexentries", INDEXED), ("alltitles", TITLE)):
        for text, places in index[table].items():
            if word.lower() in text.lower() and 2 * len(word) >= len(text):
                for place, _, *main in places:
                    if not main or main[0]:
                        page = index["docnames"][place]
                        scores[page] = max(scores[page], round(most * len(word) / len(text)))
    return max(scores, key=lambda page: (scores[page], page)) if scores else None


def missed(index: dict[str, Any]) -> list[str]:
    """The words that a search does not find at their pages, in words."""
    found = {word: first(index, word) for word in WORDS}
    return [
        f"a search for {word!r} lists {found[word]} first, expected {page}"
        for word, page in WORDS.items()
        if found[word] != page
    ]


def check(app: Any, exception: Exception | None) -> None:
    """Warn of each word that the index of a fresh build has not at its page; warnings are errors.

    A build of changed pages alone leaves the index entries of the others out.
    """
    from sphinx.util import logging

    if exception or app.builder.name != "html" or not app.fresh_env_used:
        return
    text = (Path(app.outdir) / "searchindex.js").read_text()
    for words in missed(json.loads(text[text.index("(") + 1 : text.rindex(")")])):
        logging.getLogger(__name__).warning(words)
