"""Fuzz parsers: `python -m tests.fuzz --seconds 120 --out FOLDER [TARGET …]`. New kinds of finds are written to FOLDER.

`python -m tests.fuzz.guided TARGET` does the same guided by coverage, where atheris is installed.
"""

from __future__ import annotations

import argparse
import random
import time
import traceback
from pathlib import Path

from tests.fuzz.corpus import inputs
from tests.fuzz.mutation import mutated
from tests.fuzz.targets import TARGETS, run_target
from vaoi_station.errors import VaoiError

SLOW_S = 2.0
"""CPU time of one input above which it counts as a find."""


def fuzz(name: str, seconds: float, seed: int, out: Path | None) -> tuple[int, set[str]]:
    """Run a target on mutated inputs; return the number of inputs, and the kinds of finds."""
    chance, known, finds, count = random.Random(seed), list(inputs(name).values()), set[str](), 0
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        data, begun_s = mutated(chance.choice(known), known, chance), time.process_time()
        count += 1
        try:
            run_target(name, data)
            kind = "slow" if time.process_time() - begun_s > SLOW_S else ""
        except VaoiError:
            kind = ""
        except Exception as error:  # noqa: BLE001  every other exception is what is searched for
            place = traceback.extract_tb(error.__traceback__)[-1]
            kind = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {str(error)[:150]!r}"
        if kind and kind.split(": ")[0] not in finds:
            finds.add(kind.split(": ")[0])
            print(f"{name}: {kind}", flush=True)
            if out is not None:
                (out / f"{name}-{len(finds)}").write_bytes(data)
    return count, finds


def main() -> int:
    """Fuzz the chosen targets one after another; return 1 if there are finds."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", default=list(TARGETS), help=", ".join(TARGETS))
    parser.add_argument("--seconds", type=float, default=120, help="for each target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder for inputs that are finds")
    chosen = parser.parse_args()
    if chosen.out:
        chosen.out.mkdir(parents=True, exist_ok=True)
    failed = False
    for name in chosen.targets:
        count, finds = fuzz(name, chosen.seconds, chosen.seed, chosen.out)
        print(f"{name}: {count} inputs, {len(finds)} kinds of finds", flush=True)
        failed = failed or bool(finds)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
