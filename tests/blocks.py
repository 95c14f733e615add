"""The code blocks of all documents, as they are printed."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from textwrap import dedent
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
GENERATED = ("docs/reference/addresses.md", "docs/reference/commands.md")
"""Pages whose blocks docs/generate.py writes: their examples are checked where they come from."""
_FENCE = re.compile(r"^( *)```([^\n`]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A block between fences."""

    page: str
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    def commands(self) -> list[str]:
        """Return the commands of a shell: whole ones, without comments and without what they print."""
        joined = self.text.replace("\\\n", " ")
        lines = joined.splitlines() if self.language == "sh" else re.findall(r"^\$ (.*)$", joined, re.MULTILINE)
        return [found for line in lines if (found := re.sub(r"(?:^|\s+)#.*", "", line).strip())]

    def output(self) -> str:
        """Return what the commands of a console print, as it is shown."""
        return "" if self.language == "sh" else re.sub(r"^\$ (?:.*\\\n)*.*\n?", "", self.text, flags=re.MULTILINE)


@cache
def blocks() -> tuple[Block, ...]:
    """Return the blocks of all hand-written documents."""
    folders = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "hw").rglob("*.md"))]
    found = []
    for path in folders:
        page = str(path.relative_to(ROOT))
        text = path.read_text(encoding="utf-8")
        for match in _FENCE.finditer(text) if page not in GENERATED else ():
            line = text.count("\n", 0, match.start()) + 1
            found.append(Block(page, line, match[2].strip(), dedent(match[3])))
    return tuple(found)
