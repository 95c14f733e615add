"""The tables of a scenario file: everything that the twin simulates, including faults.

`docs/reference/twin.md` describes every key. All keys have defaults, so an empty file is a valid scenario. All random
numbers depend only on the seeds.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.model import Program, Strict

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Index = Annotated[int, Field(ge=0)]
PerCamera = Annotated[tuple[Positive, ...], Field(min_length=1)]
Side = Annotated[int, Field(ge=32, le=16384)]
"""Width or height of a frame, px."""


class Section(Strict):
    """Base class of all tables of a scenario file."""


class ArraySection(Section):
    """The camera array: design, mounting errors, lenses and sensors."""

    cameras: Annotated[int, Field(ge=1, le=64)] = 3
    width_px: Side = 1392
    height_px: Side = 1040
    px_per_mm: Positive = 40.0
    working_distance_mm: Positive = 483.0
    overlap: Annotated[float, Field(ge=1, le=16)] = 1.05
    tilt_deg: NotNegative = 0.115
    roll_deg: NotNegative = 0.23
    position_mm: NotNegative = 0.15
    focal_length: Annotated[float, Field(ge=0, le=0.1)] = 0.002
    distortion_px: Finite = 0.0
    exposures_us: PerCamera = (250.0,)
    reference_exposure_us: Positive = 250.0
    gain: Positive = 1.0
    black_level: NotNegative = 2.0
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.25
    psf_px: NotNegative = 0.6
    shot_noise: NotNegative = 0.03
    read_noise: NotNegative = 1.5
    flicker: NotNegative = 0.01
    bits: Literal[8, 16] = 8
    seed: Index = 11
    camera_px_per_mm: tuple[Positive, ...] = ()
    camera_frame_px: tuple[tuple[Side, Side], ...] = ()
    camera_roll_deg: Annotated[tuple[Finite, ...], Field(min_length=1)] = (0.0,)

    @property
    def pitch_mm(self) -> float:
        """Distance of neighbouring cameras: the width of a field of view divided by the overlap m_h."""
        return self.width_px / self.px_per_mm / self.overlap

    @property
    def view_mm(self) -> tuple[float, float]:
        """Nominal field of view of one camera, mm: its extent across and along the motion."""
        return self.width_px / self.px_per_mm, self.height_px / self.px_per_mm

    def exposure_us(self, camera: int) -> float:
        """Return the exposure time of one camera. All lists with fewer entries than cameras are repeated."""
        return self.exposures_us[camera % len(self.exposures_us)]

    @property
    def finest_px_per_mm(self) -> float:
        """The highest design resolution of any camera."""
        return max(self.resolution_px_per_mm(i) for i in range(self.cameras))

    def resolution_px_per_mm(self, camera: int) -> float:
        """Return the design resolution of one camera."""
        own = self.camera_px_per_mm
        return own[camera % len(own)] if own else self.px_per_mm

    def frame_px(self, camera: int) -> tuple[int, int]:
        """Return width and height of the frames of one camera."""
        own = self.camera_frame_px
        return own[camera % len(own)] if own else (self.width_px, self.height_px)

    def design_roll_deg(self, camera: int) -> float:
        """Return by how much one camera is mounted rotated, from image x towards image y; 180 is upside down."""
        return self.camera_roll_deg[camera % len(self.camera_roll_deg)]

    def camera_view_mm(self, camera: int) -> tuple[float, float]:
        """Return a camera's nominal view across and along the motion, mm, its roll rounded to quarter turns."""
        (w, h), r = self.frame_px(camera), self.resolution_px_per_mm(camera)
        across = round(self.design_roll_deg(camera) / 90) % 2 == 1
        return (h / r, w / r) if across else (w / r, h / r)

    @property
    def middle_mm(self) -> float:
        """Tester x of the centre of the array, which is also the centre of the boards' path."""
        return self.center_mm(self.cameras - 1) / 2

    def center_mm(self, camera: int) -> float:
        """Return tester x of the nominal centre of one camera's view. All neighbours overlap by the same share."""
        widths = [self.camera_view_mm(i)[0] for i in range(camera + 1)]
        if len(set(widths)) == 1:
            return camera * (widths[0] / self.overlap)
        return sum((a + b) / 2 for a, b in pairwise(widths)) / self.overlap


class FiducialMark(Section):
    """A fiducial of bare copper. Its position is in mm from the top left corner of the board as the camera sees it."""

    x_mm: Finite
    y_mm: Finite
    diameter_mm: Positive = 1.0
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"


