"""The digital twin of one scenario, and the passages of its boards: their frames, times, faults and truth.

A frame is a pure function of scenario, board number, camera and row. Frames that were rendered before do not change it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, Calibration, CameraHead, Distortion, ProgramRow, RecordingHead
from vaoi_station.model.recording import row_of
from vaoi_station.simulation.board.artwork import Artwork, draw
from vaoi_station.simulation.board.bodies import Body
from vaoi_station.simulation.board.canvas import Plane
from vaoi_station.simulation.board.layout import Part, board_type, place_parts
from vaoi_station.simulation.board.printed_code import code_text, draw_label, identity_of
from vaoi_station.simulation.imaging.pinholes import Pinhole, mount_cameras
from vaoi_station.simulation.imaging.scene import LitTextures, Placement, Scene
from vaoi_station.simulation.imaging.sensor import expose, generator, vignette
from vaoi_station.simulation.imaging.surroundings import Surroundings
from vaoi_station.simulation.motion.faults import PassageFaults
from vaoi_station.simulation.motion.timetable import line_of, timetable
from vaoi_station.simulation.scenario import BoardSection, Scenario
from vaoi_station.simulation.truth import passage_truth

TEXTURE_PER_PIXEL = 1.1
"""Texture resolution divided by image resolution. A lower value would blur frames, a much higher one would alias."""
_SLOPE_S = 1e-4
MakeArtwork = Callable[[BoardSection, float, float], Artwork]
"""Function of board section, resolution in px/mm and grey of the belt."""


class Twin:
    """What is the same for every board of a scenario: cameras, calibration, line, board type, artwork, light.

    Attributes:
        scenario: the scenario, which determines everything else.
        pinholes: the cameras with their real mounting errors, before any fault.
    """

    def __init__(self, scenario: Scenario, artwork: MakeArtwork | None = None) -> None:
        """Prepare a twin; `artwork` draws its boards; None: `draw`, whose latest drawings this process keeps."""
        self.scenario, self._make_artwork = scenario, artwork or _artwork
        self.pinholes: tuple[Pinhole, ...] = mount_cameras(scenario.array)
        self._paints: dict[tuple[str, int], LitTextures] = {}
        self._shades: dict[tuple[int, str], Plane] = {}

    def passage(self, board_number: int) -> Passage:
        """Return the passage of board `board_number`, counted from 0."""
        return Passage(self, board_number)

    @cached_property
    def program(self) -> tuple[ProgramRow, ...]:
        """The light program of the scenario with all its values; empty without one."""
        return program_of(self.scenario)

    @cached_property
    def calibration(self) -> Calibration:
        """The exact calibration of the array. It contains distortion only if the scenario has distortion."""
        array = self.scenario.array
        lenses = tuple(
            Distortion(center=p.lens.center_px, radius=p.lens.radius_px, radial=p.lens.radial) for p in self.pinholes
        )
        return Calibration(
            format="vaoi-calibration",
            version=1,
            unit="mm",
            camera_matrices=tuple(p.plane() for p in self.pinholes),
            working_distance_mm=array.working_distance_mm,
            distortion=lenses if array.distortion_px else None,
        )

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras with the matrices and lenses of the exact calibration."""
        return self.calibration.cameras(self.heads)

    @cached_property
    def heads(self) -> tuple[CameraHead, ...]:
        """The cameras as the head of a recording lists them: frame size, exposure time and nominal view."""
        array = self.scenario.array
        return tuple(
            CameraHead(
                width=array.frame_px(i)[0],
                height=array.frame_px(i)[1],
                exposure_us=array.exposure_us(i),
                nominal_center_mm=(array.center_mm(i), 0.0),
                nominal_px_per_mm=array.resolution_px_per_mm(i),
                nominal_roll_deg=array.design_roll_deg(i) or None,
                bits=16 if array.bits == 16 else None,
            )
            for i in range(array.cameras)
        )

    @cached_property
    def line(self) -> Line:
        """The mechanics of the line, in the form of the `[line]` section of `station.toml`."""
        return line_of(self.scenario)

    @cached_property
    def artwork(self) -> Artwork:
        """The artwork of the boards. Twins with equal board section, resolution and belt share one artwork."""
        s = self.scenario
        return self._make_artwork(s.board, TEXTURE_PER_PIXEL * s.array.finest_px_per_mm, s.belt.grey)

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts of the board type; they are known without drawing the board."""
        return place_parts(self.scenario.board)

    @cached_property
    def board_type(self) -> BoardType:
        """The CAD description of the boards."""
        return board_type(self.scenario.board, self.parts, identity_of(self.scenario.board))

    @cached_property
    def scene(self) -> Scene:
        """The scene that the cameras render: surface and artwork of the board, and what lies beside it."""
        s = self.scenario
        beside = Surroundings(s.texture, s.carrier, s.board, s.belt.grey, TEXTURE_PER_PIXEL * s.array.px_per_mm)
        visible = s.texture.sigma_grey > 0 or s.carrier.rim_mm > 0
        return Scene(s.board, self.artwork, s.belt.grey, beside if visible else None)

    def paint(self, light_name: str, pose: Floats) -> LitTextures:
        """Return the board's textures under a light pattern, at a pose tester_from_board (3, 3)."""
        light = self.scenario.lights[light_name]
        # The relief of solder is shaded for the nearest quarter turn.
        quarter = round(math.atan2(pose[1, 0], pose[0, 0]) / (math.pi / 2)) % 4 if light.relief else 0
        key = (light_name, quarter)
        if key not in self._paints:
            self._paints[key] = LitTextures(self.artwork, light, quarter * math.pi / 2)
        return self._paints[key]

    def shade(self, camera: int, light_name: str) -> Plane:
        """Return the relative brightness (h, w) of a frame: its vignetting times the light's slope over it."""
        key = (camera, light_name)
        if key not in self._shades:
            array, light = self.scenario.array, self.scenario.lights[light_name]
            width_px, height_px = array.frame_px(camera)
            x, y = np.linspace(-1, 1, width_px), np.linspace(-1, 1, height_px)
            slope = 1 + light.shading * 0.5 * (light.direction[0] * x[None] + light.direction[1] * y[:, None])
            self._shades[key] = np.asarray(vignette(array, camera) * slope, np.float32)
        return self._shades[key]


