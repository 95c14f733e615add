"""Film a drawing on the twin, and give the station what the drawing's mistakes leave of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.hostile.drawing import Drawing, changed
from tests.hostile.mistakes import NEAR_COPY, Mistake, spoil
from vaoi_station.calibration.array_calibration import calibrate
from vaoi_station.calibration.camera_fit import Limits
from vaoi_station.files.calibrations import Layout
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Calibration, RecordingHead
from vaoi_station.simulation import Passage, Scenario, Twin, calibration_board
from vaoi_station.simulation.board.layout import board_from_cad

FrameKey = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Film:
    """A filmed drawing: what the station is given, and how it came about.

    Attributes:
        filmed: for each frame that the station is given, by (camera, row), the camera and row that filmed it.
    """

    drawing: Drawing
    passage: Passage
    head: RecordingHead
    calibration: Calibration
    board_type: BoardType
    frames: dict[FrameKey, NDArray[Any]]
    filmed: dict[FrameKey, FrameKey]

    @property
    def twin(self) -> Twin:
        twin = self.passage.twin
        assert isinstance(twin, Twin)
        return twin

    @property
    def places_mm(self) -> dict[str, Floats]:
        """Board coordinates (2,), mm, of the components that the station is asked for, by address.

        With a board type of another board these are the places of its CAD data, from the same corner of the board.
        """
        other = _other_board(self.drawing)
        if other is None:
            return {part.ref: np.array(part.place) for part in self.twin.parts}
        board = board_from_cad(other.board)
        return {c.address: apply(board, np.array(c.center)) for c in self.board_type.components}

    def true_px(self, key: FrameKey, board_mm: Floats) -> Floats:
        """Return where points (k, 2) on the board's surface truly are in a frame of the station, raw pixels."""
        camera, row = self.filmed[key]
        pose = self.passage.pose(self.passage.pulse_times_s[row])
        return self.passage.pinholes[camera].project(apply(pose, board_mm), self.twin.scene.surface_z(board_mm))


def film(drawing: Drawing) -> Film:
    """Render the frames of a drawing's board, and apply its mistakes."""
    faults = _absent(drawing)
    if faults:
        drawing = replace(drawing, scenario=changed(drawing.scenario, {"faults": faults}))
    twin = Twin(drawing.scenario)
    passage = twin.passage(0)
    head = passage.head()
    frames, filmed = passage.render_all(), {(c, r): (c, r) for c in range(len(head.cameras)) for r in range(head.rows)}
    calibration, board_type = twin.calibration, twin.board_type
    for mistake in drawing.mistakes:
        filmed = _wired(mistake, filmed, len(head.cameras), head.rows)
        calibration = _calibrated(mistake, calibration, twin)
        board_type = _typed(mistake, board_type, drawing)
    given = {key: frames[source] for key, source in filmed.items()}
    near = drawing.mistake(NEAR_COPY)
    if near is not None:
        given |= {key: _filmed_again(given[key], near.size) for key, source in filmed.items() if key != source}
    for mistake in drawing.mistakes:
        given = {k: spoil(pixels, mistake) if k[0] == mistake.at else pixels for k, pixels in given.items()}
    missing = tuple(sorted({(c, r) for c in range(len(head.cameras)) for r in range(head.rows)} - set(filmed)))
    head = head.model_copy(update={"missing": missing})
    return Film(drawing, passage, head, calibration, board_type, given, filmed)


def taught(film: Film) -> Film:
    """Film a further board of the board type that the station is given, without any mistake, for a reference."""
    known = _other_board(film.drawing) or film.twin.scenario
    plain = replace(film.drawing, mistakes=(), scenario=known)
    twin = Twin(known.model_copy(update={"faults": type(known.faults)()}))
    passage = twin.passage(1)
    frames = passage.render_all()
    return Film(plain, passage, passage.head(), twin.calibration, twin.board_type, frames, {key: key for key in frames})


def _absent(drawing: Drawing) -> dict[str, Any]:
    mistake = drawing.mistake("absent-parts")
    if mistake is None:
        return {}
    refs = [part.ref for part in Twin(drawing.scenario).parts]
    chosen = np.random.default_rng(drawing.seed).permutation(refs)[: int(mistake.size)]
    return {"absent_parts": tuple({"ref": str(ref)} for ref in chosen)}


def _wired(mistake: Mistake, filmed: dict[FrameKey, FrameKey], cameras: int, rows: int) -> dict[FrameKey, FrameKey]:
    """Return which frame the station is given at each camera and row, after one mistake of frames."""
    at, g = mistake.at, np.random.default_rng(int(1e6 * abs(mistake.angle_rad)))
    middle = 1 + int(g.integers(max(1, rows - 2)))
    lost: set[FrameKey] = set()
    moved: dict[FrameKey, FrameKey] = {}
    match mistake.name:
        case "missing-camera":
            lost = {(at, r) for r in range(rows)}
        case "missing-rows":
            lost = {(c, r) for c in range(cameras) for r in range(middle, middle + int(mistake.size))}
        case "missing-frames":
            keys = sorted(filmed)
            lost = {keys[k] for k in g.permutation(len(keys))[: int(mistake.size)]}
        case "frozen":
            moved = {(at, r): (at, 0) for r in range(rows)}
        case "repeated" | "near-copy":
            moved = {(at, middle): (at, middle - 1)}
        case "late-camera":
            moved = {(at, r): (at, r - 1) for r in range(1, rows)}
            lost = {(at, 0)}
        case "cables-swapped":
            other = (at + 1) % cameras
            moved = {(c, r): (at + other - c, r) for c in (at, other) for r in range(rows)}
    return {key: filmed[moved.get(key, key)] for key in filmed if key not in lost and moved.get(key, key) in filmed}


