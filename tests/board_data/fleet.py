"""Reads all board data in folders: which files are read, warned of, refused or end in a crash, by format.

    python -m tests.board_data.fleet FOLDER…

Prints three tables and every kind of refusal. A refusal is one sentence with an action; an exception of another kind is
a crash.
"""

from __future__ import annotations

import re
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from vaoi_station.board_data.conversion import to_board_type
from vaoi_station.board_data.design import Design, Side
from vaoi_station.board_data.reading import read_design
from vaoi_station.errors import InputError
from vaoi_station.model import BoardType

Outcome = Literal["ok", "warned", "refused", "crash"]
SUFFIXES = {
    ".kicad_pcb": "KiCad", ".pos": "KiCad .pos", ".brd": "EAGLE", ".mnt": "EAGLE .mnt", ".mnb": "EAGLE .mnt",
    ".cad": "GenCAD", ".gencad": "GenCAD", ".xml": "IPC-2581", ".cvg": "IPC-2581", ".tgz": "ODB++", ".zip": "ODB++",
}  # fmt: skip
FOLDER = "ODB++ folder"


@dataclass
class Seen:
    """What was found in the files of one format."""

    files: int = 0
    outcomes: Counter[Outcome] = field(default_factory=Counter)
    sides: int = 0
    """Sides with components."""
    components: int = 0
    guessed: int = 0
    """Components whose size is a guess."""
    fiducials: int = 0
    """Sides with two fiducials or more."""
    outlines: int = 0
    """Sides whose board has an outline."""
    pins: Counter[str] = field(default_factory=Counter)
    """Number of pins that the files place, and of those that fit the rule by which parts are turned, by side."""
    slowest_s: float = 0.0


class Fleet:
    """Reads files one by one, and counts."""

    def __init__(self) -> None:
        self.formats: defaultdict[str, Seen] = defaultdict(Seen)
        self.refusals: defaultdict[str, list[str]] = defaultdict(list)
        """For each kind of refusal or crash, with numbers and names left out, the files."""

    def add(self, format: str, path: Path) -> Outcome:
        """Read a file, both sides, and return the outcome."""
        seen, began_s = self.formats[format], time.perf_counter()
        outcome = self._read(seen, path)
        seen.files += 1
        seen.outcomes[outcome] += 1
        seen.slowest_s = max(seen.slowest_s, time.perf_counter() - began_s)
        return outcome

    def lines(self) -> list[str]:
        """Return the tables and the refusals as lines of text."""
        shown = ["| format | files | ok | warned | refused | crash | slowest s |", "|---|---|---|---|---|---|---|"]
        for name, seen in sorted(self.formats.items()):
            counts = " | ".join(str(seen.outcomes[outcome]) for outcome in get_args(Outcome))
            shown.append(f"| {name} | {seen.files} | {counts} | {seen.slowest_s:.1f} |")
        shown += [
            "",
            "| format | sides | components | of guessed size | sides with two fiducials | sides with an outline |",
        ]
        shown.append("|---|---|---|---|---|---|")
        for name, s in sorted(self.formats.items()):
            shown.append(f"| {name} | {s.sides} | {s.components} | {s.guessed} | {s.fiducials} | {s.outlines} |")
        shown += ["", "| format | side | pins with a place | that fit |", "|---|---|---|---|"]
        for name, s in sorted(self.formats.items()):
            for side in get_args(Side):
                if s.pins[side]:
                    shown.append(f"| {name} | {side} | {s.pins[side]} | {s.pins[f'{side}, fit']} |")
        for sentence, files in sorted(self.refusals.items(), key=lambda item: -len(item[1])):
            shown += ["", f"{len(files)} × {sentence}", f"    {files[0]}"]
        return shown

    def _read(self, seen: Seen, path: Path) -> Outcome:
        try:
            design = read_design(path)
            found = [made for side in get_args(Side) if (made := _side(design, side)) is not None]
            if not found:
                to_board_type(design, "top")  # refused with what to do
        except InputError as refusal:
            self.refusals[_kind(f"{refusal.message} {refusal.action}", path)].append(str(path))
            return "refused"
        except Exception as fault:  # noqa: BLE001  that is what is searched
            self.refusals[f"CRASH: {type(fault).__name__}: {fault}"].append(str(path))
            return "crash"
        for note in design.notes:
            if note.code == "rotation-by-pins":
                seen.pins[note.values["side"]] += int(note.values["pins"])
                seen.pins[f"{note.values['side']}, fit"] += int(note.values["fit"])
        for board, _ in found:
            seen.sides += 1
            seen.components += len(board.components)
            seen.guessed += sum(part.size_from == "guess" for part in board.components)
            seen.fiducials += len(board.fiducials) >= 2
            seen.outlines += board.outline is not None
        return "warned" if any(notes for _, notes in found) else "ok"


def _side(design: Design, side: Side) -> tuple[BoardType, tuple[str, ...]] | None:
    return to_board_type(design, side) if any(part.side == side for part in design.parts) else None


def _kind(sentence: str, path: Path) -> str:
    """Return a sentence without what differs from file to file."""
    bare = sentence.replace(str(path), "FILE").replace(path.name, "FILE")
    return re.sub(r"\d+(\.\d+)?", "N", re.sub(r"'[^']*'", "'…'", bare))


def files_in(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield the board data in a folder: format by the name, and path."""
    designs = {found.parent.parent for found in folder.rglob("matrix/matrix")}
    for path in sorted(folder.rglob("*")):
        if path in designs:
            yield FOLDER, path
        format = SUFFIXES.get(path.suffix.lower())
        if format is not None and path.is_file() and not designs & set(path.parents):
            yield format, path


def main(folders: Sequence[str]) -> int:
    """Read all files of folders; return 1 if one ended in a crash."""
    fleet = Fleet()
    for folder in folders:
        for format, path in files_in(Path(folder)):
            outcome = fleet.add(format, path)
            print(f"{outcome:8s} {path}", file=sys.stderr, flush=True)
    print("\n".join(fleet.lines()))
    return int(any(seen.outcomes["crash"] for seen in fleet.formats.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
