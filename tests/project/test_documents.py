"""Documents name only what exists: links, anchors, paths, commands and options."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main

from vaoi_station.cli import app

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "vaoi_station"
VENDORED = "vaoi_station/api/web/vendor/"
SOURCE = re.compile(r"[\w.*-]+(?:/[\w.*-]+)*\.(?:py|c|h|js|css|md|rules|conf|service)")
"""A token that names a source file, with or without its folders."""
FOLDER = re.compile(r"(?:\.ci|deploy|docs|hw|tests|vaoi_station)/[\w./*-]*")
"""A token that begins with a folder of the repository."""
PLACEHOLDER = re.compile(r"(?:^|[/_])[A-Z]{2,}(?:$|[/_.])")
"""NAME in a path stands for a name that the reader chooses."""
FOREIGN_OPTIONS = frozenset({"--pty", "--quick"})
"""Options of other programs: of simavr's terminal, of tests/run."""


def source_files() -> list[str]:
    """Return the paths of the repository without environments, caches and build results."""
    names = []
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [f for f in folders if f == ".ci" or not (f.startswith((".", "__")) or f in {"build", "dist"})]
        names += [str((Path(folder) / file).relative_to(ROOT)) for file in files]
    return sorted(names)


FILES = source_files()
FOLDERS = {str(parent) for name in FILES for parent in Path(name).parents}
DOCUMENTS = [name for name in FILES if name.endswith(".md") and not name.startswith(VENDORED)]
FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)


@cache
def prose(name: str) -> str:
    """Return a document without its code blocks."""
    return FENCE.sub("", (ROOT / name).read_text(encoding="utf-8"))


@cache
def anchors(name: str) -> frozenset[str]:
    """Return the anchors of a document's headings, by the rule of GitHub."""
    found: list[str] = []
    for heading in re.findall(r"^#+ +(.+?) *$", prose(name), re.MULTILINE):
        text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
        found.append(slug if slug not in found else f"{slug}-{found.count(slug)}")
    return frozenset(found)


def spans(name: str) -> Iterator[str]:
    """Yield the texts in backticks of a document, outside its code blocks."""
    yield from re.findall(r"`([^`\n]+)`", prose(name))


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_relative_link_leads_to_a_file_and_a_heading(name: str) -> None:
    broken = []
    for target in re.findall(r"\]\(<?([^)\s>]+)>?\)", re.sub(r"`[^`\n]*`", "", prose(name))):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (ROOT / name).parent / path if path else ROOT / name
        if not file.exists():
            broken.append(target)
        elif anchor and file.suffix == ".md":
            known = anchors(str(file.resolve().relative_to(ROOT)))
            broken += [] if anchor in known else [target]
    assert broken == []


def exists(token: str, document: str) -> bool:
    """Return whether a path names a file or folder: from the root, the package, the document, or any folder."""
    token = token.rstrip("/")
    if "*" in token:
        return any(Path(file).match(token) for file in FILES)
    beside = str(((ROOT / document).parent / token).resolve().relative_to(ROOT)) if ".." not in token else token
    places = {token, f"vaoi_station/{token}", beside}
    return bool(places & (FOLDERS | set(FILES))) or any(file.endswith(f"/{token}") for file in FILES)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_path_in_backticks_exists(name: str) -> None:
    tokens = {word for span in spans(name) for word in span.split()}
    paths = {t for t in tokens if SOURCE.fullmatch(t) or FOLDER.fullmatch(t)}
    assert sorted(p for p in paths if not PLACEHOLDER.search(p) and not exists(p, name)) == []


# ── commands ──


@cache
def commands() -> dict[str, frozenset[str]]:
    """Return the options of every command of `vaoi`, by the command's words."""
    found: dict[str, frozenset[str]] = {}

    def visit(command: Any, words: tuple[str, ...]) -> None:
        options = (o for p in command.params for o in (*p.opts, *p.secondary_opts) if o.startswith("--"))
        found[" ".join(words)] = frozenset(options) | {"--help"}
        for name, child in getattr(command, "commands", {}).items():
            visit(child, (*words, name))

    visit(typer.main.get_command(app), ("vaoi",))
    return found


