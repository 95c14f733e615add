"""Run the hostile suite: `python -m tests.hostile --seeds 0:200 --jobs 2 --json OUT`."""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections import Counter
from pathlib import Path

from tests.hostile.drawing import FORM
from tests.hostile.judging import Outcome, judge
from tests.hostile.summary import line, open_classes, table, table_of_mistakes, table_of_reasons


def _seeds(given: str) -> range:
    first, _, last = given.partition(":")
    return range(int(first), int(last)) if last else range(int(first), int(first) + 1)


def main() -> int:
    """Run the drawings of some seeds; return 1 if there are finds that are not known."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile", description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=range(200), help="FIRST:END, END excluded, or one seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--json", type=Path, help="file for all outcomes")
    parser.add_argument("--quiet", action="store_true", help="show finds only")
    chosen = parser.parse_args()
    outcomes: list[Outcome] = []
    with multiprocessing.get_context("spawn").Pool(chosen.jobs) as pool:
        for outcome in pool.imap_unordered(judge, chosen.seeds):
            outcomes.append(outcome)
            if outcome.finds or not chosen.quiet:
                print(line(outcome), flush=True)
                for sentence in (*outcome.reasons, *outcome.messages):
                    print(f"         {sentence}", flush=True)
            if chosen.json:
                # Written after every drawing, so that a run that is ended early leaves its finds.
                chosen.json.write_text(
                    json.dumps({"form": FORM, "outcomes": [o.document() for o in outcomes]}, indent=1), encoding="utf-8"
                )
    outcomes.sort(key=lambda o: o.seed)
    states = Counter(o.status for o in outcomes)
    expected = sum(o.expected for o in outcomes)
    print(f"\n{len(outcomes)} drawings, {expected} of which a right answer is expected; {dict(states)}\n")
    print(table(outcomes), table_of_mistakes(outcomes), table_of_reasons(outcomes), sep="\n\n")
    return int(any(set(o.finds) - open_classes(o.seed) for o in outcomes))


if __name__ == "__main__":
    raise SystemExit(main())
