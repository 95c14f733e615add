"""Figures of measured parts: `python -m tests.cases.parts_proof DIR [--set held-out] [--families FROM TO]`.

Measures the boards of `tests.cases.parts_boards`, each with 1, 3 and 5 good boards of its family, and prints the tables
of docs/measured.md. Good boards are measured, too, each with the others. Intervals are of 95 % (Wilson).
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.cases.parts_boards import SETS
from vaoi_station.library.recordings import open_recording
from vaoi_station.parts import probability
from vaoi_station.parts.document import describe, scale_of
from vaoi_station.parts.learned import TaughtBoard, parts_digest
from vaoi_station.parts.measure import Evidence, Run, collect
from vaoi_station.parts.models import Models

COUNTS = (1, 3, 5)
_CHIPS = frozenset({"R0402", "C0402", "R0603", "C0603", "LED0603", "SOD123", "TANTA"})
_SMALL = frozenset({"R0402", "C0402"})


class Measured(NamedTuple):
    """The parts of one board, measured with some good boards, and the truth."""

    family: str
    board: str
    taught: int
    truth: list[dict[str, Any]]
    packages: list[str]
    evidence: Evidence
    scale: probability.Scale
    parts: list[dict[str, Any]]


def opened(case: Path) -> Run:
    """Open a stitched recording."""
    run = open_recording(case).with_result(case / "result.json")
    assert run.board_type is not None
    return Run(run.board_type, run.result, run.cameras, run.recording.head, lru_cache(96)(run.recording.frame))


def measured(family: Path, counts: Sequence[int] = COUNTS) -> Iterator[Measured]:
    """Measure all boards of a family with some of its good boards, never with themselves."""
    taught = {}
    for path in sorted(family.glob("good-*")):
        run = opened(path)
        digest = parts_digest(run.board_type)
        taught[path.name] = TaughtBoard.of_run(path.name, run.cut(run.board_type.components), digest, "")
    models: dict[tuple[str, ...], Models] = {}
    for n, path in enumerate(sorted(family.glob("*-*"))):
        run, truth = opened(path), json.loads((path / "truth.json").read_text())["parts"]
        others = [name for name in taught if name != path.name]
        for count in counts:
            use = tuple(sorted((others[n % len(others) :] + others)[:count]))
            if use not in models:
                models[use] = Models([taught[name] for name in use])
            patches, evidence = collect(run, models[use], run.board_type.components)
            parts = describe(patches, evidence)
            of = [truth[p.address] for p in patches.parts]
            yield Measured(
                family.name, path.name, count, of, [p.package or "" for p in patches.parts], evidence,
                scale_of(patches, evidence), [parts[p.address] for p in patches.parts],
            )  # fmt: skip


class Row(NamedTuple):
    """One part."""

    family: str
    package: str
    kind: str
    truth: dict[str, Any]
    said: dict[str, Any]


def rows(found: Sequence[Measured], count: int) -> list[Row]:
    """Return the parts that were measured with this number of good boards."""
    return [
        Row(m.family, package, truth["kind"], truth, said)
        for m in found
        if m.taught == count
        for package, truth, said in zip(m.packages, m.truth, m.parts, strict=True)
    ]


def interval(values: Sequence[bool]) -> str:
    """Return how many of some values are true, with the Wilson interval of 95 %."""
    k, n = sum(values), len(values)
    if not n:
        return "–"
    z, p = 1.96, k / n
    middle, scale = p + z * z / (2 * n), 1 + z * z / n
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = max(middle - half, 0) / scale, min((middle + half) / scale, 1)
    return f"{k} of {n} ({100 * low:.2f} to {100 * high:.2f} %)"


def table(some: Sequence[Row]) -> dict[str, str]:
    """Return the figures of parts, each with its name."""
    told = [r for r in some if r.said["presence"] is not None]
    by = {k: [r for r in told if r.kind == k] for k in ("absent", "good", "shifted", "turned", "reversed", "exchanged")}
    present = [r for k, v in by.items() if k not in ("absent", "good") for r in v]

    def marked(which: Sequence[Row]) -> list[bool]:
        return [r.said["presence"] < 0.5 for r in which]

    ways = [r for r in told if r.truth.get("marked") and r.said["orientation"]]
    plain = [r for r in told if r.truth.get("marked") is False and r.said["presence"] >= 0.5]
    reversed_ = [(r.kind, r.said["orientation"].get("180", 0) > 0.5) for r in ways]
    out = {
        "parts; cannot say": f"{len(some)}; {len(some) - len(told)}",
        "absent found": interval(marked(by["absent"])),
        "good marked absent": interval(marked(by["good"])),
        "other present marked absent": interval(marked(present)),
        "reversed found": interval([said for kind, said in reversed_ if kind == "reversed"]),
        "upright called reversed": interval([s for kind, s in reversed_ if kind in ("good", "shifted", "turned")]),
        "no marks: cannot say": interval([r.said["orientation"] is None for r in plain]),
        "exchanged unlike": interval([r.said["alike"] < 0.5 for r in by["exchanged"]]),
        "good unlike": interval([r.said["alike"] < 0.5 for r in by["good"]]),
    }
    for name, kinds in (("good", ("good",)), ("shifted, turned", ("shifted", "turned"))):
        placed = [r for k in kinds for r in by[k] if r.said["dx_mm"] is not None]
        e, z = errors(placed)
        if len(e):
            which = (("place, mm", np.s_[:, :2], "sigma_mm"), ("turn, °", np.s_[:, 2:], "sigma_deg"))
            for what, at, sigma in which:
                many = np.abs(z[at]) > 4
                rms, ratio = (np.sqrt(np.mean(v[at] ** 2)) for v in (e, z))
                out[f"{name}: {what}"] = (
                    f"rms {rms:.4f}; median σ {np.median([r.said[sigma] for r in placed]):.4f}; "
                    f"error/σ {ratio:.2f}; beyond 4 σ {interval(many.ravel().tolist())}"
                )
    return out


def errors(placed: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (n, 3) of places, mm, and turns, degrees, and the same as multiples of σ."""
    e = [
        (r.said["dx_mm"] - r.truth["dx"], r.said["dy_mm"] - r.truth["dy"],
         (r.said["turn_deg"] - r.truth["turn_deg"] + 180) % 360 - 180)
        for r in placed
    ]  # fmt: skip
    sigma = [(r.said["sigma_mm"], r.said["sigma_mm"], r.said["sigma_deg"]) for r in placed]
    return np.array(e).reshape(-1, 3), np.array(e).reshape(-1, 3) / np.array(sigma).reshape(-1, 3)