class CodeSection(Section):
    """A code that is printed on every board, with its serial number. Its position is that of its middle."""

    x_mm: Finite
    y_mm: Finite
    module_mm: Annotated[float, Field(ge=0.05, le=2)] = 0.3
    symbology: Literal["datamatrix", "qr"] = "datamatrix"
    text: Annotated[str, Field(min_length=1, max_length=200)] = "{name};{serial}"
    turned_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    inverted: bool = False
    dot_modules: Annotated[float, Field(ge=0.5, le=1)] | None = None
    """Diameter of the dots of which the code is made, as a share of a module; None: solid modules."""
    panel: str | int | None = None


Look = Literal["dark", "light", "blank"]


class BadMarkSection(Section):
    """The mark of every board of a panel that states whether it is bad. Its position counts from the board's corner."""

    x_mm: Finite
    y_mm: Finite
    diameter_mm: Positive = 2.0
    good: Look = "light"
    bad: Look = "dark"


class PanelBoardSection(Section):
    """The place of a board on the panel, as CAD data state it, and how the real board differs from it."""

    x_mm: Finite
    y_mm: Finite
    rotated_deg: Literal[0, 90, 180, 270] = 0
    shift_mm: tuple[Finite, Finite] = (0.0, 0.0)
    turn_deg: Annotated[float, Field(ge=-5, le=5)] = 0.0
    mark: Literal["good", "bad", "half"] = "good"


class PanelSection(Section):
    """The boards of a panel: equal ones, each with its fiducials and its bad-board mark."""

    width_mm: Annotated[float, Field(ge=8, le=4000)]
    length_mm: Annotated[float, Field(ge=8, le=4000)]
    boards: Annotated[tuple[PanelBoardSection, ...], Field(min_length=1, max_length=200)]
    fiducials: tuple[FiducialMark, ...] = ()
    bad_mark: BadMarkSection | None = None


class TextureSection(Section):
    """The texture of the belt, or of what else is seen beside the board: random grey levels about the belt's grey."""

    sigma_grey: Annotated[float, Field(ge=0, le=100)] = 0.0
    grain_mm: Annotated[float, Field(gt=0, le=5)] = 0.15
    follows: Annotated[float, Field(ge=-2, le=2)] = 1.0
    below_mm: Annotated[float, Field(ge=-50, le=200)] = 0.0
    seed: Index = 1


class CarrierSection(Section):
    """The carrier in which boards ride: a frame around the board that moves with it, with marks beside the board."""

    rim_mm: Annotated[float, Field(ge=0, le=200)] = 0.0
    grey: Annotated[float, Field(ge=0, le=255)] = 120.0
    sigma_grey: Annotated[float, Field(ge=0, le=100)] = 4.0
    below_mm: Annotated[float, Field(ge=-50, le=200)] = 0.0
    marks: tuple[FiducialMark, ...] = ()
    seed: Index = 1


class SpeedChange(Section):
    """A time in which the belt runs at `factor` times its speed: 0 is a stop.

    `at_s` counts from the time at which a board interrupts the barrier. Every board sees the change.
    """

    at_s: NotNegative
    for_s: Positive
    factor: Annotated[float, Field(ge=0, le=2)]


class BeltSection(Section):
    """The motion of the conveyor, and the position of boards on it."""

    speed_mm_s: Positive = 100.0
    speed_error: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0
    speed_wander: Annotated[float, Field(ge=0, le=0.2)] = 0.01
    direction: Literal[1, -1] = 1
    skew_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    sway_mm: NotNegative = 0.05
    yaw_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    yaw_sigma_deg: Annotated[float, Field(ge=0, le=10)] = 0.35
    yaw_wander_deg: Annotated[float, Field(ge=0, le=5)] = 0.02
    yaw_rate_deg_s: Annotated[float, Field(ge=-20, le=20)] = 0.0
    offset_mm: Finite = 0.0
    offset_sigma_mm: NotNegative = 0.5
    wander_period_s: Positive = 0.8
    grey: Annotated[float, Field(ge=0, le=255)] = 18.0
    changes: tuple[SpeedChange, ...] = ()
    seed: Index = 1


