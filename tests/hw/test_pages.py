"""The pages of hw/ are correct: their links exist, and the output they show is that of the commands."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

from hw.wiring.circuit import read_circuit
from hw.wiring.figure import Firmware, shown
from hw.wiring.light import currents, one_shots
from vaoi_station.cli import app

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


@pytest.mark.parametrize(("page", "command", "shown"), EXAMPLES, ids=lambda value: str(value)[:40])
def test_the_output_shown_is_what_the_command_prints(page: str, command: str, shown: str, tmp_path: Path) -> None:
    script = f'vaoi() {{ "{sys.executable}" -m vaoi_station "$@"; }}\n{command}\n'
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "-ec", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == shown, page


BRING_UP = (ROOT / "hw" / "bring-up.md").read_text(encoding="utf-8")
COMMANDS = [
    words
    for block in re.findall(r"^```sh\n(.*?)^```$", BRING_UP, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
    for command in line.split(" && ")
    if (words := shlex.split(command, comments=True))
]


def of(program: str) -> list[list[str]]:
    """Return the arguments of the guide's calls of a program."""
    plain = [words[3:] if words[:2] == ["sudo", "-u"] else words for words in COMMANDS]
    return [words[1:] for words in plain if Path(words[0]).name == program]


@pytest.mark.parametrize("words", of("vaoi"), ids=" ".join)
def test_the_guides_commands_exist_with_their_options(words: list[str]) -> None:
    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    command = group.commands[words[0]]
    known = {name for parameter in command.params for name in parameter.opts}
    assert {word for word in words[1:] if word.startswith("--")} <= known


def test_the_guides_figures_are_those_of_the_circuit() -> None:
    circuit = read_circuit()
    volts = [ampere * circuit.value("R37") for ampere in currents(circuit)]
    assert f"{min(volts):.2f} … {max(volts):.2f} V" in BRING_UP
    times = one_shots(circuit)
    assert times[0] == times[1]
    assert times[2] == times[3]
    for low, high in (times[0], times[2]):
        number, unit = shown(low, "s").split()
        assert f"{number} … {shown(high, 's')}" in BRING_UP, (number, unit)
    assert Firmware.read().longest_s[0] < times[0][0]
