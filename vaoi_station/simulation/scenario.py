"""The tables of a scenario file: everything that the twin simulates, including faults.

`docs/reference/scenario.md` is made of these texts. All keys have defaults, so an empty file is a valid scenario. All
random numbers depend only on the seeds.
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
    """The camera array: design, mounting errors, lenses and sensors.

    A σ is the standard deviation of a normal distribution, drawn once per camera from `seed`.
    """

    cameras: Annotated[int, Field(ge=1, le=64)] = 3
    """Number of cameras n, side by side along tester x."""
    width_px: Side = 1392
    """Width of a frame, across the motion."""
    height_px: Side = 1040
    """Height of a frame, along the motion."""
    px_per_mm: Positive = 40.0
    """Design resolution r in the calibrated plane."""
    working_distance_mm: Positive = 483.0
    """Height of all cameras above the calibrated plane."""
    overlap: Annotated[float, Field(ge=1, le=16)] = 1.05
    """Multiplicity m_h: cameras that see each point; cameras stand a field of view / m_h apart."""
    tilt_deg: NotNegative = 0.115
    """σ of the tilt about each horizontal axis."""
    roll_deg: NotNegative = 0.23
    """σ of the rotation about the optical axis."""
    position_mm: NotNegative = 0.15
    """σ of the place, along and across."""
    focal_length: Annotated[float, Field(ge=0, le=0.1)] = 0.002
    """σ of the relative error of the focal length."""
    distortion_px: Finite = 0.0
    """Radial distortion at the frame's corner; every lens has 0.6 to 1.4 times as much."""
    exposures_us: PerCamera = (250.0,)
    """Exposure of each camera; a short list is used in turn (alternating exposures: section 3.5)."""
    reference_exposure_us: Positive = 250.0
    """Exposure at which a texture of grey 100 gives 100 at gain 1."""
    gain: Positive = 1.0
    """Brightness of everything."""
    black_level: NotNegative = 2.0
    """Added at the end, before clipping."""
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.25
    """Loss of brightness towards the corners (a quadratic, its middle a little off the frame's)."""
    psf_px: NotNegative = 0.6
    """σ of the lens blur."""
    shot_noise: NotNegative = 0.03
    """Variance of the noise per grey level."""
    read_noise: NotNegative = 1.5
    """σ of the noise in the dark."""
    flicker: NotNegative = 0.01
    """σ of the relative brightness from row to row, the same for all cameras."""
    bits: Literal[8, 16] = 8
    """8 or 16 bits per pixel; 16 holds 256 times the grey value."""
    seed: Index = 11
    """Mounting, lenses, vignetting, noise."""
    camera_px_per_mm: tuple[Positive, ...] = ()
    """Design resolution of each camera, a short list in turn; empty: `px_per_mm`. Neighbours stand as far apart as
    their own views need."""
    camera_frame_px: tuple[tuple[Side, Side], ...] = ()
    """Width and height of each camera's frames, a short list in turn; empty: `width_px`, `height_px`."""
    camera_roll_deg: Annotated[tuple[Finite, ...], Field(min_length=1)] = (0.0,)
    """How each camera is mounted, a short list in turn: its rotation from image x towards image y; 180 is upside
    down."""

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
    """A mark of bare copper with a ring free of solder mask around it.

    Its position is in mm from the top left corner of the board as the camera sees it.
    """

    x_mm: Finite
    """Place of its middle in board coordinates."""
    y_mm: Finite
    """Place of its middle in board coordinates."""
    diameter_mm: Positive = 1.0
    """Diameter, or size from side to side or tip to tip."""
    shape: Literal["circle", "cross", "square", "diamond"] = "circle"
    """Circle, cross, square or diamond."""