class BoardSection(Section):
    """The board type, which is generated from a seed, and the unit, axes and side of its CAD data."""

    name: Annotated[str, Field(min_length=1, max_length=200)] = "demo"
    width_mm: Annotated[float, Field(ge=8, le=4000)] = 96.0
    length_mm: Annotated[float, Field(ge=8, le=4000)] = 60.0
    density: Annotated[float, Field(ge=0, le=6)] = 2.0
    grid_mm: Annotated[float, Field(ge=1.5, le=100)] | None = None
    height_scale: NotNegative = 1.0
    fiducials: tuple[FiducialMark, ...] | None = None
    codes: tuple[CodeSection, ...] = ()
    panel: PanelSection | None = None
    """Boards of which a panel of this size consists; None: one board."""
    placement_sigma_mm: NotNegative = 0.03
    turned_deg: Literal[0, 90, 180, 270] = 0
    lift_mm: Finite = 0.0
    bow_mm: Finite = 0.0
    tilt_mm: tuple[Finite, Finite] = (0.0, 0.0)
    unit: Literal["mm", "inch", "mil"] = "mm"
    y_axis: Literal["up", "down"] = "up"
    side: Literal["top", "bottom"] = "top"
    file: Path | None = None
    """Board type whose parts are drawn, instead of generated ones; it gives name, size, fiducials, unit, axes, side."""
    origin: tuple[Finite, Finite] = (0.0, 0.0)
    """CAD coordinates of the corner of the outline with the least x and y."""
    seed: Index = 5

    @model_validator(mode="after")
    def _all_on_board(self) -> Self:
        size = f"lies off the board of {self.width_mm} × {self.length_mm} mm"
        for mark in self.fiducials or ():
            if not (0 <= mark.x_mm <= self.width_mm and 0 <= mark.y_mm <= self.length_mm):
                raise ValueError(f"a fiducial at ({mark.x_mm}, {mark.y_mm}) mm {size}")
        for code in self.codes:
            if not (0 < code.x_mm < self.width_mm and 0 < code.y_mm < self.length_mm):
                raise ValueError(f"a code at ({code.x_mm}, {code.y_mm}) mm {size}")
            if "{serial}" not in code.text:
                raise ValueError(f"the text of a code is {code.text!r}, must contain {{serial}}")
        if self.panel is None:
            return self
        if self.file is not None or self.grid_mm is not None:
            raise ValueError("panel is given together with file or grid_mm; boards of panels are generated")
        for board in self.panel.boards:
            w, h = (self.panel.width_mm, self.panel.length_mm)[:: 1 if board.rotated_deg % 180 == 0 else -1]
            if not (0 <= board.x_mm <= self.width_mm - w and 0 <= board.y_mm <= self.length_mm - h):
                raise ValueError(
                    f"a board of the panel at ({board.x_mm}, {board.y_mm}) mm, {w} × {h} mm, lies off the panel "
                    f"of {self.width_mm} × {self.length_mm} mm"
                )
        return self

    @property
    def marks(self) -> tuple[FiducialMark, ...]:
        """The fiducials that the scenario states; if it states none, three marks that fit only one rotation."""
        if self.fiducials is not None:
            return self.fiducials
        w, h = self.width_mm, self.length_mm
        d = 1.0 if min(w, h) >= 30 else 0.8
        inset = min(4.0, min(w, h) / 8)
        # The third mark is displaced: of three corners of a square, two would coincide with others after a quarter
        # turn.
        places = [(inset, inset), (w - inset, h - 1.4 * inset), (w - 1.6 * inset, 1.1 * inset)]
        return tuple(FiducialMark(x_mm=round(x, 3), y_mm=round(y, 3), diameter_mm=d) for x, y in places)


class LineSection(Section):
    """The light barrier and the timing of the trigger pulses."""

    barrier_mm: Finite = -40.0
    approach_s: Positive = 0.1
    start_delay_s: NotNegative = 0.32
    period_s: Positive = 0.105
    tail_s: NotNegative = 0.48
    longest_board_mm: Positive = 100.0
    debounce_s: NotNegative = 0.005
    interval_s: Positive = 5.0
    lights: Annotated[tuple[str, ...], Field(min_length=1)] = ("ring",)
    encoder_counts_per_mm: Positive | None = None
    """Counts of the belt's encoder, which then spaces the rows; None: the controller's clock spaces them."""


class CalibrationBoardSection(Section):
    """The calibration board: a grid of crosses. Its coordinates are the tester coordinates."""

    marks_per_axis: Annotated[int, Field(ge=2, le=40)] = 2
    mark_mm: Positive = 2.0
    board_grey: Annotated[float, Field(ge=0, le=255)] = 205.0
    mark_grey: Annotated[float, Field(ge=0, le=255)] = 25.0


class LightSection(Section):
    """One light pattern of the LEDs: its brightness, direction, shading and shadow."""

    gain: PerCamera = (1.0,)
    metal: NotNegative = 1.0
    azimuth_deg: Finite = 0.0
    shading: Share = 0.0
    shadow: Share = 0.0
    elevation_deg: Annotated[float, Field(gt=5, lt=90)] = 45.0
    relief: Share = 0.0

    def camera_gain(self, camera: int) -> float:
        """Return the brightness factor for one camera. A list with fewer entries than cameras is repeated."""
        return self.gain[camera % len(self.gain)]

    @property
    def direction(self) -> tuple[float, float]:
        """Unit vector (x, y) from the board towards the lamp, in tester coordinates."""
        a = math.radians(self.azimuth_deg)
        return math.cos(a), math.sin(a)