def calls(name: str) -> Iterator[str]:
    """Yield every call of `vaoi` in backticks; those of code blocks are in test_blocks.py."""
    for line in spans(name):
        for part in re.split(r"&&|[|;]", line):
            words = part.split()
            # The last one: `sudo -u vaoi vaoi doctor` begins with the name of a user.
            starts = [k for k, word in enumerate(words) if word == "vaoi" or word.endswith("bin/vaoi")]
            if starts:
                yield " ".join(["vaoi", *words[starts[-1] + 1 :]])


def fault(call: str) -> str:
    """Return what is wrong with a call; empty if its command and options exist."""
    known, words = commands(), call.split()
    depth = 1
    while depth < len(words) and " ".join(words[: depth + 1]) in known:
        depth += 1
    command = " ".join(words[:depth])
    is_group = any(other.startswith(f"{command} ") for other in known)
    if is_group and depth < len(words) and re.fullmatch(r"[a-z][a-z-]*", words[depth]):
        return f"{call}: no such command"
    options = {word.rstrip(",.").split("=")[0] for word in words[depth:] if word.startswith("--")}
    return "".join(f"{call}: no option {option}" for option in sorted(options - known[command]))


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_command_and_its_options_exist(name: str) -> None:
    assert [f for f in map(fault, calls(name)) if f] == []


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_option_in_backticks_exists(name: str) -> None:
    known = frozenset().union(*commands().values()) | FOREIGN_OPTIONS
    named = {word.split("=")[0] for span in spans(name) for word in span.split()[:1] if word.startswith("--")}
    assert sorted(named - known) == []


# ── decisions ──


def test_every_decision_has_a_status_and_is_listed_with_it() -> None:
    folder = ROOT / "docs" / "decisions"
    index = (folder / "README.md").read_text(encoding="utf-8")
    records = sorted(folder.glob("0*.md"))
    assert [record.name[:4] for record in records] == [f"{k:04d}" for k in range(1, len(records) + 1)]
    for record in records:
        found = re.search(r"^Status: (accepted|amended|superseded)", record.read_text(encoding="utf-8"), re.MULTILINE)
        assert found is not None, record.name
        row = next(line for line in index.splitlines() if f"({record.name})" in line)
        assert row.split("|")[3].strip().startswith(found[1]), record.name


# ── CONTRIBUTING ──


def test_every_path_in_the_code_blocks_of_contributing_exists() -> None:
    name = "docs/CONTRIBUTING.md"
    blocks = FENCE.findall((ROOT / name).read_text(encoding="utf-8"))
    words = {w for block in blocks for line in block.splitlines()[1:-1] for w in line.split("#", 1)[0].split()}
    paths = {w.split("::")[0] for w in words if FOLDER.fullmatch(w.split("::")[0])}
    assert paths
    assert sorted(p for p in paths if not PLACEHOLDER.search(p) and not exists(p, name)) == []


def test_every_name_of_code_in_contributing_exists() -> None:
    sources = (ROOT / name for name in FILES if name.endswith((".py", ".c", ".h", ".toml", ".xml")))
    written = "\n".join(source.read_text(encoding="utf-8") for source in sources)
    plain = {s for s in spans("docs/CONTRIBUTING.md") if re.fullmatch(r"[A-Za-z_]+(?:\.[A-Za-z_]+)*", s)}
    parts = {part for span in plain for part in span.split(".")}
    assert sorted(part for part in parts if not re.search(rf"\b{part}\b", written)) == []


def test_every_recipe_of_contributing_is_short_and_ends_in_a_test() -> None:
    text = (ROOT / "docs" / "CONTRIBUTING.md").read_text(encoding="utf-8")
    recipes = re.findall(r"^### (.+?)\n(.*?)(?=^##|\Z)", text.split("## Recipes", 1)[1], re.MULTILINE | re.DOTALL)
    assert len(recipes) >= 5
    for title, body in recipes:
        lines = body.strip().splitlines()
        assert len(lines) <= 25, title
        assert lines[-1].strip() == "```", title
        assert "python -m pytest" in FENCE.findall(body)[-1], title
