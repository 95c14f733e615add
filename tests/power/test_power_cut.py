"""Power cuts below the file system: what was promised is there, whatever the disk has lost of what was not synced."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.needs import LONG, need
from tests.power.replay import Disk, Entry, read_record
from vaoi_station.errors import VaoiError
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.store import BoardTypeDirectory, Database, Store

HERE = Path(__file__).parent
CUTS = 400 if LONG else 20


class Promise(NamedTuple):
    """What a program was promised, and the size of the record at that moment."""

    at: int
    kind: str
    name: str


class Recorded(NamedTuple):
    """A recorded program: its directory, the directory's file number, what it did, and what it promised."""

    root: str
    number: str
    entries: list[Entry]
    promises: list[Promise]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    need("gcc")
    folder = tmp_path_factory.mktemp("power").resolve()
    library, root, log = folder / "recorder.so", folder / "root", folder / "log"
    root.mkdir()
    source = HERE / "recorder.c"
    subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", library, source, "-ldl"], check=True)
    done = subprocess.run(
        [sys.executable, "-m", "tests.power.workload", str(root), str(log)],
        env=os.environ | {"LD_PRELOAD": str(library), "VAOI_CUT_ROOT": str(root), "VAOI_CUT_LOG": str(log)},
        cwd=HERE.parents[1], check=True, text=True, stdout=subprocess.PIPE, timeout=200,
    )  # fmt: skip
    promises = [Promise(int(at), kind, name) for at, kind, name in map(str.split, done.stdout.splitlines())]
    return Recorded(str(root), str(root.stat().st_ino), list(read_record(log.read_bytes())), promises)


def cut_at(recorded: Recorded, seed: int, target: Path) -> int:
    """Write what a power cut at a random moment leaves; return the size of the record at that moment."""
    chance = random.Random(seed)
    disk = Disk(recorded.root, recorded.number, chance)
    taken = recorded.entries[: chance.randint(1, len(recorded.entries))]
    for entry in taken:
        disk.add(entry)
    target.mkdir()
    disk.cut(target)
    return taken[-1].end


def broken(root: Path, promises: Sequence[Promise]) -> list[str]:
    """Return what is not as it was promised."""
    kinds = "run", "pin", "no-pin", "decision", "board-type", "no-board-type", "key", "no-key", "armed"
    names = {kind: [p.name for p in promises if p.kind == kind] for kind in kinds}
    found = []
    with closing(Store(Database(root / "data" / "station.db"))) as store:
        found += [notice.message for notice in store.database.notices]
        fault = store.database.read("PRAGMA integrity_check")[0][0]
        found += [] if fault == "ok" else [fault]
        for run in names["run"]:
            row = store.run(run)
            if row is None or row.state != "ready" or run not in (store.result(run) or ""):
                found.append(f"run {run}: {row}")
        pins, decisions = store.retention.pins(), store.decisions(names["decision"])
        found += [f"the pin of {run} is lost" for run in set(names["pin"]) - set(names["no-pin"]) - pins]
        found += [f"the pin of {run} is back" for run in set(names["no-pin"]) & pins]
        found += [f"the decision about {run} is lost" for run in names["decision"] if run not in decisions.get(run, "")]
        found += _standing(store.standing.get("armed"), names["armed"])
    types = BoardTypeDirectory(root / "board-types")
    for name in names["board-type"]:
        try:
            types.get(name)
        except VaoiError as error:
            found.append(str(error))
    found += [f"board type {name} is back" for name in names["no-board-type"] if types.path_of(name).exists()]
    found += [f"board type {name} has no version" for name in names["no-board-type"] if name not in types.deleted()]
    try:
        keys = {key.name for key in KeyFile(root / "data" / "keys.json").entries()}
    except VaoiError as error:
        return [*found, str(error)]
    found += [f"key {name} is lost" for name in set(names["key"]) - keys]
    return found + [f"key {name} is back" for name in set(names["no-key"]) & keys]


def _standing(document: str | None, promised: Sequence[str]) -> list[str]:
    """Return what is wrong with the standing order; the one after the last promised may be there already."""
    last = promised[-1] if promised else "None"
    following = "None" if last != "None" else str(int(promised[-2]) + 10) if len(promised) > 1 else "7"
    expected = [None if number == "None" else f'{{"board_type": "b{number}"}}' for number in (last, following)]
    return [] if document in expected else [f"the standing order is {document}, not {' or '.join(map(str, expected))}"]


def test_everything_that_was_promised_survives_a_power_cut(recorded: Recorded, tmp_path: Path) -> None:
    found = {}
    for seed in range(CUTS):
        at = cut_at(recorded, seed, tmp_path / str(seed))
        if faults := broken(tmp_path / str(seed), [p for p in recorded.promises if p.at <= at]):
            found[seed] = faults
    assert not found


def test_a_directory_that_appears_is_complete(recorded: Recorded, tmp_path: Path) -> None:
    promised = [p for p in recorded.promises if p.kind == "reference"]
    assert promised
    for seed in range(CUTS):
        at = cut_at(recorded, seed, tmp_path / str(seed))
        references = tmp_path / str(seed) / "data" / "references"
        for promise in promised:
            folder = references / promise.name
            if promise.at <= at or folder.is_dir():
                assert (folder / "reference.json").read_text() == "{}" * 5000, seed
                assert (folder / "frames" / "0.png").read_bytes() == b"p" * 30_000, seed


def test_the_record_is_complete(recorded: Recorded, tmp_path: Path) -> None:
    """Without a loss, a replay gives the files of the program; otherwise its cuts would prove nothing."""
    disk = Disk(recorded.root, recorded.number, random.Random(0))
    for entry in recorded.entries:
        disk.add(entry)
    for number in list(disk.waiting):
        disk.add(Entry(("sync", number), b"", 0))
    disk.add(Entry(("sync", recorded.number), b"", 0))
    disk.cut(tmp_path / "whole")
    for path in Path(recorded.root).rglob("*"):
        again = tmp_path / "whole" / path.relative_to(recorded.root)
        assert again.is_dir() == path.is_dir()
        # The index of the write-ahead log is memory that processes share; it is never synced.
        if path.is_file() and not path.name.endswith("-shm"):
            assert again.read_bytes() == path.read_bytes(), path


def test_what_was_not_synced_is_lost_sooner_or_later(tmp_path: Path) -> None:
    record = b"make 7 /r/a\nwrite 7 0 3\nabcsync 7\nmake 8 /r/b\nrename /r/b\t/r/a\n"
    left = set()
    for seed in range(40):
        disk = Disk("/r", "1", random.Random(seed))
        for entry in read_record(record + b"sync 1\n" if seed % 2 else record):
            disk.add(entry)
        (tmp_path / str(seed)).mkdir()
        disk.cut(tmp_path / str(seed))
        left.add(tuple(sorted((p.name, p.read_bytes()) for p in (tmp_path / str(seed)).iterdir())))
    assert left == {(), (("a", b"abc"),), (("a", b"abc"), ("b", b"")), (("a", b""),)}
