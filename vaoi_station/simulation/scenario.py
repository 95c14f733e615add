"""Read a scenario file (TOML) into a frozen `Scenario`, which defines what the twin simulates, including faults.

Unknown keys and invalid values raise an error with file, key, value and limit. `docs/engineering/twin.md` describes
every key. All keys have defaults, so an empty file is a valid scenario. All random numbers depend only on the seeds.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.model import Program
from vaoi_station.simulation.camera_array import (
    ArraySection,
    Finite,
    Index,
    NotNegative,
    PerCamera,
    Positive,
    Section,
    Share,
)
from vaoi_station.simulation.surroundings import CarrierSection, CodeSection, FiducialMark, PanelSection, TextureSection


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
    photograph: Path | None = None
    file: Path | None = None
    """Board type whose parts are drawn, instead of generated ones; it gives name, size, fiducials, unit, axes, side."""
    origin: tuple[Finite, Finite] = (0.0, 0.0)
    """CAD coordinates of the corner of the outline with the least x and y."""
    seed: Index = 5

    @model_validator(mode="after")
    def _marks_on_board(self) -> Self:
        for mark in self.fiducials or ():
            if not (0 <= mark.x_mm <= self.width_mm and 0 <= mark.y_mm <= self.length_mm):
                raise ValueError(
                    f"a fiducial at ({mark.x_mm}, {mark.y_mm}) mm lies off the board "
                    f"of {self.width_mm} × {self.length_mm} mm"
                )
        return self

    @model_validator(mode="after")
    def _codes_on_board(self) -> Self:
        for code in self.codes:
            if not (0 < code.x_mm < self.width_mm and 0 < code.y_mm < self.length_mm):
                raise ValueError(
                    f"a code at ({code.x_mm}, {code.y_mm}) mm lies off the board "
                    f"of {self.width_mm} × {self.length_mm} mm"
                )
            if "{serial}" not in code.text:
                raise ValueError(f"the text of a code is {code.text!r}, must contain {{serial}}")
        return self

    @model_validator(mode="after")
    def _boards_on_panel(self) -> Self:
        if self.panel is None:
            return self
        if self.file is not None or self.photograph is not None or self.grid_mm is not None:
            raise ValueError("panel is given together with file, photograph or grid_mm; boards of panels are generated")
        width, length = self.panel.width_mm, self.panel.length_mm
        for board in self.panel.boards:
            w, h = (width, length) if board.rotated_deg % 180 == 0 else (length, width)
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

    def applies_to(self, board_number: int) -> bool:
        """Return whether the board with this number has the fault."""
        return self.board is None or self.board == board_number


class LostFrame(OnBoard):
    """A fault: the frame of one camera and row never arrives."""

    camera: Index
    row: Index


class LostRow(OnBoard):
    """A row of which no frame arrives."""

    row: Index


class LateFrame(LostFrame):
    """A frame that arrives `delay_s` seconds late."""

    delay_s: Positive


class IncompleteFrame(LostFrame):
    """A frame of which only the first bytes arrive. `share` is the share of the bytes that arrive."""

    share: Annotated[float, Field(ge=0, lt=1)]


class IgnoredTrigger(LostFrame):
    """A pulse that a camera ignores. The frame counter of the camera does not count the pulse either."""


class ExtraFrame(LostFrame):
    """An additional exposure of a camera, `after_s` seconds after the pulse of a row."""

    after_s: Positive


class ExchangedFrames(LostFrame):
    """A camera exchanges the frame ids and time stamps of the frames of `row` and `row` + 1."""


class FreeRunning(OnBoard):
    """A camera that ignores the trigger and sends frames at a fixed interval while the board passes."""

    camera: Index
    interval_s: Positive


class LateStamps(OnBoard):
    """A camera whose time stamps come later than the start of the exposure, by `by_s` seconds."""

    camera: Index
    by_s: Positive


class Bounce(OnBoard):
    """The signal of the barrier is inverted for `duration_s`, starting `at_s` after the board interrupts it."""

    at_s: Finite
    duration_s: Positive


class StuckBoard(OnBoard):
    """The board stops at the pulse of a row and does not move again."""

    row: Index


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
    ignored_triggers: tuple[IgnoredTrigger, ...] = ()
    extra_frames: tuple[ExtraFrame, ...] = ()
    exchanged_frames: tuple[ExchangedFrames, ...] = ()
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
        unknown = [name for name in self.line.lights if name not in self.lights]
        if unknown:
            raise ValueError(f"line.lights names {unknown}, but [lights] has only {sorted(self.lights)}")
        if unlit := [step.light for step in self.program if step.light not in self.lights]:
            raise ValueError(f"program names the lights {unlit}, but [lights] has only {sorted(self.lights)}")
        # An exposure longer than the trigger period would overlap the next pulse.
        longest_us = max(self.array.exposures_us)
        if longest_us * 1e-6 >= self.line.period_s:
            raise ValueError(f"array.exposures_us has {longest_us} us, but pulses follow every {self.line.period_s} s")
        longest_us = max((e for step in self.program for e in step.exposure_us or ()), default=0.0)
        if longest_us * 1e-6 >= self.line.period_s:
            raise ValueError(f"program has {longest_us} us, but pulses follow every {self.line.period_s} s")
        self._check_faults()
        return self

    def _check_faults(self) -> None:
        faults = self.faults
        of_one_row = (*faults.lost_frames, *faults.late_frames, *faults.incomplete_frames, *faults.ignored_triggers)
        of_trigger: tuple[LostFrame | FreeRunning | LateStamps, ...] = (
            *faults.extra_frames,
            *faults.exchanged_frames,
            *faults.free_running,
            *faults.late_stamps,
        )
        # Without this check, a fault of a camera that does not exist would have no effect and no message.
        named = [f.camera for f in of_one_row] + [f.camera for f in of_trigger] + [f.camera for f in faults.knocked]
        for camera in named:
            if camera >= self.array.cameras:
                raise ValueError(f"a fault names camera {camera}, but there are {self.array.cameras} (from 0)")