class CodeSection(Section):
    """A DataMatrix (ECC 200) or QR code (level M) on every board, with a border of two modules.

    Parts are not kept away from it. The board type states the places of codes and, if all have the same text, the
    pattern.
    """

    x_mm: Finite
    """Place of its middle in board coordinates."""
    y_mm: Finite
    """Place of its middle in board coordinates."""
    module_mm: Annotated[float, Field(ge=0.05, le=2)] = 0.3
    """Side of one module."""
    symbology: Literal["datamatrix", "qr"] = "datamatrix"
    """`datamatrix` or `qr`."""
    text: Annotated[str, Field(min_length=1, max_length=200)] = "{name};{serial}"
    """`{serial}` is `SN000001` on board 0, `SN000002` on board 1, …; `{name}` is `board.name`."""
    turned_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Rotation, counter-clockwise as the camera sees it."""
    inverted: bool = False
    """Light modules on dark ground."""
    dot_modules: Annotated[float, Field(ge=0.5, le=1)] | None = None
    """Diameter of the dots that the code is made of, 0.5 to 1; without it, its modules are solid."""
    panel: str | int | None = None
    """Position on the panel that the board type states for it."""


Look = Literal["dark", "light", "blank"]


class BadMarkSection(Section):
    """The mark of every board of a panel that states whether it is bad: a disc on even solder mask.

    Its position counts from the board's corner.
    """

    x_mm: Finite
    """Place of its middle on the board."""
    y_mm: Finite
    """Place of its middle on the board."""
    diameter_mm: Positive = 2.0
    """Diameter."""
    good: Look = "light"
    """Look on a good board: `light`, `dark` or `blank`."""
    bad: Look = "dark"
    """Look on a bad board."""


class PanelBoardSection(Section):
    """The place of a board on the panel, as CAD data state it, and how the real board differs from it."""

    x_mm: Finite
    """Corner of the board's place on the panel, the one with the least x and y."""
    y_mm: Finite
    """Corner of the board's place on the panel."""
    rotated_deg: Literal[0, 90, 180, 270] = 0
    """Rotation on the panel, 0, 90, 180 or 270, counter-clockwise as the camera sees it."""
    shift_mm: tuple[Finite, Finite] = (0.0, 0.0)
    """Displacement of the real board from its place."""
    turn_deg: Annotated[float, Field(ge=-5, le=5)] = 0.0
    """Turn of the real board about its middle."""
    mark: Literal["good", "bad", "half"] = "good"
    """Look of its bad-board mark: `good`, `bad`, or `half`, half of it looks bad."""


class PanelSection(Section):
    """The boards of a panel: equal ones, each displaced as it is stated; CAD data state where they should lie.

    `board.fiducials` are then those of the panel, `board.density` is that of each board, and parts are named `1/R1`,
    `2/R1`, …. The truth has C of each board (`board_matrices`).
    """

    width_mm: Annotated[float, Field(ge=8, le=4000)]
    """Size of one board."""
    length_mm: Annotated[float, Field(ge=8, le=4000)]
    """Size of one board."""
    boards: Annotated[tuple[PanelBoardSection, ...], Field(min_length=1, max_length=200)]
    """The boards and their places."""
    fiducials: tuple[FiducialMark, ...] = ()
    """Fiducials of every board, from its corner."""
    bad_mark: BadMarkSection | None = None
    """The mark of every board that states whether it is bad."""


class TextureSection(Section):
    """The texture of the belt, or of what else is seen beside the board: random grey levels about the belt's grey."""

    sigma_grey: Annotated[float, Field(ge=0, le=100)] = 0.0
    """σ of the grey levels; 0: an even belt."""
    grain_mm: Annotated[float, Field(gt=0, le=5)] = 0.15
    """σ of the grains' profile."""
    follows: Annotated[float, Field(ge=-2, le=2)] = 1.0
    """Its motion as a multiple of the board's: 1 moves with the board (a dirty belt), 0 stands still (a bed below edge
    belts)."""
    below_mm: Annotated[float, Field(ge=-50, le=200)] = 0.0
    """How far it lies below the calibrated plane."""
    seed: Index = 1
    """Its grains."""


