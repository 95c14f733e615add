"""The motion of the board in every row, compared with a belt of constant velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.reporting.drawing.html_page import Section, figures, folded, table
from vaoi_station.reporting.drawing.plots import Plot
from vaoi_station.reporting.drawing.scales import number
from vaoi_station.reporting.drawing.svg import text
from vaoi_station.reporting.stitched_run import StitchedRun
from vaoi_station.stitching.adjustment.motion import measured_velocity
from vaoi_station.stitching.quality.findings import Findings

_FEW_ROWS, _NARROW_PX, _WIDE_PX = 24, 374.0, 1150.0
"""Up to `_FEW_ROWS` rows, three narrow curves stand side by side; with more rows, the curves are wide. Widths in px."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Position of the board in each row minus the position on a belt of constant velocity, with standard deviations."""

    velocity_mm_s: Floats
    """Velocity (2,) of the belt: the measured one, else the nominal one."""
    value: Floats
    """Deviations (m, 3) of m rows: along and across the motion in µm; yaw in mrad, from tester x towards y."""
    sigma: Floats
    """Standard deviations (m, 3) of `value`, in the same units."""
    held: tuple[bool, ...]
    """Per row: True if evidence determines its motion, False if only the nominal motion does."""


def deviation(f: Findings) -> Deviation:
    """Compute the deviation of every row, at the centre of the array, relative to row 0."""
    motion, times_s = f.adjusted.motion, f.problem.times_s
    # The longest chain of linked rows gives the best speed; separate chains have no common origin.
    velocity = measured_velocity(motion, times_s, max(f.connected_groups, key=len)) if f.connected_groups else None
    if velocity is None or not np.hypot(*velocity) > 0:
        velocity = np.asarray(f.problem.velocity_mm_s, dtype=np.float64)
    speed = float(np.hypot(*velocity))
    along = velocity / speed if speed else np.array([1.0, 0.0])
    turn = np.array([along, (-along[1], along[0])])
    # `Motion` maps from the row to the board, the inverse of D_j: the displacement of the board has the other sign.
    off = (-motion.shift - velocity * (times_s - times_s[0])[:, None]) @ turn.T
    m = len(times_s)
    blocks = f.adjusted.covariance[:, :3, :3]
    places = np.array([np.diag(turn @ b[1:, 1:] @ turn.T) for b in blocks])
    yaw = np.array([b[0, 0] for b in blocks])
    sigma = np.sqrt(np.maximum(np.column_stack([places * 1e6, yaw * 1e6]), 0))
    value = np.column_stack([off * 1e3, -motion.angle * 1e3])
    rows = {int(r) for group in f.connected_groups for r in group}
    return Deviation(velocity, value, sigma, tuple(j in rows for j in range(m)))


def row_motion(stitched: StitchedRun) -> Section:
    """Return the section that draws how rows deviate from uniform motion: along the belt, across it, in rotation."""
    d = deviation(stitched.findings)
    names = (("along the belt", "µm"), ("across the belt", "µm"), ("yaw", "mrad"))
    width = _NARROW_PX if stitched.head.rows <= _FEW_ROWS else _WIDE_PX
    drawings = [
        (Plot(name, unit, width).draw(d.value[:, k], d.sigma[:, k], d.held), text(f"{name}, {unit}, over rows"))
        for k, (name, unit) in enumerate(names)
    ]
    x, y = d.velocity_mm_s
    lead = (
        f"Position of the board in each row minus that of a belt of constant velocity ({number(x)}, {number(y)}) mm/s, "
        "at the centre of the array, relative to row 0. The band is ±1 σ. Hollow points are rows that only the nominal "
        "motion places."
    )
    columns = ["row", "time s", "along µm", "σ", "across µm", "σ", "yaw mrad", "σ", "placed by", "σ in the image px"]
    listed = folded("figures of every row", table(columns, _rows(stitched, d), 1))
    return Section("motion", "Row motion against the belt", lead, figures(*drawings) + listed)


def _rows(stitched: StitchedRun, d: Deviation) -> Sequence[Sequence[str]]:
    sigma_px = stitched.findings.sigma.rows_px
    times_s = stitched.findings.problem.times_s
    out = []
    for j, (value, sigma) in enumerate(zip(d.value, d.sigma, strict=True)):
        pairs = [number(float(v), n) for k, n in enumerate((1, 1, 4)) for v in (value[k], sigma[k])]
        held = "evidence" if d.held[j] else "nominal motion"
        out.append([str(j), number(float(times_s[j]), 4), *pairs, held, number(sigma_px[j])])
    return out
