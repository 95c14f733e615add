"""The passage of one board: its frames, its times, its faults, and its truth.

A frame is a pure function of scenario, board number, camera and row. Frames that were rendered before do not change it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import ProgramRow, RecordingHead
from vaoi_station.model.recording import row_of
from vaoi_station.simulation.board.bodies import Body
from vaoi_station.simulation.board.printed_code import code_text, draw_label
from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.imaging.scene import Placement
from vaoi_station.simulation.imaging.sensor import expose, generator
from vaoi_station.simulation.motion.encoder import EncoderTrack
from vaoi_station.simulation.motion.faults import PassageFaults, knocked_pinholes
from vaoi_station.simulation.motion.timetable import Timetable, timetable
from vaoi_station.simulation.truth import passage_truth
from vaoi_station.simulation.world import World

_SLOPE_S = 1e-4


@dataclass(frozen=True, eq=False)
class Passage:
    """The passage of one board through the line: its motion, frames, faults and truth.

    Times are in seconds since the start of the passage.
    """

    twin: World
    board_number: int

    @cached_property
    def _times(self) -> Timetable:
        return timetable(self.twin.scenario, self.board_number)

    @property
    def start_s(self) -> float:
        """Start of the passage, in seconds since the start of the scenario."""
        return self._times.motion.start_s

    @property
    def blocked_s(self) -> float:
        """Time at which the board interrupts the barrier, s since the start of the passage."""
        return self._times.blocked_s

    @property
    def clear_s(self) -> float:
        """The time at which the board leaves the barrier; infinite if it stays there."""
        return self._times.clear_s

    @property
    def pulse_times_s(self) -> tuple[float, ...]:
        """Times of the pulses that a controller sends.

        The first follows the interruption of the barrier after the start delay. The others follow at the trigger
        period, until the tail time after the board has cleared the barrier.
        """
        return self._times.pulse_times_s

    @property
    def encoder(self) -> EncoderTrack | None:
        """Counts of the belt's encoder, which space the rows; None if the controller's clock spaces them."""
        return self._times.encoder

    @property
    def rows(self) -> int:
        """Number of pulses and so of rows, the paper's m."""
        return len(self.pulse_times_s)

    @property
    def turned_deg(self) -> int:
        """Rotation of the board on the belt: 0, 90, 180 or 270 degrees, counter-clockwise as the camera sees it."""
        return self._times.turned_deg

    @property
    def lights(self) -> tuple[str, ...]:
        """Name of the light pattern of each row."""
        names = [row.light for row in self.twin.program] or self.twin.scenario.line.lights
        return tuple(names[row % len(names)] for row in range(self.rows))

    @cached_property
    def faults(self) -> PassageFaults:
        """The faults of this board."""
        return PassageFaults(self.twin.scenario.faults, self.board_number, self.blocked_s, self._times.stuck)

    @cached_property
    def pinholes(self) -> tuple[Pinhole, ...]:
        """The cameras as they are during this passage. A camera may have been knocked since its calibration."""
        return knocked_pinholes(self.twin.scenario.faults, self.twin.pinholes, self.board_number)

    @cached_property
    def placements(self) -> dict[str, Placement | None]:
        """Placement error of each part of this board by its name; None for an absent part."""
        self._check_absent()
        sigma = self.twin.scenario.board.placement_sigma_mm
        g = np.random.default_rng([self.twin.scenario.board.seed, 7040, self.board_number])
        result: dict[str, Placement | None] = {}
        for part in self.twin.parts:
            # Random numbers are drawn for absent parts too, so that the placement of other parts does not change.
            x, y, turn = g.normal(0, 1, 3) * (sigma, sigma, sigma / 3)
            placed = Placement((float(x), float(y)), float(turn))
            result[part.ref] = None if self.faults.absent(part.ref) else placed
        return result

    @cached_property
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
        return self._times.motion.pose(t_s, (board.width_mm / 2, board.length_mm / 2))

    def frame(self, camera: int, row: int) -> NDArray[Any]:
        """Render the complete frame (h, w) of a camera and row, even if a fault prevents its arrival."""
        filmed = row_of(self.twin.program, row)
        return self.frame_at(camera, self.pulse_times_s[row], self.lights[row], row, filmed)

    def frame_at(
        self, camera: int, t_s: float, light_name: str, noise_key: int, filmed: ProgramRow | None = None
    ) -> NDArray[Any]:
        """Render the frame (h, w) of a camera at any time.

        Args:
            camera: index of the camera.
            t_s: middle of the exposure.
            light_name: name of the light pattern.
            noise_key: selects the random numbers for noise and flicker; the row for a frame of a pulse.
            filmed: exposure, on-time and gain; None: those of the scenario's cameras.
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
            belt_pose=self._times.motion.belt_pose(t_s, self.twin.scenario.texture.follows),
            labels=self.labels,
        )
        exposure_us = array.exposure_us(camera) if filmed is None else filmed.lit_us[camera]
        gain = 1.0 if filmed is None else filmed.gains[camera]
        relative = exposure_us / array.reference_exposure_us
        brightness = relative * array.gain * gain * light.camera_gain(camera) * self._flicker(noise_key)
        noise = generator(array.seed, 7005, self.board_number, noise_key, camera)
        return expose(
            samples,
            array,
            motion_px=self._motion_px(camera, t_s, exposure_us),
            brightness=brightness,
            shade=twin.shade(camera, light_name),
            noise=noise,
        )

    def frames(self) -> Iterator[tuple[int, int, NDArray[Any]]]:
        """Yield the camera, row and pixels of each frame that arrives completely, row by row."""
        for row in range(self.rows):
            for camera in range(len(self.twin.pinholes)):
                if self.faults.received_share(camera, row) == 1:
                    yield camera, row, self.frame(camera, row)

    def render_all(self) -> dict[tuple[int, int], NDArray[Any]]:
        """Render all frames, including those whose arrival a fault prevents. The keys are (camera, row)."""
        return {(c, r): self.frame(c, r) for r in range(self.rows) for c in range(len(self.twin.pinholes))}

    def head(self) -> RecordingHead:
        """Return the content of recording.json. Frames that do not arrive completely are listed as missing."""
        cells = [(c, r) for c in range(len(self.twin.pinholes)) for r in range(self.rows)]
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
        return passage_truth(self.twin, self.pinholes, [self.pose(t) for t in self.pulse_times_s], absent)

    def _check_absent(self) -> None:
        """Raise InputError if the scenario calls a part absent that the board does not have."""
        known = {p.ref for p in self.twin.parts}
        for n, fault in enumerate(self.twin.scenario.faults.absent_parts):
            if fault.ref not in known:
                raise InputError.field("scenario", f"faults.absent_parts.{n}.ref", fault.ref, "a part of this board")

    def _flicker(self, row: int) -> float:
        """Return the brightness of a row relative to the mean brightness. It is equal for all cameras."""
        array = self.twin.scenario.array
        return 1 + array.flicker * float(generator(array.seed, 7006, self.board_number, row).standard_normal())

    def _motion_px(self, camera: int, t_s: float, exposure_us: float) -> Floats:
        """Return the motion (2,), px, of the board's image at the centre of a frame during one exposure."""
        if t_s >= self._times.motion.stop_s:
            return np.zeros(2)
        pinhole, seconds = self.pinholes[camera], exposure_us * 1e-6
        middle = np.array([[(pinhole.width_px - 1) / 2, (pinhole.height_px - 1) / 2]])
        place = apply(np.linalg.inv(self.pose(t_s)), pinhole.ground(middle, 0.0))
        # The speed is a central difference over 0.2 ms: it hardly varies in this time, and rounding is negligible.
        before, after = (pinhole.project(apply(self.pose(t_s + d), place), 0.0)[0] for d in (-_SLOPE_S, _SLOPE_S))
        return np.asarray((after - before) / (2 * _SLOPE_S) * seconds)
