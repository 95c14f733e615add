"""The whole board of a recording as a picture on disk: what `vaoi mosaic` does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vaoi_station.errors import DeviceError
from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.directories import refuse_existing
from vaoi_station.files.documents import write_json
from vaoi_station.files.pyramids import PyramidLayout
from vaoi_station.files.results import read_heights
from vaoi_station.frame_index import FrameIndex
from vaoi_station.library.recordings import check_result
from vaoi_station.model.stitch_result import with_heights
from vaoi_station.mosaic import MosaicGrid, MosaicPlan, choose_frames, make_plan
from vaoi_station.mosaic.frames import frames_of_head
from vaoi_station.mosaic.grid import Region
from vaoi_station.mosaic.tiles import write_mosaic
from vaoi_station.photometry import FlatFields
from vaoi_station.steps import completed
from vaoi_station.stitching.recordings.origin import check_origin

_WHOLE = 0.9995
"""Share of the picture that counts as all of it."""


@dataclass(frozen=True)
class MosaicOrder:
    """What is to be written, and from what. None stands for the default that `vaoi mosaic --help` shows."""

    case: Path
    result: Path
    out: Path
    calibration: Path | None = None
    board: Path | None = None
    px_per_mm: float | None = None
    light: str | None = None
    exposure_us: float | None = None
    hdr: bool = False
    flatfield: Path | None = None
    heights: Path | None = None
    region: Region | None = None

    @property
    def document(self) -> Path:
        """The JSON file beside the picture."""
        return self.out.with_name(f"{self.out.name}.json")


def write_board(order: MosaicOrder) -> Iterator[str]:
    """Write the mosaic and the document beside it, or nothing, and yield lines that say what was written."""
    refuse_existing(order.out)
    refuse_existing(order.document)
    recording = open_recording(order.case)
    head = recording.head
    known = read_calibration(order.calibration or order.case / "calibration.json", head.cameras)
    cameras = known.cameras(head.cameras)
    board_type = read_board_type(order.board or order.case / "board.json")
    stitch = read_stitch(order.result)
    check_result(stitch, head.rows, cameras, order.result)
    check_origin(stitch, recording, known, board_type, order.result)
    if order.heights is not None:
        stitch = with_heights(stitch, read_heights(order.heights, board_type))
    fields = FlatFields.open(order.flatfield) if order.flatfield else FlatFields.none()
    choice = choose_frames(frames_of_head(head), light=order.light, exposure_us=order.exposure_us, hdr=order.hdr)
    fields.check(head.cameras, None if choice.light is None else (choice.light,))
    projector = FrameIndex.of_result(stitch, cameras)
    resolution = projector.px_per_mm
    grid = MosaicGrid.of_board(board_type, order.px_per_mm or resolution, order.region)
    base = MosaicGrid.of_board(board_type, resolution, order.region, most_px=float("inf"))
    steps = make_plan(
        choice, recording.frame, projector=projector, board_type=board_type, stitch=stitch, base=base, fields=fields
    )
    plan = completed(steps)
    layout = write_mosaic(order.out, plan, projector, grid, recording.frame)
    try:
        write_json(order.document, _document(order, plan, grid, layout))
    except DeviceError as error:
        order.out.unlink(missing_ok=True)
        raise DeviceError(
            f"{error.message} {order.out.name} was removed again.",
            action="Free space, and write the mosaic again.",
            code="disk-full",
        ) from error
    size = f"{grid.width}×{grid.height} px, {grid.px_per_mm:.4g} px/mm, {layout.levels} levels"
    yield f"{order.out}: {size}, {layout.bytes / 1e6:.0f} MB"
    if plan.light is not None:
        yield f"light {plan.light!r}"
    if plan.covered < _WHOLE:
        yield f"{100 * (1 - plan.covered):.1f} % of the picture is not covered by frames (value {layout.nodata})"


def _document(order: MosaicOrder, plan: MosaicPlan, grid: MosaicGrid, layout: PyramidLayout) -> dict[str, Any]:
    """Return the content of the file beside the picture; docs/formats.md describes it."""
    return {
        "format": "vaoi-mosaic",
        "version": 1,
        "file": order.out.name,
        "width": grid.width,
        "height": grid.height,
        "px_per_mm": grid.px_per_mm,
        "levels": layout.levels,
        "image_from_cad": grid.mosaic_from_cad.tolist(),
        "cad_from_image": grid.cad_from_mosaic.tolist(),
        "nodata": None if plan.hdr else int(layout.nodata),
        "covered": round(plan.covered, 4),
        "values": "radiance, 8-bit grey levels per µs at gain 1; NaN where no frame shows the board"
        if plan.hdr
        else "grey levels after correction; 0 where no frame shows the board",
        "hdr": plan.hdr,
        "light": plan.light,
        "flat_fields": order.flatfield is not None,
        "exposures_us": sorted({f.taken.exposure_us for f in plan.frames}, reverse=True),
        "reference_us": None if plan.hdr else plan.reference_us,
        "white_balance": [
            None if plan.hdr or i not in plan.cameras else (plan.cameras[i].white_balance or (None,))[0]
            for i in range(max(plan.cameras, default=-1) + 1)
        ],
        "dark": [plan.cameras[i].dark if i in plan.cameras else None for i in range(max(plan.cameras, default=-1) + 1)],
        "frames": [
            {"camera": f.taken.camera, "row": f.taken.row, "gain": round(float(2.718281828459045**f.log_gain), 5)}
            for f in plan.frames
        ],
    }