class CarrierSection(Section):
    """The carrier in which boards ride: a frame around the board that moves with it, with marks beside the board.

    The barrier answers to the board alone.
    """

    rim_mm: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Width of the frame on every side of the board; 0: no carrier."""
    grey: Annotated[float, Field(ge=0, le=255)] = 120.0
    """Its grey value."""
    sigma_grey: Annotated[float, Field(ge=0, le=100)] = 4.0
    """σ of its texture."""
    below_mm: Annotated[float, Field(ge=-50, le=200)] = 0.0
    """How far it lies below the board's surface."""
    marks: tuple[FiducialMark, ...] = ()
    seed: Index = 1
    """Its texture."""


class SpeedChange(Section):
    """A time in which the belt runs at another speed, for every board."""

    at_s: NotNegative
    """Begin, after the board interrupts the barrier."""
    for_s: Positive
    """Duration."""
    factor: Annotated[float, Field(ge=0, le=2)]
    """Speed as a multiple of `speed_mm_s`; 0 is a stop."""


class BeltSection(Section):
    """The motion of the conveyor along tester y, and the position of boards on it.

    Each `*_wander` is a sum of five sinusoids with random phases; the way is the exact integral of the speed.
    """

    speed_mm_s: Positive = 100.0
    """Nominal speed, as in the station's configuration."""
    speed_error: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0
    """Relative error of the true mean speed."""
    speed_wander: Annotated[float, Field(ge=0, le=0.2)] = 0.01
    """Rms of the relative wandering of the speed."""
    direction: Literal[1, -1] = 1
    """1: along tester +y, −1: along −y."""
    skew_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """Constant angle of the true motion to tester y."""
    sway_mm: NotNegative = 0.05
    """Rms of the wandering across the motion."""
    yaw_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """Rotation of all boards on the belt, from tester x towards y."""
    yaw_sigma_deg: Annotated[float, Field(ge=0, le=10)] = 0.35
    """σ of the rotation from board to board."""
    yaw_wander_deg: Annotated[float, Field(ge=0, le=5)] = 0.02
    """Rms of the wandering of a board's rotation."""
    yaw_rate_deg_s: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """Steady turning."""
    offset_mm: Finite = 0.0
    """Shift of all boards across the motion, from the middle of the array."""
    offset_sigma_mm: NotNegative = 0.5
    """σ of that shift from board to board."""
    wander_period_s: Positive = 0.8
    """Middle of the periods of the wanderings; they reach from a third to three times this."""
    grey: Annotated[float, Field(ge=0, le=255)] = 18.0
    """Grey value beside the board."""
    changes: tuple[SpeedChange, ...] = ()
    """Times in which the belt runs at another speed, for every board."""
    seed: Index = 1
    """Wanderings, boards' offsets and rotations."""


