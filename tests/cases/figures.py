"""Figures of the recorded cases: measured once, stored in docs/measured/figures.json, shown in documents from there.

    python -m tests.cases.figures CASES     measures all cases in a folder made by shared/cases/make.py
    python -m tests.cases.figures           renders the documents from the file

The recordings are rendered by an independent program from photographs of real boards; its truth is known.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.needs import FILMS

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "docs" / "measured" / "figures.json"
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "measured.md", ROOT / "docs" / "how-to" / "stitch.md")
CASES = {
    "paper-1": "the paper's experiment, one camera (there 0.53 to 1.23 mm, real hardware)",
    "paper-2": "belt speed varies by 2 % per row",
    "paper-3": "the board turns while it moves",
    "ulx3s-top": "3 cameras, CAD in inches, y up",
    "ulx3s-top-again": "a second passage of the same board type",
    "sparse": "little texture, opposite belt direction",
    "dark": "half the light",
    "hdr": "neighbouring cameras with a 4.5 : 1 exposure ratio",
    "hdr-wide": "neighbouring cameras with a 17 : 1 exposure ratio, 2.5 decades of radiance",
    "hdr-rows": "rows in turn with a 17 : 1 exposure ratio",
    "lights": "the lamp above, left and right of the board in turn",
    "distorted": "0.8 px of lens distortion",
    "fixture": "a fixture with marks",
    "repetitive": "a repeated pattern",
    "warped": "lifted by 0.5 mm, bowed by 0.8 mm",
    "rough": "a lost row, glare, flicker, slip, tall parts",
}
"""What is difficult about each case."""
_BLOCK = re.compile(r"(<!-- figures: ([a-z]+) -->\n?)(.*?)(\n?<!-- end -->)", re.DOTALL)


def measure(folder: Path) -> dict[str, dict[str, Any]]:
    """Stitch and score every case in a folder."""
    return {name: score(folder / name) for name in CASES}


def score(case: Path) -> dict[str, Any]:
    """Stitch one case as the command does and return its verdict, errors and predicted σ."""
    result = case / "figures-result.json"
    _run("-m", "vaoi_station", "stitch", case, "--out", result)
    scored = json.loads(_run(FILMS / "score.py", case, result))
    stitched = json.loads(result.read_text(encoding="utf-8"))
    result.unlink()
    return figures_of(stitched["status"], scored, stitched["quality"]["cad_sigma_px"])


def figures_of(status: str, scored: dict[str, Any], sigma_px: float) -> dict[str, Any]:
    """Return the figures that documents show, rounded as they are shown."""
    return {
        "status": status,
        "rms_px": round(scored["cad_px"]["rms"], 3),
        "max_px": round(scored["cad_px"]["max"], 3),
        "mean_mm": round(scored["cad_mm"]["mean"], 4),
        "sigma_px": round(sigma_px, 3),
    }


def rendered(text: str, figures: dict[str, dict[str, Any]]) -> str:
    """Return a document with its blocks of figures made from the file."""
    return _BLOCK.sub(lambda m: m[1] + _RENDER[m[2]](figures) + m[4], text)


def _table(figures: dict[str, dict[str, Any]]) -> str:
    columns = ("case", "difficulty", "verdict", "error, px rms / max", "mean, mm", "predicted σ, px")
    head = f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|\n"
    rows = (
        f"| {name} | {CASES[name]} | {f['status']} | {f['rms_px']:.3f} / {f['max_px']:.3f} "
        f"| {f['mean_mm']:.4f} | {f['sigma_px']:.3f} |"
        for name, f in figures.items()
    )
    return head + "\n".join(rows)


def _range(figures: dict[str, dict[str, Any]]) -> str:
    rms = [f["rms_px"] for f in figures.values()]
    return f"{min(rms):.3f} to {max(rms):.3f} px rms"


def _millimetres(figures: dict[str, dict[str, Any]]) -> str:
    mean = [figures[name]["mean_mm"] for name in ("paper-1", "paper-2", "paper-3")]
    return f"{min(mean):.4f} to {max(mean):.4f} mm"


_RENDER: dict[str, Callable[[dict[str, dict[str, Any]]], str]] = {
    "cases": _table,
    "range": _range,
    "millimetres": _millimetres,
}


def _run(*arguments: str | Path) -> str:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def main() -> None:
    """Measure if a folder of cases is given; then render the documents."""
    if len(sys.argv) > 1:
        FIGURES.write_text(json.dumps(measure(Path(sys.argv[1])), indent=1) + "\n", encoding="utf-8")
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    for path in DOCUMENTS:
        path.write_text(rendered(path.read_text(encoding="utf-8"), figures), encoding="utf-8")


if __name__ == "__main__":
    main()
