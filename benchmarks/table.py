"""The JSON lines of a benchmark as Markdown tables.

    python benchmarks/retractions.py | python benchmarks/table.py

Records with the same entries share a table; an entry that is itself a record gives a column for each of its own.
"""

import json
import sys


def flat(record, name=""):
    """Columns of a record: names of entries, those of inner records after the outer name, with their values."""
    columns = {}
    for key, value in record.items():
        label = f"{name}: {key}" if name else key
        columns |= flat(value, label) if isinstance(value, dict) else {label: value}
    return columns


def shown(value):
    """A cell: numbers to four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def tables(lines):
    """Lines of Markdown, a table for each set of columns."""
    groups = {}
    for line in lines:
        row = flat(json.loads(line))
        groups.setdefault(tuple(row), []).append(row)
    for columns, rows in groups.items():
        yield from ("", f"| {' | '.join(columns)} |", "|---" * len(columns) + "|")
        yield from (f"| {' | '.join(shown(row[c]) for c in columns)} |" for row in rows)


if __name__ == "__main__":
    print("\n".join(tables(line for line in sys.stdin if line.strip())).strip())
