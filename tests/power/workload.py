"""What a station writes, in a process whose file operations are recorded: runs with pins and decisions, board types
that are stored and deleted, the standing order, keys, a reference.

Usage: `python -m tests.power.workload ROOT LOG`. It prints one line for each promise: the size of the record at that
moment, the kind and what was promised.
"""

from __future__ import annotations

import sys
from pathlib import Path

from vaoi_station.files.access_keys import KeyFile
from vaoi_station.files.directories import new_directory
from vaoi_station.model import BoardType
from vaoi_station.store import BoardTypeDirectory, Database, RunRow, Store

RUNS = 60
NOW = "2026-01-01T00:00:00Z"


def main(root: Path, log: Path) -> None:
    """Write, and state after each promise how far the record is."""

    def promise(*words: str) -> None:
        print(log.stat().st_size, *words, flush=True)

    store, keys = Store(Database(root / "data" / "station.db")), KeyFile(root / "data" / "keys.json")
    board_types = BoardTypeDirectory(root / "board-types")
    for number in range(RUNS):
        run = f"run-{number:03d}"
        board = store.keep_document("board-type", f'{{"name": "b{number // 10}"}}', NOW)
        calibration = store.keep_document("calibration", '{"n": 1}', NOW)
        begun = RunRow(run, "filming", None, board, calibration, "{}", "{}")
        store.save_run(begun)
        done = RunRow(run, "ready", number + 1, board, calibration, '{"s": 1}', '{"d": 1}', '{"h": 1}')
        store.save_run(done, '{"t": 1}', f'{{"r": "{run}", "m": "{"m" * 20_000}"}}').result()
        promise("run", run)
        if number % 10 == 3:
            for name in (f"type-{number}", f"deleted-{number}"):
                board_types.put(BoardType(name=name, outline=((0.0, 0.0), (60.0, 40.0))))
            promise("board-type", f"type-{number}")
            board_types.delete(f"deleted-{number}")
            promise("no-board-type", f"deleted-{number}")
        if number % 3 == 1:
            store.retention.pin(run, NOW)
            promise("pin", run)
            store.save_decision(run, f'{{"decision": "{run}"}}')
            promise("decision", run)
        if number % 6 == 4:
            store.retention.unpin(f"run-{number - 3:03d}")
            promise("no-pin", f"run-{number - 3:03d}")
        # The line is armed before the 8th, 18th … board, and disarmed after it.
        if number % 10 in (7, 8):
            armed = f'{{"board_type": "b{number}"}}' if number % 10 == 7 else None
            store.standing.set("armed", armed).result()
            promise("armed", str(armed and number))
        if number % 20 == 5:
            keys.create(f"stays-{number}", ["read"])
            promise("key", f"stays-{number}")
        if number % 20 == 15:
            keys.create(f"ends-{number}", ["read"])
            keys.revoke(f"ends-{number}")
            promise("no-key", f"ends-{number}")
            with new_directory(root / "data" / "references" / run) as draft:
                (draft / "frames").mkdir()
                (draft / "reference.json").write_text("{}" * 5000)
                (draft / "frames" / "0.png").write_bytes(b"p" * 30_000)
            promise("reference", run)
    store.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