def _filmed_again(pixels: NDArray[Any], sigma_grey: float) -> NDArray[Any]:
    """Return a picture of the same moment with noise of its own."""
    noise = np.random.default_rng(int(pixels.sum())).normal(0, sigma_grey, pixels.shape)
    return np.asarray(np.clip(np.rint(pixels + noise), 0, np.iinfo(pixels.dtype).max), pixels.dtype)


def _calibrated(mistake: Mistake, known: Calibration, twin: Twin) -> Calibration:
    """Return the calibration that the station is given, after one mistake of the calibration."""
    if mistake.name in {"four-marks", "many-marks"}:
        frames = {camera: pixels for camera, _, pixels in calibration_board.frames(twin)}
        limits = Limits(working_distance_mm=twin.scenario.array.working_distance_mm)
        layout = Layout.model_validate(calibration_board.layout(twin))
        return calibrate(twin.heads, frames.get, layout, limits).calibration()
    if mistake.name == "lens-ignored":
        return known.model_copy(update={"distortion": None})
    change = _PUSHES.get(mistake.name)
    if change is None:
        return known
    matrices = list(known.camera_matrices)
    array = twin.scenario.array
    center = np.array([[1, 0, (array.width_px - 1) / 2], [0, 1, (array.height_px - 1) / 2], [0, 0, 1.0]])
    focal_px = array.working_distance_mm * array.px_per_mm
    moved = center @ change(mistake, focal_px) @ np.linalg.inv(center) @ np.asarray(matrices[mistake.at])
    matrices[mistake.at] = moved / moved[2, 2]
    return known.model_copy(update={"camera_matrices": tuple(matrices)})


def _push(m: Mistake, focal_px: float) -> Floats:
    return np.array([[1, 0, m.size * np.cos(m.angle_rad)], [0, 1, m.size * np.sin(m.angle_rad)], [0, 0, 1.0]])


def _knock(m: Mistake, focal_px: float) -> Floats:
    a = np.copysign(np.radians(m.size), m.angle_rad)
    return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])


def _tilt(m: Mistake, focal_px: float) -> Floats:
    a = np.copysign(np.radians(m.size), m.angle_rad)
    lens = np.diag([focal_px, focal_px, 1.0])
    turn = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    return np.asarray(lens @ turn @ np.linalg.inv(lens))


_PUSHES: Mapping[str, Callable[[Mistake, float], Floats]] = {"pushed": _push, "knocked": _knock, "tilted": _tilt}


def _typed(mistake: Mistake, known: BoardType, drawing: Drawing) -> BoardType:
    """Return the board type that the station is given, after one mistake of the board type."""
    section = drawing.scenario.board
    other = _other_board(drawing)
    changes: dict[str, Any] = {}
    match mistake.name:
        case "other-type" | "other-size" if other is not None:
            return Twin(other).board_type
        case "mirrored":
            changes = {"y_axis": "down" if known.y_axis == "up" else "up"}
        case "fiducial-moved" if known.fiducials:
            mm = abs(board_from_cad(section)[0, 0])
            by = mistake.size / mm * np.array([np.cos(mistake.angle_rad), np.sin(mistake.angle_rad)])
            first = known.fiducials[0]
            moved = first.model_copy(update={"x": first.x + float(by[0]), "y": first.y + float(by[1])})
            changes = {"fiducials": (moved, *known.fiducials[1:])}
        case "fiducial-size":
            size = mistake.size
            changes = {
                "fiducials": tuple(f.model_copy(update={"diameter": f.diameter * size}) for f in known.fiducials)
            }
        case "scaled":
            return _scaled(known, 1 + mistake.size)
    return known.model_copy(update=changes)


def _other_board(drawing: Drawing) -> Scenario | None:
    """Return the scenario of the other board whose board type the station is given; None without such a mistake."""
    section = drawing.scenario.board
    longer = drawing.mistake("other-size")
    if longer is None and drawing.mistake("other-type") is None:
        return None
    k = longer.size if longer else 1.0
    marks = [m.model_dump() | {"y_mm": m.y_mm * k} for m in section.marks]
    update = {"length_mm": section.length_mm * k, "seed": section.seed + 1, "fiducials": marks}
    return changed(drawing.scenario, {"board": update})


def _scaled(known: BoardType, k: float) -> BoardType:
    """Return a board type of which fiducials and outline are too large, and with them the distances of components."""

    def point(p: tuple[float, float]) -> tuple[float, float]:
        return p[0] * k, p[1] * k

    return known.model_copy(
        update={
            "fiducials": tuple(f.model_copy(update={"x": f.x * k, "y": f.y * k}) for f in known.fiducials),
            "components": tuple(c.model_copy(update={"center": point(c.center)}) for c in known.components),
            "outline": known.outline and tuple(point(p) for p in known.outline),
        }
    )
