"""The comparison as one HTML file, in the style of the report of a run; it loads no other file and runs no script."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from vaoi_station.files.documents import write_bytes
from vaoi_station.plant.comparison.changes import MOST_LISTED, Changes
from vaoi_station.reporting.drawing.html_page import Section, facts, page, table
from vaoi_station.reporting.drawing.scales import number
from vaoi_station.reporting.drawing.svg import tag, text


def write_changes(
    path: Path, changes: Changes, terms: list[tuple[str, str]], left_out: list[str], unequal: Sequence[str] = ()
) -> None:
    """Write the comparison as a file. The file is complete, or it is not written at all."""
    write_bytes(path, render_changes(changes, terms, left_out, unequal).encode())


def render_changes(
    changes: Changes, terms: list[tuple[str, str]], left_out: list[str], unequal: Sequence[str] = ()
) -> str:
    """Return the comparison as an HTML document.

    Args:
        changes: the comparison.
        terms: name and value of everything that the runs were stitched with.
        left_out: what was left out, and why, in sentences.
        unequal: which runs were not stitched with all that their station used, in sentences.
    """
    sections = [_numbers(changes, terms), _listed("left-out", "Left out", "", left_out)]
    if unequal:
        lead = "These runs may have changed because their archive does not have all that their stations used."
        sections.append(_listed("unequal", "Stitched otherwise than by the station", lead, unequal))
    sections += [_cameras(changes), _boards(changes), _parts(changes)]
    # "</script>" inside a text would end the element; an escaped "<" cannot.
    content = json.dumps(asdict(changes), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    data = tag("script", content, type="application/json", id="changes")
    return page("Runs stitched again", _head(changes, left_out), sections, data)


def _head(changes: Changes, left_out: list[str]) -> str:
    words = f"{changes.changed_boards} of {changes.runs} runs changed" if changes.runs else "nothing to compare"
    style = "failed" if left_out else "degraded" if changes.changed_boards else "ok"
    heading = tag("h1", "Runs stitched again", tag("span", text(words), class_="verdict"))
    return tag("header", heading, tag("p", text("changed: by more than its σ, or in its verdict")), class_=style)


def _numbers(changes: Changes, terms: list[tuple[str, str]]) -> Section:
    verdicts = [(f"{former} → {new}", str(count)) for former, new, count in changes.verdicts]
    counts = [
        ("runs with both results", str(changes.runs)),
        ("runs without a former result", str(changes.only_new)),
        ("positions compared", str(changes.views)),
        ("positions changed", f"{changes.changed_views} ({_share(changes.changed_views, changes.views)})"),
        ("components changed", str(changes.changed_components)),
    ]
    columns = tag("div", facts([*counts, *verdicts]), facts(terms), class_="columns")
    return Section("numbers", "Key numbers", "A verdict stands as former → new, with its number of runs.", columns)


def _listed(name: str, title: str, lead: str, lines: Sequence[str]) -> Section:
    body = tag("ul", *(tag("li", text(line)) for line in lines)) if lines else tag("p", "Nothing.", class_="none")
    return Section(name, title, lead, body)


def _cameras(changes: Changes) -> Section:
    rows = [
        [
            c.station,
            str(c.camera),
            f"{c.changed} of {c.runs}",
            number(c.size_px),
            number(c.x_px),
            number(c.y_px),
            number(c.turn_px),
            number(c.sigma_px),
            number(c.sigmas, 1),
            number(c.view_px),
        ]
        for c in changes.cameras
    ]
    lead = (
        "Change of the displacement that the runs show of each camera, against the median of the station's other "
        "cameras: its length, its parts, its σ in one run, and both in relation. “View” is the motion on the board of "
        "what the camera sees in the middle of its frame. A calibration that is wrong by a displacement shows it in "
        "the first, if the runs correct it; what they do not show stays in the second. The largest change comes first."
    )
    columns = ["station", "camera", "runs changed", "size px", "x px", "y px", "turn px", "σ px", "σ", "view px"]
    return Section("cameras", "Cameras", lead, table(columns, rows, 2) if rows else _none())


def _boards(changes: Changes) -> Section:
    rows = [
        [
            b.station,
            b.run,
            b.board_type,
            b.board_id or "–",
            b.new if b.former == b.new else f"{b.former} → {b.new}",
            f"{b.changed} of {b.views}",
            number(b.rms_px),
            number(b.worst_px),
            number(b.worst_sigmas, 1),
        ]
        for b in changes.boards
    ]
    lead = (
        "Motion of the positions of all components in all frames of a run. At most "
        f"{MOST_LISTED} runs are listed, those with the most changes first; the data set has all."
    )
    columns = ["station", "run", "board type", "board", "verdict", "changed", "rms px", "largest px", "largest σ"]
    return Section("boards", "Boards", lead, table(columns, rows, 5) if rows else _none())


def _parts(changes: Changes) -> Section:
    rows = [
        [
            c.board_type,
            c.component,
            f"{c.changed} of {c.runs}",
            number(c.rms_px),
            number(c.worst_sigmas, 1),
            number(c.x_mm, 4),
            number(c.y_mm, 4),
            number(c.height_mm, 3),
        ]
        for c in changes.components
    ]
    lead = (
        "Motion of a component in the frames, and the mean change of its place and height, over all runs of its board "
        f"type. At most {MOST_LISTED} are listed."
    )
    columns = ["board type", "component", "runs changed", "rms px", "largest σ", "x mm", "y mm", "height mm"]
    return Section("components", "Components", lead, table(columns, rows, 2) if rows else _none())


def _none() -> str:
    return tag("p", "No run has both results.", class_="none")


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "–"