class BoardSection(Section):
    """The board type, which is generated from a seed, and the unit, axes and side of its CAD data.

    Board coordinates: mm, origin in the top left corner as the camera sees the board, x right, y down.
    """

    name: Annotated[str, Field(min_length=1, max_length=200)] = "demo"
    """Name of the board type, also printed on it."""
    width_mm: Annotated[float, Field(ge=8, le=4000)] = 96.0
    """Size across the motion (before `turned_deg`)."""
    length_mm: Annotated[float, Field(ge=8, le=4000)] = 60.0
    """Size along the motion."""
    density: Annotated[float, Field(ge=0, le=6)] = 2.0
    """Parts per area, if there is room."""
    grid_mm: Annotated[float, Field(ge=1.5, le=100)] | None = None
    """Spacing of a square grid of equal parts (LEDs), in place of all other parts; without traces and names."""
    height_scale: NotNegative = 1.0
    """Factor on all body heights; 0: flat parts without bodies."""
    fiducials: tuple[FiducialMark, ...] | None = None
    """List of `{x_mm, y_mm, diameter_mm, shape}` in board coordinates; absent: three, placed asymmetrically."""
    codes: tuple[CodeSection, ...] = ()
    """Codes that are printed on every board, each with the board's serial number."""
    panel: PanelSection | None = None
    """Boards of which a panel of this size consists."""
    placement_sigma_mm: NotNegative = 0.03
    """σ of the parts' placement from board to board (turns: σ/3 rad per mm)."""
    turned_deg: Literal[0, 90, 180, 270] = 0
    """0, 90, 180 or 270: how boards lie on the belt, counter-clockwise as the camera sees it."""
    lift_mm: Finite = 0.0
    """Height of the board's surface above the calibrated plane."""
    bow_mm: Finite = 0.0
    """Bow: bow·(1 − 0.4u² − 0.6v²) with u, v from −1 to 1 over the board."""
    tilt_mm: tuple[Finite, Finite] = (0.0, 0.0)
    """Rise of the surface from the middle to the right and to the lower edge."""
    unit: Literal["mm", "inch", "mil"] = "mm"
    """Unit of its CAD description: mm, inch or mil."""
    y_axis: Literal["up", "down"] = "up"
    """y of its CAD description: up or down."""
    side: Literal["top", "bottom"] = "top"
    """Side that is up: top or bottom."""
    file: Path | None = None
    """Board type (`board.json`, relative to the scenario file) that is drawn; it gives name, size, fiducials, unit,
    axes and side. Packages fit the parts' boxes."""
    origin: tuple[Finite, Finite] = (0.0, 0.0)
    """CAD coordinates of the corner of the outline with the least x and y; with `file` it follows from the outline."""
    seed: Index = 5
    """Parts, copper, their looks, placement."""

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
    """The light barrier and the timing of the trigger pulses, as in `[line]` of station.toml."""

    barrier_mm: Finite = -40.0
    """Tester y of the light barrier; for `direction = -1` it lies at positive y."""
    approach_s: Positive = 0.1
    """From a passage's start (t = 0) until the board interrupts the barrier."""
    start_delay_s: NotNegative = 0.32
    """From the interruption to the first pulse."""
    period_s: Positive = 0.105
    """Between pulses."""
    tail_s: NotNegative = 0.48
    """Time for which pulses continue after the board has left the barrier."""
    longest_board_mm: Positive = 100.0
    """Gives the largest number of rows, as in station.toml."""
    debounce_s: NotNegative = 0.005
    """Shorter interruptions are bounces."""
    interval_s: Positive = 5.0
    """Between the starts of two passages."""
    lights: Annotated[tuple[str, ...], Field(min_length=1)] = ("ring",)
    """Names of the LED patterns, used in turn from row to row."""
    encoder_counts_per_mm: Positive | None = None
    """Counts of the belt's encoder, which then space the rows (encoder) instead of the clock."""


class CalibrationBoardSection(Section):
    """The board of crosses that `vaoi simulate --calibration-board` films; its coordinates are tester coordinates."""

    marks_per_axis: Annotated[int, Field(ge=2, le=40)] = 2
    """Crosses along each axis of every camera's view: 2 are four crosses."""
    mark_mm: Positive = 2.0
    """Size of a cross from tip to tip; its arms are a quarter as wide."""
    board_grey: Annotated[float, Field(ge=0, le=255)] = 205.0
    """Ground."""
    mark_grey: Annotated[float, Field(ge=0, le=255)] = 25.0
    """Crosses."""


class LightSection(Section):
    """One light pattern of the LEDs: its brightness, direction, shading and shadow.

    Without `[lights]` there is one pattern `ring` with these defaults.
    """

    gain: PerCamera = (1.0,)
    """Brightness for each camera; a short list is used in turn."""
    metal: NotNegative = 1.0
    """Factor on the brightness of pads, gold and other metal."""
    azimuth_deg: Finite = 0.0
    """Direction of the lamp, from tester x towards y."""
    shading: Share = 0.0
    """How much brighter frames and walls are on the lamp's side."""
    shadow: Share = 0.0
    """Depth of the shadows parts cast on the board."""
    elevation_deg: Annotated[float, Field(gt=5, lt=90)] = 45.0
    """Height of the lamp over the board: gives the shadows' length."""
    relief: Share = 0.0
    """How much brighter the slopes of metal that face the lamp are, and darker those that face away: pads are flat
    domes of solder."""

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
    """Number of the board."""


class LostRow(OnBoard):
    """A fault of a whole row: none of its frames arrives."""

    row: Index
    """Which row."""


class StuckBoard(LostRow):
    """The board stops at the pulse of a row and does not move again."""


