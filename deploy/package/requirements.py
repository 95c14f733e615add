"""Print the pinned, hashed requirements at run time: constraints.txt without tools of development.

python3 deploy/package/requirements.py constraints.txt > requirements.txt
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

PROJECT, DEVELOPMENT = "vaoi-station (pyproject.toml)", "vaoi-station (pyproject.toml:dev)"
_ENTRY = re.compile(r"^([a-z0-9][\w.-]*)==", re.IGNORECASE)


def entries(text: str) -> list[tuple[str, str, set[str]]]:
    """Return for each entry its name, its lines without comments, and the names that require it ("via")."""
    found: list[tuple[str, str, set[str]]] = []
    for line in text.splitlines():
        if (name := _ENTRY.match(line)) is not None:
            found.append((name[1].lower(), f"{line}\n", set()))
        elif found and line.lstrip().startswith("#"):
            # "# via NAME", or "# via" and one name in each of the following comments
            via = line.strip().lstrip("#").strip()
            via = "" if via == "via" else via.removeprefix("via ").strip()
            found[-1][2].update({via.lower()} - {""})
        elif found and line.strip():
            name_, lines, required_by = found[-1]
            found[-1] = (name_, f"{lines}{line}\n", required_by)
    return found


def at_run_time(text: str) -> str:
    """Return the entries that the project requires, directly or by others, without its tools of development."""
    all_entries = entries(text)
    needed = {PROJECT}
    while more := {name for name, _, via in all_entries if via & needed} - needed:
        needed |= more
    return "".join(lines.rstrip().rstrip("\\").rstrip() + "\n" for name, lines, _ in all_entries if name in needed)


if __name__ == "__main__":
    sys.stdout.write(at_run_time(Path(sys.argv[1]).read_text(encoding="utf-8")))
