"""The figures of one board whose development is of interest, and what they depend on."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.lamp_watch import DIM_SHARE
from vaoi_station.drift.watch import LEAST_PX
from vaoi_station.geometry.displacement import rms_displacement_px
from vaoi_station.model import Stitch
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.stitching.quality.findings import SEAM_LIMIT_PX
from vaoi_station.stitching.quality.verdict import OK_SIGMA_PX

_DIGITS = 5
"""Significant digits that are kept."""


class Figure(NamedTuple):
    """What is known of a figure besides its values."""

    lower: float | None = None
    """Limit below which a value is conspicuous."""
    upper: float | None = None
    """Limit above which a value is conspicuous."""
    better: int = -1
    """1: larger is better; -1: smaller is; 0: neither."""
    counts: bool = False
    """Whether it is a count, which is 0 on most boards."""


FIGURES = {
    "residual_px": Figure(),
    "seam_px": Figure(upper=SEAM_LIMIT_PX),
    "sigma_px": Figure(upper=OK_SIGMA_PX),
    "belt_mm_s": Figure(better=0),
    "slip_percent": Figure(better=0),
    "brightness_percent": Figure(lower=100 * DIM_SHARE, better=0),
    "drift_px": Figure(upper=LEAST_PX),
    "ready_ms": Figure(),
    "lost_frames": Figure(upper=0.0, counts=True),
    "unseen_parts": Figure(upper=0.0, counts=True),
}
"""All figures by name, in the order in which they are listed. The limits are those of verdict and watch."""


def key_of(figure: str, part: str = "") -> str:
    """Return the name under which a figure of a part is kept."""
    return f"{figure}:{part}" if part else figure


def has_only_lower_limit(key: str) -> bool:
    """Return whether a value of a figure, by `key_of`, is conspicuous only if it is low."""
    known = FIGURES.get(key.partition(":")[0], Figure())
    return known.lower is not None and known.upper is None


def figures_of(detail: RunDetail, stitch: Stitch | None) -> dict[str, float]:
    """Return the figures of a run that has ended, by `key_of`; those that it does not have are left out."""
    found: dict[str, float | None] = {}
    if stitch is not None:
        quality = stitch.quality
        found["residual_px"] = (quality.get("residual_px") or {}).get("median")
        found["sigma_px"] = quality.get("cad_sigma_px")
        found |= {key_of("seam_px", pair): px for pair, px in (quality.get("seams_px") or {}).items()}
        found["unseen_parts"] = len(detail.unseen)
    if detail.belt is not None:
        found["belt_mm_s"] = math.hypot(*detail.belt.measured_mm_s)
        found["slip_percent"] = 100 * (detail.belt.ratio - 1)
    if detail.timings is not None:
        found["ready_ms"] = detail.timings.ready_after_last_frame_ms
    found["lost_frames"] = detail.counts.incomplete + detail.counts.missing + detail.counts.unproven
    return _rounded(found)


def figures_of_check(check: RunCheck, cameras: Sequence[str]) -> dict[str, float]:
    """Return the figures of a drift check: displacements of cameras, and brightness against the first boards."""
    found: dict[str, float | None] = {
        key_of("drift_px", name): rms_displacement_px(camera.displacement_px)
        for name, camera in zip(cameras, check.cameras, strict=True)
        if camera.seen
    }
    shares: dict[str, list[float]] = defaultdict(list)
    for lamp in check.lamps:
        if lamp.baseline is not None:
            share = lamp.grey / lamp.exposure / lamp.baseline.brightness
            shares["/".join(filter(None, (cameras[lamp.camera], lamp.light)))].append(100 * share)
    # A light with several exposures has one figure.
    found |= {key_of("brightness_percent", part): sum(values) / len(values) for part, values in shares.items()}
    return _rounded(found)


def made_with_of(detail: RunDetail) -> dict[tuple[str, str], str]:
    """Return what the figures of a run depend on, by (kind, board type); the type is empty if it concerns all."""
    known = {("calibration", ""): detail.calibration, ("software", ""): detail.software.station}
    name, made = detail.board_type, detail.made_with
    if made is not None:
        known |= {
            ("configuration", ""): made.configuration,
            ("board-type", name): made.board_type,
            ("reference", name): made.reference or "",
        }
    # Frames that did not arrive have no exposure: of such a run it is not known whether the light has changed.
    if detail.frames and all(frame.exposure_us is not None for frame in detail.frames):
        steps = {(frame.light, f"{frame.exposure_us:.3g}", f"{frame.gain or 1:.3g}") for frame in detail.frames}
        words = (f"{light} {us} µs × {gain}".strip() for light, us, gain in sorted(steps))
        known["light", name] = ", ".join(words)[:500]
    return known


def _rounded(found: dict[str, float | None]) -> dict[str, float]:
    return {
        key: float(f"{value:.{_DIGITS}g}") for key, value in found.items() if value is not None and math.isfinite(value)
    }
