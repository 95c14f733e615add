"""The codes of reasons, warnings, faults and refusals: where each occurs, what it means, and what to do."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

_LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")


class Explanation(NamedTuple):
    """What codes with one meaning say."""

    codes: tuple[str, ...]
    meaning: str
    action: str


class CodeSection(NamedTuple):
    """The codes of one place, such as the reasons of a run. Texts are Markdown, with links relative to docs/."""

    title: str
    about: str
    codes: tuple[Explanation, ...]


@cache
def code_sections() -> tuple[CodeSection, ...]:
    """Return all codes, as codes.toml has them."""
    document = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return tuple(
        CodeSection(s["title"], s["about"], tuple(Explanation(tuple(c.split()), m, a) for c, m, a in s["codes"]))
        for s in document["sections"]
    )


def explain(code: str) -> str:
    """Return in plain text what a code means in each place and what to do; empty for an unknown one."""
    lines = [
        f"{section.title}: {entry.meaning}\nWhat to do: {entry.action}\n"
        for section in code_sections()
        for entry in section.codes
        if code in entry.codes
    ]
    return _LINK.sub(r"\1", "\n".join(lines))
