"""Draw the state diagrams in `docs/internals/runs.md` from the state tables. To update the file, run:

python -m vaoi_station.runs.states.diagram docs/internals/runs.md
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from vaoi_station.runs.states.tables import RUN, STATION, Table

TABLES: dict[str, Table[Any, Any]] = {"station": STATION, "run": RUN}


def mermaid(table: Table[Any, Any]) -> str:
    """Return a state table as a Mermaid state diagram. Steps that lead from one state to another share an arrow."""
    arrows: dict[tuple[str, str], list[str]] = {}
    for (state, event), target in table.steps.items():
        arrows.setdefault((state, target), []).append(event)
    lines = ["stateDiagram-v2", f"    [*] --> {table.start}"]
    lines += [f"    {a} --> {b}: {', '.join(events)}" for (a, b), events in arrows.items()]
    return "\n".join(lines)


def redrawn(document: str) -> str:
    """Return the document with its mermaid blocks replaced by newly drawn ones.

    A block is replaced if it follows a comment `<!-- drawn: NAME -->`, where NAME is a key of `TABLES`.
    """

    def draw(found: re.Match[str]) -> str:
        return f"<!-- drawn: {found[1]} -->\n```mermaid\n{mermaid(TABLES[found[1]])}\n```"

    return re.sub(r"<!-- drawn: (\w+) -->\n```mermaid\n.*?\n```", draw, document, flags=re.DOTALL)


def main(path: Path) -> None:
    """Redraw all diagrams of a Markdown file, and write the file."""
    path.write_text(redrawn(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
