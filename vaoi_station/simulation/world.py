"""The world of a scenario: everything that is the same for every board, such as cameras, board type, artwork, light."""

from __future__ import annotations

import math
from functools import cached_property, lru_cache

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, Calibration, CameraHead, Distortion, ProgramRow
from vaoi_station.simulation.board.artwork import Artwork, draw
from vaoi_station.simulation.board.canvas import Plane
from vaoi_station.simulation.board.layout import Part, board_type
from vaoi_station.simulation.board.printed_code import identity_of
from vaoi_station.simulation.imaging.pinholes import Pinhole, mount_cameras
from vaoi_station.simulation.imaging.scene import LitTextures, Scene
from vaoi_station.simulation.imaging.sensor import vignette
from vaoi_station.simulation.imaging.surroundings import Surroundings
from vaoi_station.simulation.motion.timetable import line_of
from vaoi_station.simulation.scenario import BoardSection, Scenario

TEXTURE_PER_PIXEL = 1.1
"""Texture resolution divided by image resolution. A lower value would blur frames, a much higher one would alias."""


class World:
    """The parts of a scenario that are the same for every board: cameras, calibration, line, board type, artwork,
    light.

    Attributes:
        scenario: the scenario, which determines everything else.
        pinholes: the cameras with their real mounting errors, before any fault.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.pinholes: tuple[Pinhole, ...] = mount_cameras(scenario.array)
        self._paints: dict[tuple[str, int], LitTextures] = {}
        self._shades: dict[tuple[int, str], Plane] = {}

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
        return _artwork(s.board, TEXTURE_PER_PIXEL * s.array.finest_px_per_mm, s.belt.grey)

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts of the board type."""
        return self.artwork.parts

    @cached_property
    def board_type(self) -> BoardType:
        """The CAD description of the boards."""
        return board_type(self.scenario.board, self.parts, identity_of(self.scenario.board))

    @cached_property
    def scene(self) -> Scene:
        """The scene that the cameras render: surface and artwork of the board, and the belt."""
        s = self.scenario
        beside = Surroundings(s.texture, s.carrier, s.board, s.belt.grey, TEXTURE_PER_PIXEL * s.array.px_per_mm)
        return Scene(s.board, self.artwork, s.belt.grey, beside if beside.visible else None)

    def paint(self, light_name: str, pose: Floats) -> LitTextures:
        """Return the board's textures as they appear under a light pattern.

        `pose` is tester_from_board, (3, 3), of which the nearest multiple of a quarter turn matters for the relief.
        """
        light = self.scenario.lights[light_name]
        quarter = round(math.atan2(pose[1, 0], pose[0, 0]) / (math.pi / 2)) % 4 if light.relief else 0
        key = (light_name, quarter)
        if key not in self._paints:
            self._paints[key] = LitTextures(self.artwork, light, quarter * math.pi / 2)
        return self._paints[key]

    def vignetting(self, camera: int) -> Plane:
        """Return the relative brightness (h, w) of a camera's frame under even light."""
        return vignette(self.scenario.array, camera)

    def shade(self, camera: int, light_name: str) -> Plane:
        """Return the relative brightness (h, w) of a camera's frame under a light pattern.

        It is the product of the vignetting and of the light's slope over the frame.
        """
        key = (camera, light_name)
        if key not in self._shades:
            array, light = self.scenario.array, self.scenario.lights[light_name]
            width_px, height_px = array.frame_px(camera)
            x, y = np.linspace(-1, 1, width_px), np.linspace(-1, 1, height_px)
            slope = 1 + light.shading * 0.5 * (light.direction[0] * x[None] + light.direction[1] * y[:, None])
            self._shades[key] = np.asarray(self.vignetting(camera) * slope, np.float32)
        return self._shades[key]


# Drawing a large board takes a minute and gigabytes, so tests and benchmarks share the few boards they use.
@lru_cache(maxsize=4)
def _artwork(section: BoardSection, px_per_mm: float, belt_grey: float) -> Artwork:
    return draw(section, px_per_mm, belt_grey)


def program_of(scenario: Scenario) -> tuple[ProgramRow, ...]:
    """Return the light program of a scenario with all its values; empty without one."""
    array, count = scenario.array, scenario.array.cameras
    return tuple(
        ProgramRow(
            light=step.light,
            exposures_us=_of_cameras(step.exposure_us or tuple(map(array.exposure_us, range(count))), count),
            gains_db=_of_cameras(step.gain_db or (0.0,), count),
            on_us=step.on_us,
        )
        for step in scenario.program
    )


def _of_cameras(values: tuple[float, ...], count: int) -> tuple[float, ...]:
    """Return one value per camera; a list with fewer entries than cameras is repeated, as elsewhere in a scenario."""
    return tuple(values[n % len(values)] for n in range(count))