class OnBoard(Section):
    """Base class of the faults of a single board. A fault without a board number applies to every board."""

    board: Index | None = None


class LostRow(OnBoard):
    """A fault of a whole row: none of its frames arrives."""

    row: Index


class StuckBoard(LostRow):
    """The board stops at the pulse of a row and does not move again."""


class LostFrame(LostRow):
    """A fault of one camera's frame of one row: it never arrives."""

    camera: Index


class LateFrame(LostFrame):
    """A frame that arrives late."""

    delay_s: Positive


class IncompleteFrame(LostFrame):
    """A frame of which only the first bytes arrive: this share of them."""

    share: Annotated[float, Field(ge=0, lt=1)]


class ExtraFrame(LostFrame):
    """An additional exposure of a camera after the pulse of a row."""

    after_s: Positive


class FreeRunning(OnBoard):
    """A camera that ignores the trigger and sends frames at a fixed interval while the board passes."""

    camera: Index
    interval_s: Positive


class LateStamps(OnBoard):
    """A camera whose time stamps come later than the start of the exposure."""

    camera: Index
    by_s: Positive


class Bounce(OnBoard):
    """The signal of the barrier is inverted for a while, starting `at_s` after the board interrupts it."""

    at_s: Finite
    duration_s: Positive


class TurnedBoard(OnBoard):
    """The board was laid on the belt with an additional rotation of 90, 180 or 270 degrees."""

    turned_deg: Literal[90, 180, 270]


class AbsentPart(OnBoard):
    """A part that is absent, because it was not placed on the board."""

    ref: str


class KnockedCamera(Section):
    """A camera that was knocked. From board `from_board` on, it is rotated against its calibrated direction."""

    camera: Index
    from_board: Index = 0
    about: Literal["x", "y", "z"] = "z"
    angle_deg: Annotated[float, Field(ge=-5, le=5)]


class FaultSection(Section):
    """All faults of a scenario, listed by kind."""

    lost_frames: tuple[LostFrame, ...] = ()
    lost_rows: tuple[LostRow, ...] = ()
    late_frames: tuple[LateFrame, ...] = ()
    incomplete_frames: tuple[IncompleteFrame, ...] = ()
    ignored_triggers: tuple[LostFrame, ...] = ()
    """Pulses that a camera ignores and does not count."""
    extra_frames: tuple[ExtraFrame, ...] = ()
    exchanged_frames: tuple[LostFrame, ...] = ()
    """Frames whose ids and time stamps a camera exchanges with those of the next row."""
    free_running: tuple[FreeRunning, ...] = ()
    late_stamps: tuple[LateStamps, ...] = ()
    bounces: tuple[Bounce, ...] = ()
    stuck: tuple[StuckBoard, ...] = ()
    turned: tuple[TurnedBoard, ...] = ()
    absent_parts: tuple[AbsentPart, ...] = ()
    knocked: tuple[KnockedCamera, ...] = ()


class Scenario(Section):
    """A scenario: all inputs of the twin."""

    array: ArraySection = ArraySection()
    belt: BeltSection = BeltSection()
    texture: TextureSection = TextureSection()
    carrier: CarrierSection = CarrierSection()
    board: BoardSection = BoardSection()
    line: LineSection = LineSection()
    lights: dict[str, LightSection] = Field(default_factory=lambda: {"ring": LightSection()})
    program: Program = ()
    """Light, exposure and gain of the rows, in turn, instead of `line.lights` and the exposures of `[array]`."""
    faults: FaultSection = FaultSection()
    calibration_board: CalibrationBoardSection = CalibrationBoardSection()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key, named in (("line.lights", self.line.lights), ("program", [step.light for step in self.program])):
            if unknown := [name for name in named if name not in self.lights]:
                raise ValueError(f"{key} names {unknown}, but [lights] has only {sorted(self.lights)}")
        # An exposure longer than the trigger period would overlap the next pulse.
        of_program = [e for step in self.program for e in step.exposure_us or ()]
        for key, exposures_us in (("array.exposures_us", self.array.exposures_us), ("program", of_program)):
            longest_us = max(exposures_us, default=0.0)
            if longest_us * 1e-6 >= self.line.period_s:
                raise ValueError(f"{key} has {longest_us} us, but pulses follow every {self.line.period_s} s")
        # Without this check, a fault of a camera that does not exist would have no effect and no message.
        for _, faults in self.faults:
            for camera in [getattr(fault, "camera", 0) for fault in faults]:
                if camera >= self.array.cameras:
                    raise ValueError(f"a fault names camera {camera}, but there are {self.array.cameras} (from 0)")
        return self