class Passage:
    """The passage of one board through the line. Times are in seconds since its start.

    Attributes:
        start_s: start of the passage, in seconds since the start of the scenario.
        blocked_s: time at which the board interrupts the barrier.
        clear_s: time at which the board leaves the barrier; infinite if it stays there.
        pulse_times_s: times of the pulses that a controller sends, one per row.
        encoder: counts of the belt's encoder, which space the rows; None if the controller's clock spaces them.
        turned_deg: rotation of the board on the belt, counter-clockwise as the camera sees it.
        lights: name of the light pattern of each row.
        pinholes: the cameras as they are now; a camera may have been knocked since its calibration.
    """

    def __init__(self, twin: Twin, board_number: int) -> None:
        self.twin, self.board_number = twin, board_number
        times = timetable(twin.scenario, board_number)
        self._motion, self.start_s = times.motion, times.motion.start_s
        self.blocked_s, self.clear_s, self.turned_deg = times.blocked_s, times.clear_s, times.turned_deg
        self.pulse_times_s, self.encoder = times.pulse_times_s, times.encoder
        self.faults = PassageFaults(twin.scenario.faults, board_number, self.blocked_s)
        self.pinholes = self.faults.hanging(twin.pinholes)
        names = [row.light for row in twin.program] or twin.scenario.line.lights
        self.lights = tuple(names[row % len(names)] for row in range(self.rows))

    @property
    def rows(self) -> int:
        """Number of pulses and so of rows, the paper's m."""
        return len(self.pulse_times_s)

    @cached_property
    def placements(self) -> dict[str, Placement | None]:
        """Placement error of each part of this board by its name; None for an absent part."""
        scenario, known = self.twin.scenario, {p.ref for p in self.twin.parts}
        for n, fault in enumerate(scenario.faults.absent_parts):
            if fault.ref not in known:
                raise InputError.field("scenario", f"faults.absent_parts.{n}.ref", fault.ref, "a part of this board")
        sigma = scenario.board.placement_sigma_mm
        g = np.random.default_rng([scenario.board.seed, 7040, self.board_number])
        result: dict[str, Placement | None] = {}
        for part in self.twin.parts:
            # Random numbers are drawn for absent parts too, so that the placement of other parts does not change.
            x, y, turn = g.normal(0, 1, 3) * (sigma, sigma, sigma / 3)
            placed = Placement((float(x), float(y)), float(turn))
            result[part.ref] = None if self.faults.absent(part.ref) else placed
        return result

    @property
    def code_texts(self) -> tuple[str, ...]:
        """The texts of this board's codes, in the order of the scenario."""
        board = self.twin.scenario.board
        return tuple(code_text(code, board.name, self.board_number) for code in board.codes)

    @cached_property
    def labels(self) -> tuple[Body, ...]:
        """The labels of this board."""
        board, px_per_mm = self.twin.scenario.board, self.twin.artwork.px_per_mm
        return tuple(draw_label(code, board.name, self.board_number, px_per_mm) for code in board.codes)

    def pose(self, t_s: float) -> Floats:
        """Return tester_from_board at a time: a rigid transform (3, 3) from board mm to tester mm.

        Board coordinates have their origin in the top left corner as the camera sees the board, with y down.
        """
        board = self.twin.scenario.board
        return self._motion.pose(t_s, (board.width_mm / 2, board.length_mm / 2))

    def frame(self, camera: int, row: int) -> NDArray[Any]:
        """Render the complete frame (h, w) of a camera and row, even if a fault prevents its arrival."""
        filmed = row_of(self.twin.program, row)
        return self.frame_at(camera, self.pulse_times_s[row], self.lights[row], row, filmed)

    def frame_at(
        self, camera: int, t_s: float, light_name: str, noise_key: int, filmed: ProgramRow | None = None
    ) -> NDArray[Any]:
        """Render the frame (h, w) of a camera at any time, the middle of the exposure.

        `noise_key` selects the random numbers for noise and flicker: the row for a frame of a pulse. `filmed` gives
        exposure, on-time and gain; by default they are those of the scenario's cameras.
        """
        twin, array = self.twin, self.twin.scenario.array
        light = twin.scenario.lights[light_name]
        pose = self.pose(t_s)
        samples = twin.scene.view(
            self.pinholes[camera],
            pose,
            paint=twin.paint(light_name, pose),
            light=light,
            placements=self.placements,
            belt_pose=self._motion.belt_pose(t_s, twin.scenario.texture.follows),
            labels=self.labels,
        )
        exposure_us = array.exposure_us(camera) if filmed is None else filmed.lit_us[camera]
        gain = 1.0 if filmed is None else filmed.gains[camera]
        # The flicker of a row is equal for all cameras.
        numbers = generator(array.seed, 7006, self.board_number, noise_key)
        flicker = 1 + array.flicker * float(numbers.standard_normal())
        relative = exposure_us / array.reference_exposure_us
        return expose(
            samples,
            array,
            motion_px=self._motion_px(camera, t_s, exposure_us),
            brightness=relative * array.gain * gain * light.camera_gain(camera) * flicker,
            shade=twin.shade(camera, light_name),
            noise=generator(array.seed, 7005, self.board_number, noise_key, camera),
        )

    def frames(self) -> Iterator[tuple[int, int, NDArray[Any]]]:
        """Yield the camera, row and pixels of each frame that arrives completely, row by row."""
        for row in range(self.rows):
            for camera in range(len(self.pinholes)):
                if self.faults.received_share(camera, row) == 1:
                    yield camera, row, self.frame(camera, row)

    def render_all(self) -> dict[tuple[int, int], NDArray[Any]]:
        """Render all frames by (camera, row), including those whose arrival a fault prevents."""
        return {(c, r): self.frame(c, r) for r in range(self.rows) for c in range(len(self.pinholes))}

    def head(self) -> RecordingHead:
        """Return the content of recording.json. Frames that do not arrive completely are listed as missing."""
        cells = [(c, r) for c in range(len(self.pinholes)) for r in range(self.rows)]
        line = self.twin.line
        filmed = [row for n in range(self.rows) if (row := row_of(self.twin.program, n)) is not None]
        return RecordingHead(
            format="vaoi-recording",
            version=1,
            cameras=self.twin.heads,
            rows=self.rows,
            trigger_period_s=line.trigger_period_s,
            conveyor_mm_s=line.conveyor_mm_s,
            missing=tuple(cell for cell in cells if self.faults.received_share(*cell) < 1),
            trigger_times_s=tuple(round(t - self.pulse_times_s[0], 9) for t in self.pulse_times_s),
            belt_mm=line.row_ways_mm(self.rows),
            lights=self.lights,
            exposures_us=tuple(row.lit_us for row in filmed) or None,
            gains=tuple(row.gains for row in filmed) or None,
        )

    def truth(self) -> dict[str, Any]:
        """Return the truth of this passage in the format of truth.json."""
        absent = {ref for ref, placement in self.placements.items() if placement is None}
        poses = [self.pose(t) for t in self.pulse_times_s]
        return passage_truth(self.twin.scenario.board, self.twin.parts, self.pinholes, poses, absent)

    def _motion_px(self, camera: int, t_s: float, exposure_us: float) -> Floats:
        """Return the motion (2,), px, of the board's image at the centre of a frame during one exposure."""
        if t_s >= self._motion.stop_s:
            return np.zeros(2)
        pinhole, seconds = self.pinholes[camera], exposure_us * 1e-6
        middle = np.array([[(pinhole.width_px - 1) / 2, (pinhole.height_px - 1) / 2]])
        place = apply(np.linalg.inv(self.pose(t_s)), pinhole.ground(middle, 0.0))
        # The speed is a central difference over 0.2 ms: it hardly varies in this time, and rounding is negligible.
        before, after = (pinhole.project(apply(self.pose(t_s + d), place), 0.0)[0] for d in (-_SLOPE_S, _SLOPE_S))
        return np.asarray((after - before) / (2 * _SLOPE_S) * seconds)


# Drawing a large board takes a minute and gigabytes, so tests and benchmarks share the few boards they use.
@lru_cache(maxsize=4)
def _artwork(section: BoardSection, px_per_mm: float, belt_grey: float) -> Artwork:
    return draw(section, px_per_mm, belt_grey)


def program_of(scenario: Scenario) -> tuple[ProgramRow, ...]:
    """Return the light program of a scenario with all its values; empty without one."""
    array, cameras = scenario.array, range(scenario.array.cameras)

    def of_cameras(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(values[n % len(values)] for n in cameras)

    return tuple(
        ProgramRow(
            light=step.light,
            exposures_us=of_cameras(step.exposure_us or tuple(map(array.exposure_us, cameras))),
            gains_db=of_cameras(step.gain_db or (0.0,)),
            on_us=step.on_us,
        )
        for step in scenario.program
    )