def reliability(some: Sequence[Row]) -> Iterator[str]:
    """Yield the number of parts, the mean probability and the share that is present, by decile of presence."""
    p = np.array([r.said["presence"] for r in some if r.said["presence"] is not None])
    y = np.array([r.kind != "absent" for r in some if r.said["presence"] is not None])
    for k in range(10):
        here = (p >= k / 10) & ((p < (k + 1) / 10) | (k == 9))
        if here.any():
            yield f"from {k / 10:.1f}: {here.sum()}, stated {p[here].mean():.3f}, true {y[here].mean():.3f}"


GROUPS: dict[str, Callable[[Row], bool]] = {
    "two terminals, 40 px/mm": lambda r: "-40" in r.family and r.package in _CHIPS,
    "two terminals from 0603, 12 px/mm": lambda r: "-12" in r.family and r.package in _CHIPS - _SMALL,
    "0402, 12 px/mm": lambda r: "-12" in r.family and r.package in _SMALL,
    "with leads": lambda r: r.package not in _CHIPS,
    "all, three lights in turn": lambda r: r.family.endswith("lights"),
}


def report(found: Sequence[Measured]) -> None:
    """Print the tables: one for each group of parts, with a column for each number of good boards."""
    counts = sorted({m.taught for m in found})
    for name, belongs in GROUPS.items():
        columns = [table([r for r in rows(found, count) if belongs(r)]) for count in counts]
        print(f"\n| {name} | " + " | ".join(f"{count} good" for count in counts) + " |")
        print("|---" * (len(counts) + 1) + "|")
        for line in columns[0]:
            print(f"| {line} | " + " | ".join(column.get(line, "–") for column in columns) + " |")
    for count in counts:
        print(f"\nreliability of presence, {count} good:", "; ".join(reliability(rows(found, count))))


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("boards", type=Path)
    parser.add_argument("--set", choices=SETS, default="held-out")
    parser.add_argument("--families", type=int, nargs=2, default=(0, 99), metavar=("FROM", "TO"))
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS)
    given = parser.parse_args()
    families = sorted((given.boards / given.set).iterdir())[slice(*given.families)]
    report([m for family in families for m in measured(family, given.counts)])


if __name__ == "__main__":
    main()
