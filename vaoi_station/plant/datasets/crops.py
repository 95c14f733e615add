"""The crops of one run: rendered frame by frame, so that one frame is in memory."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import StateError
from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.images import decode, encode_png
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.archive.selection import matches
from vaoi_station.rendering import ChosenImages, ChosenView, ImageRequest, ViewCalculator, choose_all, measure
from vaoi_station.rendering.chooser import render_chosen
from vaoi_station.rendering.description import component_covariances, describe
from vaoi_station.rendering.selection import frame_facts

UNKNOWN = "unknown"
"""Category of components whose package the board type does not state."""


@dataclass(frozen=True)
class CropOptions:
    """Which components are cut out, and which of their pictures."""

    components: tuple[str, ...] = ("*",)
    """References or addresses, or patterns of them with * and ?."""
    images: ImageRequest = field(default_factory=ImageRequest)

    def admits(self, part: Component) -> bool:
        """Return whether a component is wanted."""
        names = (part.ref, part.address)
        return any(matches(name, wanted) for wanted in self.components for name in names)


@dataclass(frozen=True, eq=False)
class Crop:
    """One picture of a component."""

    png: bytes
    """The picture, encoded where it was cut out."""
    facts: dict[str, Any]
    """Everything that is known about it, as JSON values; docs/plant.md lists them."""
    outline_px: NDArray[np.float64] | None
    """Corners (4, 2) of the footprint, px from the upper left corner of the crop; None: no component is there."""

    @property
    def pixels(self) -> NDArray[Any]:
        """Pixels (height, width) or (height, width, 3) blue-green-red."""
        image = decode(self.png)
        assert image is not None  # encoded by this software
        return image

    @property
    def category(self) -> str:
        """Package of the component."""
        return str(self.facts["package"] or UNKNOWN)


def crops_of(run: ArchivedRun, folder: Path, options: CropOptions) -> Iterator[Crop]:
    """Yield the crops of an extracted run, ordered by frame and by component as the board type has them.

    Raises:
        InputError: a document or frame is invalid, or the run has no frame under the light that is asked for.
        StateError: the run has no CAD mapping, so that no component can be found.
    """
    recording = open_recording(folder)
    head = recording.head
    board_type, result = read_board_type(folder / "board.json"), read_stitch(folder / "result.json")
    if result.cad_matrix is None:
        raise StateError(f"run {run.run}: its result has no CAD mapping.", action="Leave out runs that failed.")
    parts = [part for part in board_type.components if options.admits(part)]
    cameras = read_calibration(folder / "calibration.json", head.cameras).cameras(head.cameras)
    facts = frame_facts(head)

    def pixels(camera: int, row: int) -> NDArray[Any]:
        frame = recording.frame(camera, row)
        assert frame is not None  # views of missing frames are left out
        return frame

    chosen = choose_all(
        ViewCalculator(board_type, result, cameras),
        parts,
        (board_type, result),
        (set(facts) - set(head.missing), facts),
        options.images,
        lambda view: measure(view, pixels(view.camera, view.row)),
    )
    by_frame: dict[tuple[int, int], list[tuple[ChosenImages, ChosenView]]] = defaultdict(list)
    for images in chosen:
        for choice in images.chosen:
            by_frame[choice.view.camera, choice.view.row].append((images, choice))
    for at in sorted(by_frame):
        frame = pixels(*at)
        for images, choice in by_frame[at]:
            yield Crop(
                encode_png(render_chosen(choice, frame)),
                _facts(run, board_type, result, images, choice),
                _outline(board_type, images.part, choice),
            )


def _outline(board_type: BoardType, part: Component, choice: ChosenView) -> NDArray[np.float64] | None:
    if part.fitted is False:
        return None
    # From the centre of the first pixel, as in all pictures of the station, to its corner, as in COCO.
    return np.asarray(apply(choice.view.crop_matrix, board_type.footprint(part)) + 0.5)


def _facts(
    run: ArchivedRun, board_type: BoardType, result: Stitch, images: ChosenImages, choice: ChosenView
) -> dict[str, Any]:
    part, view = images.part, choice.view
    covariance = component_covariances(result, part.address).get((view.camera, view.row))
    known = describe(choice, images.covariance_px2(choice, covariance))
    heights, sigmas = result.quality.get("heights_mm"), result.quality.get("height_sigma_mm")
    return {
        "station": run.station,
        "run": run.run,
        "time": run.time,
        "board_type": run.board_type,
        "revision": run.revision,
        "board_id": run.serial,
        "verdict": str(run.verdict or result.status),
        "component": part.address,
        "reference": part.ref,
        "panel": part.panel,
        "package": part.package,
        "fitted": part.fitted,
        "side": board_type.side,
        "rotation_deg": part.rotation,
        "body_height_mm": heights.get(part.address) if isinstance(heights, dict) else None,
        "body_height_sigma_mm": sigmas.get(part.address) if isinstance(sigmas, dict) else None,
        **{name: known[name] for name in _OF_THE_PICTURE},
    }


_OF_THE_PICTURE = (
    "camera", "row", "light", "exposure_us", "gain", "time_s", "sigma_px", "sigma_mm", "coverage", "px_per_mm",
    "view_azimuth_deg", "view_angle_deg", "width_px", "height_px", "crop_from_cad",
)  # fmt: skip
