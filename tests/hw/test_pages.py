"""The pages of hw/ tell the truth: what they link is there, what they show is what the commands print."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "hw").glob("*.md"))
EXAMPLES = [
    (page.name, command, shown)
    for page in PAGES
    for command, shown in re.findall(
        r"^```console\n\$ ([^\n]*)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)]+)\)", text):
        name, _, anchor = target.partition("#")
        there = page.parent / name if name else page
        assert there.exists(), target
        if anchor:
            heads = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}, target


def test_none_of_the_examples_escapes() -> None:
    assert len(EXAMPLES) == sum(page.read_text(encoding="utf-8").count("```console") for page in PAGES) > 0


@pytest.mark.parametrize(("page", "command", "shown"), EXAMPLES, ids=lambda value: str(value)[:40])
def test_the_output_shown_is_what_the_command_prints(page: str, command: str, shown: str, tmp_path: Path) -> None:
    script = f'vaoi() {{ "{sys.executable}" -m vaoi_station "$@"; }}\n{command}\n'
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "-ec", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == shown, page
