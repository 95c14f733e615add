"""Run a soak: `python -m tests.soak --boards 5000 --faults all --out FOLDER`."""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict
from pathlib import Path

from tests.soak.faults import NAMES
from tests.soak.report import write_report
from tests.soak.soaking import Plan, Soak


def main() -> int:
    """Soak a station and keep what was measured; return 1 if a run is not accounted for."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--boards", type=int, default=5000)
    parser.add_argument("--pause", type=float, default=0.15, help="s between two boards")
    parser.add_argument("--faults", nargs="*", default=(), choices=["all", *NAMES], metavar="FAULT")
    parser.add_argument("--every", type=float, default=20, help="mean number of boards between two faults")
    parser.add_argument("--lost", type=float, default=0.0, help="share of boards during which a camera is lost")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=float("inf"), help="longest time, s")
    parser.add_argument("--out", type=Path, default=Path("soak"), help="folder for raw.json and the station's log")
    parser.add_argument("--report", nargs="+", metavar="NAME=RAW", help="renew tables and docs/measured/soak.*")
    chosen = parser.parse_args()
    if chosen.report:
        write_report({name: Path(path) for name, _, path in (given.partition("=") for given in chosen.report)})
        return 0
    faults = NAMES if "all" in chosen.faults else tuple(chosen.faults)
    plan = Plan(
        chosen.boards, chosen.pause, faults, chosen.every,
        lost_share=chosen.lost, seed=chosen.seed, limit_s=chosen.limit,
    )  # fmt: skip
    chosen.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="vaoi-soak-") as folder:
        soak = Soak(Path(folder), plan)
        try:
            soak.run()
        finally:
            # What was measured until an end that was not planned is what explains it.
            (chosen.out / "log.txt").write_bytes((Path(folder) / "log.txt").read_bytes())
            raw = {"plan": asdict(plan), **asdict(soak.record)}
            (chosen.out / "raw.json").write_text(json.dumps(raw), encoding="utf-8")
    accounts = soak.record.accounts
    assert accounts is not None
    print(json.dumps(accounts.document(), indent=1))
    return int(bool(accounts.finds))


if __name__ == "__main__":
    raise SystemExit(main())
