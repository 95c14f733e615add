"""Heights of components of the recorded cases.

`python -m tests.cases.heights CASES [NAME…]` prints the table of docs/measured.md.

Each case is stitched and measured as the commands do, and compared with its truth: parts of at least 0.5 mm that two
frames or more show; measured means a standard deviation of at most 0.15 mm.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

CASES = ("ulx3s-top", "repetitive", "rough", "lights", "hdr-rows", "sparse", "warped", "paper-1", "paper-2", "paper-3")
_LEAST_MM, _MEASURED_MM = 0.5, 0.15


def measure(case: Path) -> dict[str, Any]:
    """Stitch a recording and return the heights of its components."""
    with tempfile.TemporaryDirectory() as folder:
        result, heights = Path(folder) / "result.json", Path(folder) / "heights.json"
        _run("stitch", case, "--out", result)
        _run("heights", case, "--result", result, "--out", heights)
        found: dict[str, Any] = json.loads(heights.read_text(encoding="utf-8"))
    return found


def errors(found: dict[str, Any], truth: dict[str, Any]) -> tuple[int, np.ndarray]:
    """Return the number of tall parts, and error and standard deviation (k, 2) of those that are measured, mm."""
    tall = [
        ref
        for ref, mm in truth["heights"].items()
        if mm >= _LEAST_MM and len({(i, j) for i, j, *_ in truth["views"].get(ref, ())}) >= 2
    ]
    pairs = [
        (found[ref]["height_mm"] - truth["heights"][ref], found[ref]["sigma_mm"])
        for ref in tall
        if ref in found and found[ref]["height_mm"] is not None and found[ref]["sigma_mm"] <= _MEASURED_MM
    ]
    return len(tall), np.array(pairs).reshape(-1, 2)


def row(name: str, tall: int, pairs: np.ndarray) -> str:
    """Return one line of the table."""
    if not len(pairs):
        return f"| {name} | 0 of {tall} | – | – | – | – |"
    error, z = np.abs(pairs[:, 0]), pairs[:, 0] / pairs[:, 1]
    return (
        f"| {name} | {len(pairs)} of {tall} | {np.median(error):.3f} | {np.percentile(error, 90):.3f} "
        f"| {np.sqrt((z**2).mean()):.2f} | {int((np.abs(z) > 3).sum())} |"
    )


def main() -> None:
    """Print the table of the cases in a folder."""
    folder, *names = sys.argv[1:]
    print("| case | measured | median error, mm | 90 %, mm | error/σ, rms | beyond 3 σ |\n|---|---|---|---|---|---|")
    total = 0
    everything: list[np.ndarray] = []
    for name in names or CASES:
        case = Path(folder) / name
        tall, pairs = errors(measure(case), json.loads((case / "truth.json").read_text(encoding="utf-8")))
        total, everything = total + tall, [*everything, pairs]
        print(row(name, tall, pairs), flush=True)
    print(row("all", total, np.concatenate(everything)))


def _run(*arguments: str | Path) -> None:
    command = [sys.executable, "-m", "vaoi_station", *map(str, arguments)]
    subprocess.run(command, capture_output=True, text=True, check=True)


if __name__ == "__main__":
    main()
