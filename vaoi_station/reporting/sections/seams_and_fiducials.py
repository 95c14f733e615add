"""The sections on seams between cameras and on fiducials, where a wrong calibration shows first."""

from __future__ import annotations

import numpy as np

from vaoi_station.reporting.drawing.html_page import Section, figures, table
from vaoi_station.reporting.drawing.scales import number, round_up
from vaoi_station.reporting.drawing.svg import drawing, label, tag, text, title
from vaoi_station.reporting.stitched_run import StitchedRun

_SIDE = 300.0
_COLOURS = ("#22456b", "#c0561a", "#18603f", "#7a2a6b", "#6b6b18", "#1a7f8c")


def seams(stitched: StitchedRun) -> Section:
    """Return the section that shows how well the links of each pair of neighbouring cameras agree, over all rows."""
    f, rows = stitched.findings, []
    for i in range(stitched.cameras - 1):
        pairs = [p for p in stitched.pairs if p.links.task.kind == "neighbours" and p.a[0] == i]
        used = sum(p.used for p in pairs)
        # The mean over all rows weighs each pair of frames by its number of links.
        squares = [p.residual_px**2 * p.used for p in pairs if p.residual_px is not None]
        rms = (sum(squares) / used) ** 0.5 if used else None
        strange = f.non_overlapping_pairs.get((i, i + 1))
        note = f"the frames do not overlap in {strange} rows" if strange else "" if used else "no links"
        rows.append(
            [f"{i} – {i + 1}", str(used), str(len(pairs)), number(f.seams_px.get((i, i + 1))), number(rms), note]
        )
    if not rows:
        return Section("seams", "Seams between cameras", "", tag("p", "There is one camera only.", class_="none"))
    lead = (
        "The median residual on the bare board shows whether two cameras are still where they were calibrated; “–” "
        "with fewer than twelve links."
    )
    columns = ["cameras", "links", "pairs of frames", "median residual px", "rms px", ""]
    return Section("seams", "Seams between cameras", lead, table(columns, rows, 1))


def fiducials(stitched: StitchedRun) -> Section:
    """Return the section that compares the detected positions of fiducials with those that the result predicts."""
    listed = stitched.result.quality["fiducials"]
    if not listed:
        why = "The board was not found." if stitched.opened.setup.board_type else "There is no board type."
        return Section("fiducials", "Fiducials", "", tag("p", text(why), class_="none"))
    rows = [
        [
            f["name"],
            str(f["sightings"]),
            *(number(v, 4) for v in f["residual_px"] or (None, None)),
            _length(f["residual_px"]),
        ]
        for f in listed
    ]
    columns = ["fiducial", "detections", "mean x px", "mean y px", "length px"]
    lead = (
        "Residuals of single detections along the tester's axes. Two fiducials determine the position; more check it."
    )
    return Section("fiducials", "Fiducials", lead, figures((_target(stitched), ""), (table(columns, rows, 1), "")))


def _length(residual: list[float] | None) -> str:
    return number(float(np.hypot(residual[0], residual[1])) if residual else None, 4)


def _target(stitched: StitchedRun) -> str:
    """Draw the residuals of all detections as dots around the point of zero residual."""
    f = stitched.findings
    points = f.problem.fiducials
    if points is None or f.plane is None or not (points.which >= 0).any():
        return ""
    mine = points.which >= 0
    off, which, rows = f.adjusted.fiducial_px[mine], points.which[mine], points.row[mine]
    reach = round_up(max(float(np.hypot(*off.T).max()), 0.02))
    scale = (_SIDE / 2 - 16) / reach
    content = []
    for share in (0.5, 1.0):
        r = share * reach * scale
        content.append(tag("circle", cx=_SIDE / 2, cy=_SIDE / 2, r=r, fill="none", stroke="#c9ced3"))
        content.append(label(_SIDE / 2 + 3, _SIDE / 2 - r - 3, f"{share * reach:g} px", class_="faint"))
    content.append(tag("line", x1=0, x2=_SIDE, y1=_SIDE / 2, y2=_SIDE / 2, stroke="#e2e6e9"))
    content.append(tag("line", x1=_SIDE / 2, x2=_SIDE / 2, y1=0, y2=_SIDE, stroke="#e2e6e9"))
    names = [x.name for x in f.plane.board_type.fiducials]
    for (x, y), n, row in zip(off, which, rows, strict=True):
        tooltip = title(f"{names[n]}, row {row}: ({number(float(x))}, {number(float(y))}) px")
        at = {"cx": _SIDE / 2 + float(x) * scale, "cy": _SIDE / 2 + float(y) * scale}
        content.append(tag("circle", tooltip, **at, r=4.0, fill=_COLOURS[n % len(_COLOURS)], fill_opacity=0.75))
    return drawing(_SIDE, _SIDE, *content, label="residuals of fiducials")
