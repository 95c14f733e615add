"""Build the demo report from the service's replies and the twin's truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from vaoi_station.demo.demo_report import LIMIT_PX, Belt, DemoReport, DemoTimings, LinkCount, Residuals
from vaoi_station.demo.truth_comparison import Deviation, compare_with_truth, true_speed_mm_s
from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.schemas import VerdictCounts
from vaoi_station.simulation import Passage


@dataclass(frozen=True, eq=False)
class ServiceReplies:
    """The replies of the service about one run: the document of the run, and its matrices ({} if it has none)."""

    run: dict[str, Any]
    matrices: dict[str, Any]

    @property
    def quality(self) -> dict[str, Any]:
        """The figures on which the verdict is based."""
        return dict(self.matrices.get("quality", {}))


@dataclass(frozen=True)
class Output:
    """The output of the demo: directory, contact sheet, number of components and pictures, and times."""

    directory: str
    contact_sheet: str
    components: int
    pictures: int
    pictures_s: float
    total_s: float


def evaluate(scenario: str, answers: ServiceReplies, passage: Passage, output: Output) -> DemoReport:
    """Compare the result of one board with the truth and collect all figures."""
    run = answers.run
    status = Status(run["verdict"])
    # A failed run has no matrices: then every view of the truth counts as unplaced.
    found = compare_with_truth(
        passage.truth()["views"],
        answers.matrices.get("components") or {},
        [camera.px_per_mm for camera in passage.twin.cameras],
    )
    return DemoReport(
        ok=status is Status.OK and within_limit(found),
        scenario=scenario,
        board_type=run["board_type"],
        run=run["id"],
        status=status,
        reasons=tuple(Reason.model_validate(reason) for reason in run["reasons"]),
        cameras=run["cameras"],
        rows=run["rows"],
        frames=VerdictCounts.model_validate(run["counts"]),
        residuals=_residuals(answers.quality),
        belt=_belt(run, passage),
        sigma_px=answers.quality.get("cad_sigma_px"),
        deviation=found,
        timings=_timings(run, answers.quality, output),
        components=output.components,
        pictures=output.pictures,
        out=output.directory,
        contact_sheet=output.contact_sheet,
    )


def within_limit(found: Deviation) -> bool:
    """Return whether a result is as close to the truth as it must be with the verdict ok."""
    return found.unplaced == 0 and found.max_px <= LIMIT_PX


def _residuals(quality: dict[str, Any]) -> Residuals:
    residual = quality.get("residual_px", {})
    fiducials = {f["name"]: f["residual_px"] for f in quality.get("fiducials", [])}
    return Residuals(
        links={kind: LinkCount(**count) for kind, count in quality.get("links", {}).items()},
        link_median_px=residual.get("median"),
        link_scatter_px=residual.get("scatter"),
        fiducials_px={name: None if off is None else round(math.hypot(*off), 4) for name, off in fiducials.items()},
    )


def _belt(run: dict[str, Any], passage: Passage) -> Belt:
    belt = run.get("belt")
    return Belt(
        nominal_mm_s=passage.twin.line.speed_mm_s,
        measured_mm_s=round(math.hypot(*belt["measured_mm_s"]), 4) if belt else None,
        true_mm_s=round(true_speed_mm_s(passage), 4),
    )


def _timings(run: dict[str, Any], quality: dict[str, Any], output: Output) -> DemoTimings:
    timings = run.get("timings", {})
    return DemoTimings(
        filming_s=_rounded(timings.get("filming_s"), 4),
        ready_after_last_frame_ms=_rounded(timings.get("ready_after_last_frame_ms"), 2),
        links=timings.get("links", 0),
        links_while_filming=timings.get("links_while_filming", 0),
        links_ms=round(timings.get("links_ms", 0.0), 2),
        conclude_ms=round(timings.get("conclude_ms", 0.0), 2),
        stages_ms=quality.get("timings_ms", {}),
        pictures_s=round(output.pictures_s, 3),
        total_s=round(output.total_s, 3),
    )


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