class LostFrame(LostRow):
    """A fault of one camera's frame of one row: it never arrives."""

    camera: Index
    """Which camera."""


class LateFrame(LostFrame):
    """A frame that arrives late."""

    delay_s: Positive
    """How late."""


class IncompleteFrame(LostFrame):
    """A frame of which only the first bytes arrive: this share of them."""

    share: Annotated[float, Field(ge=0, lt=1)]
    """Share of the frame's bytes that arrives, from its start."""


class ExtraFrame(LostFrame):
    """An additional exposure of a camera after the pulse of a row."""

    after_s: Positive
    """How long after it."""


class FreeRunning(OnBoard):
    """A camera that ignores the trigger and sends frames at a fixed interval while the board passes."""

    camera: Index
    """Which camera."""
    interval_s: Positive
    """From frame to frame."""


class LateStamps(OnBoard):
    """A camera whose time stamps come later than the start of the exposure."""

    camera: Index
    """Which camera."""
    by_s: Positive
    """By how much."""


class Bounce(OnBoard):
    """The signal of the barrier is inverted for a while, starting `at_s` after the board interrupts it."""

    at_s: Finite
    """When, after the board interrupts the barrier; negative: before it comes."""
    duration_s: Positive
    """How long."""


class TurnedBoard(OnBoard):
    """The board was laid on the belt with an additional rotation of 90, 180 or 270 degrees."""

    turned_deg: Literal[90, 180, 270]
    """90, 180 or 270, in addition to `board.turned_deg`."""


class AbsentPart(OnBoard):
    """A part that is absent, because it was not placed on the board."""

    ref: str
    """Name of the part."""


class KnockedCamera(Section):
    """A camera that was knocked. From board `from_board` on, it is rotated against its calibrated direction."""

    camera: Index
    """Which camera."""
    from_board: Index = 0
    """The first board after the knock."""
    about: Literal["x", "y", "z"] = "z"
    """The camera's own axis of the rotation: x right and y down in its image, z ahead."""
    angle_deg: Annotated[float, Field(ge=-5, le=5)]
    """By how much."""


class FaultSection(Section):
    """All faults of a scenario, listed by kind.

    A fault without a board number applies to every board. A fault of a row that is never pulsed has no effect.
    """

    lost_frames: tuple[LostFrame, ...] = ()
    """Frames that never arrive."""
    lost_rows: tuple[LostRow, ...] = ()
    """Rows none of whose frames arrives."""
    late_frames: tuple[LateFrame, ...] = ()
    """Frames that arrive late."""
    incomplete_frames: tuple[IncompleteFrame, ...] = ()
    """Frames of which only the beginning arrives."""
    ignored_triggers: tuple[LostFrame, ...] = ()
    """Pulses that a camera ignores and does not count. This fault and the next four concern trigger and time stamps: a
    running station shows all of them, a recording only omits the frames of ignored pulses."""
    extra_frames: tuple[ExtraFrame, ...] = ()
    """A camera exposes once more than it was triggered, after the pulse of a row."""
    exchanged_frames: tuple[LostFrame, ...] = ()
    """The frames of a row and the next have each other's frame id and time stamp."""
    free_running: tuple[FreeRunning, ...] = ()
    """Cameras that ignore the trigger and send frames by their own clock while the board passes."""
    late_stamps: tuple[LateStamps, ...] = ()
    """Cameras that stamp their frames later than at the start of the exposure."""
    bounces: tuple[Bounce, ...] = ()
    """Times in which the barrier shows the opposite of the truth."""
    stuck: tuple[StuckBoard, ...] = ()
    """Boards that stop with the pulse of a row and stay. If the barrier stays interrupted, pulses end after the largest
    number of rows."""
    turned: tuple[TurnedBoard, ...] = ()
    """Boards that were laid on the belt turned."""
    absent_parts: tuple[AbsentPart, ...] = ()
    """Parts that were not placed; the bare pads are seen."""
    knocked: tuple[KnockedCamera, ...] = ()
    """Cameras that were knocked. The calibration does not change; frames and truth are those of the camera in its new
    direction."""


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
