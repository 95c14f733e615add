"""The virtual line: boards pass the barrier, the chip fires pulses, and the cameras send the twin's frames.

    belt ──barrier edges──▶ chip ──edges of its pins──▶ pulses ──rendered frames──▶ cameras

All times are cycles of the chip: edges are planned in cycles, and the cycle of a trigger decides at which position the
frame shows the board. For the score, every pulse is recorded with the outcome of its frames.
"""

from __future__ import annotations

import math
import random
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Literal

from vaoi_station.errors import DeviceError, InputError, InternalError
from vaoi_station.model import ProgramRow
from vaoi_station.model.recording import row_of
from vaoi_station.rig.camera_process import DARK, CameraProcess, TriggerCommand
from vaoi_station.rig.chip import CHANNELS, HZ, Chip, Edge, Pulse, PulseDecoder
from vaoi_station.rig.faults import KINDS
from vaoi_station.rig.rendering import FrameRequest, RenderedBoard
from vaoi_station.simulation import Scenario
from vaoi_station.simulation.twin import program_of

LINE_READY = "PC0"
LEAD_S = 0.05
"""Time from `start_passage` to the start of the passage. The emulator must receive the planned edges in this time."""
PULSE_TOLERANCE_S = 5e-6
"""Largest difference between the time of a pulse and the time for which its frames were rendered, s.

At 100 mm/s and 40 px/mm, it displaces the board by 0.02 px."""
COUNT_TOLERANCE_S = 50e-6
"""The same where a count of the encoder decides: its interrupt may wait for another one, up to 42 µs (limits.h)."""
BRIGHTNESS_TOLERANCE = 0.005
"""Relative difference up to which a brightness counts as the rendered brightness. LED on-times are exact to 0.2 µs."""
LOST_PACKET_SHARE = 0.05

END_MARGIN_S = 0.5

FrameOutcome = Literal["sent", "ignored", "hit", "lost", "dead", "late", "unarmed"]
"""The outcome of a camera's frame.

sent: all packets were sent. ignored: the camera ignored the trigger. hit: some packets are missing. lost: all packets
are missing. dead: the camera process did not run. late: rendered on demand. unarmed: no frame, because no client had
armed the camera.
"""


@dataclass(frozen=True)
class Lighting:
    """The lights of the station: the LED channels of each light, and the exposure times of the cameras."""

    channels: dict[str, tuple[int, ...]]
    exposures_us: tuple[float, ...]
    """Exposure of every camera. LEDs have no effect on a frame outside the exposure."""
    program: tuple[ProgramRow, ...] = ()
    """The light program for which frames are rendered; empty if every row has the exposures above."""

    def light_of(self, pulse: Pulse) -> str | None:
        """Return the name of the light that was on; None: no LED was on, or the LEDs do not form one light."""
        return next((name for name, channels in self.channels.items() if channels == pulse.channels), None)

    def exposure_us(self, pulse: Pulse, camera: int, row: int) -> float:
        """Return for how long the LEDs of a pulse lit the frame that a camera takes by the program of a row, µs."""
        step = row_of(self.program, row)
        return min(pulse.on_us, self.exposures_us[camera] if step is None else step.exposures_us[camera])

    def brightness(self, pulse: Pulse, camera: int, row: int | None = None) -> float:
        """Return the brightness of a camera's frame, relative to the frame that was rendered.

        A frame is rendered for a light that is on for the whole exposure, or as long as the program has for its row.
        """
        timed, by_width = self.brightnesses(pulse, camera, row)
        return timed if by_width is None else by_width

    def brightnesses(self, pulse: Pulse, camera: int, row: int | None = None) -> tuple[float, float | None]:
        """Return the brightness of a frame in the exposure modes Timed and TriggerWidth.

        The second is None if all rows of the camera have one exposure, so that it stays in Timed. Otherwise its
        register, which counts in Timed, is not set by the program.
        """
        if self.light_of(pulse) is None:
            return 0.0, None
        expected = None if row is None else row_of(self.program, row)
        if expected is None:
            exposure_us = rendered_us = self.exposures_us[camera]
        else:
            exposure_us, rendered_us = expected.exposures_us[camera], expected.lit_us[camera]
        if len({step.exposures_us[camera] for step in self.program}) < 2:
            return _share(min(pulse.on_us, exposure_us) / rendered_us), None
        timed = _share(min(pulse.on_us, self.exposures_us[camera]) / rendered_us)
        return timed, _share(min(pulse.on_us, pulse.width_us) / rendered_us)


def _share(share: float) -> float:
    return 1.0 if abs(share - 1) < BRIGHTNESS_TOLERANCE else share


@dataclass
class FiredPulse:
    """One pulse during a passage, and the outcome of its frames."""

    row: int | None
    pulse: Pulse
    offset_us: float
    """Time of the pulse minus the nearest time for which frames were rendered, µs."""
    outcomes: list[FrameOutcome]
    brightness: list[float]
    """Brightness of each camera's frame, relative to the rendered frame."""
    note: str = ""
    """Text that states how the pulse differs from the pulse for which frames were rendered; empty if it does not."""
    sent_ms: dict[int, float] = field(default_factory=dict)
    """Camera → time, ms, from the pulse to the last packet of the camera's frame."""


@dataclass
class BoardPassage:
    """The passage of one board over the virtual line, with all pulses that were fired for it."""

    board: int
    rendered: RenderedBoard
    start_cycle: int
    blocked_ns: int
    """Time at which the board interrupts the barrier, ns of CLOCK_MONOTONIC."""
    fired: list[FiredPulse] = field(default_factory=list)
    held_s: float | None = 0.0
    """Time for which the conveyor held the board back, s; None: it came although the output "line ready" was off."""


@dataclass(frozen=True)
class FrameFaults:
    """The faults of frames (lost packets, ignored pulses) that the virtual line injects, by camera and row."""

    loss: float = 0.0
    ignored: frozenset[tuple[int, int, int]] = frozenset()
    """(board, row, camera) of pulses that a camera ignores."""
    late_stamps: tuple[tuple[int, int, float], ...] = ()
    """(first board, camera, seconds) by which the time stamps of a camera come later from that board on."""

    def stamp_delay_ns(self, board: int, camera: int) -> int:
        """Return by how much the time stamp of a camera's frame comes later than its pulse."""
        return sum(round(by_s * 1e9) for first, late, by_s in self.late_stamps if late == camera and first <= board)


class VirtualLine:
    """The virtual line: to let a board pass, it sends barrier edges to the chip and triggers cameras at its pulses."""

    def __init__(
        self,
        cameras: Sequence[CameraProcess],
        lighting: Lighting,
        frame_faults: FrameFaults | None = None,
        on_row: Callable[[int, int], None] = lambda _board, _row: None,
        render_on_demand: Callable[[FrameRequest], Path | None] = lambda _: None,
        seed: int = 1,
    ) -> None:
        """Prepare the line; no board passes yet."""
        self._cameras, self._lighting, self._frame_faults = cameras, lighting, frame_faults or FrameFaults()
        self._render_on_demand = render_on_demand
        self._on_row = on_row
        self._random = random.Random(seed)
        self._decoder = PulseDecoder()
        self._change = threading.Lock()
        self._passage: BoardPassage | None = None
        self._chip: Chip | None = None
        self._permitted = threading.Event()
        self._boards = 0
        self._end_ns = 0
        self.unexpected_pulses: list[Pulse] = []

    def attach_chip(self, chip: Chip) -> None:
        """Set the chip whose edges `on_edge` receives."""
        self._chip = chip

    def on_edge(self, edge: Edge) -> None:
        """Handle an edge of one of the chip's outputs: if it completes a pulse, trigger the cameras."""
        if edge.pin == LINE_READY:
            (self._permitted.set if edge.level else self._permitted.clear)()
        pulse = self._decoder.process(edge)
        if pulse is not None:
            with self._change:
                self._handle_pulse(pulse)

    def wait_permitted(self, timeout_s: float) -> bool:
        """Wait until the output "line ready" is on, as a conveyor does with a board; return False after the timeout."""
        return self._permitted.wait(timeout_s)

    def on_camera_report(self, camera: int, word: str, picture: int) -> None:
        """Record a camera's report: a frame was sent, or a trigger was ignored because no client had armed it.

        Called in the thread that reads the camera's reports. It takes no lock: `_handle_pulse` holds the lock while it
        writes to cameras, so a wait for the lock here could become a deadlock.
        """
        now_ns, passage = time.monotonic_ns(), self._passage
        if passage is None or picture < 0:
            return
        for fired in list(passage.fired):
            if fired.row == picture // len(self._cameras):
                if word == "ignored":
                    fired.outcomes[camera] = "unarmed"
                else:
                    fired.sent_ms[camera] = (now_ns - fired.pulse.host_ns) * 1e-6

    def start_passage(self, rendered: RenderedBoard) -> BoardPassage:
        """Start the passage of a board. The passage of the board before it must have ended."""
        assert self._chip is not None
        for camera in self._cameras:
            camera.select_frames(rendered.frames_path)
        start = self._chip.cycle_at(time.monotonic_ns() + round(LEAD_S * 1e9))
        blocked_s = next(t for t, blocked in rendered.metadata.edges if blocked)
        passage = BoardPassage(self._boards, rendered, start, self._chip.host_ns(start + round(blocked_s * HZ)))
        with self._change:
            self._passage, self._boards = passage, self._boards + 1
            self._end_ns = self._chip.host_ns(start + round((rendered.duration_s + END_MARGIN_S) * HZ))
        self._plan_edges(passage, start)
        return passage

    def on_chip_reset(self) -> None:
        """Handle a reset of the chip: outputs are low and planned edges are lost, so plan the later edges again."""
        assert self._chip is not None
        self._decoder = PulseDecoder()
        self._permitted.clear()
        if self._passage is not None:
            self._plan_edges(self._passage, self._chip.cycle_at(time.monotonic_ns()))

    def _plan_edges(self, passage: BoardPassage, after_cycle: int) -> None:
        assert self._chip is not None
        counts = [passage.start_cycle + round(t * HZ) for t in passage.rendered.metadata.counts_s]
        if counts := [cycle for cycle in counts if cycle >= after_cycle]:
            self._chip.send("travel " + " ".join(map(str, (counts[0], *(b - a for a, b in pairwise(counts))))))
        for t, blocked in passage.rendered.metadata.edges:
            cycle = passage.start_cycle + round(t * HZ)
            if cycle >= after_cycle:
                self._chip.send(f"at {cycle} PB0 {int(blocked)}")

    def _handle_pulse(self, pulse: Pulse) -> None:
        passage = self._passage
        row, offset_s = _rendered_row(passage, pulse) if passage is not None else (None, 0.0)
        if passage is None or pulse.host_ns > self._end_ns:
            self.unexpected_pulses.append(pulse)
            self._render_late(FrameRequest(None), pulse)
            return
        if row is not None:
            self._on_row(passage.board, row)
        note, count = self._mismatch(passage, row, pulse), len(self._cameras)
        brightness = [self._lighting.brightness(pulse, n, row) for n in range(count)]
        fired = FiredPulse(row, pulse, offset_s * 1e6, ["late"] * count, brightness, note)
        # The pulse is recorded before the cameras are triggered, because they may report at once.
        passage.fired.append(fired)
        # The cameras are triggered here, in the chip's thread, because a queue between threads would add latency.
        if row is not None and not note:
            for n in range(count):
                self._trigger_camera(passage, fired, row, n)
        if note:
            t = (pulse.cycle - passage.start_cycle) / HZ
            light_name = self._lighting.light_of(pulse) or passage.rendered.metadata.lights[0]
            self._render_late(FrameRequest(passage.rendered.metadata.board, t, light_name, len(passage.fired)), pulse)

    def _mismatch(self, passage: BoardPassage, row: int | None, pulse: Pulse) -> str:
        """Return a text on how a pulse differs from the one that was rendered; empty if it does not differ."""
        if row is None:
            return "fired at a time for which no frame was rendered"
        light = passage.rendered.metadata.lights[row]
        if self._lighting.light_of(pulse) not in (light, None) or (
            pulse.channels and self._lighting.light_of(pulse) is None
        ):
            return f"LED channels {pulse.channels} were lit, not those of {light!r}"
        return ""

    def _trigger_camera(self, passage: BoardPassage, fired: FiredPulse, row: int, camera: int) -> None:
        if (passage.board, row, camera) in self._frame_faults.ignored:
            fired.outcomes[camera] = "ignored"
            return
        fired.outcomes[camera], lost = self._outcome(passage, row, camera)
        picture = row * len(self._cameras) + camera
        timestamp_ns = fired.pulse.host_ns + self._frame_faults.stamp_delay_ns(passage.board, camera)
        timed, by_width = self._lighting.brightnesses(fired.pulse, camera, row)
        if not self._cameras[camera].trigger(TriggerCommand(picture, timestamp_ns, timed, lost, by_width)):
            fired.outcomes[camera] = "dead"

    def _outcome(self, passage: BoardPassage, row: int, camera: int) -> tuple[FrameOutcome, float]:
        """Decide the outcome of a frame. Return it with the share of the frame's packets that is lost, 0 to 1."""
        if (camera, row) in passage.rendered.metadata.lost:
            return "lost", 1.0
        return ("hit", LOST_PACKET_SHARE) if self._random.random() < self._frame_faults.loss else ("sent", 0.0)

    def _render_late(self, request: FrameRequest, pulse: Pulse) -> None:
        def send() -> None:
            try:
                frames = self._render_on_demand(request)
            except InternalError:  # the rig is being stopped
                return
            for n, camera in enumerate(self._cameras):
                stamp_ns = pulse.host_ns + self._frame_faults.stamp_delay_ns(max(self._boards - 1, 0), n)
                command = TriggerCommand(n if frames else DARK, stamp_ns, self._lighting.brightness(pulse, n))
                camera.trigger(command, frames)

        # Rendering takes longer than a trigger period. In the chip's thread it would delay the pulses that follow.
        threading.Thread(target=send, name="late frames", daemon=True).start()


def _rendered_row(passage: BoardPassage, pulse: Pulse) -> tuple[int | None, float]:
    """Return the row whose rendered time is nearest to a pulse, and the difference in s; row None if none is near."""
    t = (pulse.cycle - passage.start_cycle) / HZ
    pulses = passage.rendered.metadata.pulses_s
    if not pulses:
        return None, 0.0
    # The row is found by time, not by counting pulses: after a reset or a bounce the count may be wrong.
    row = min(range(len(pulses)), key=lambda j: abs(pulses[j] - t))
    offset_s = t - pulses[row]
    tolerance_s = COUNT_TOLERANCE_S if passage.rendered.metadata.counts_s else PULSE_TOLERANCE_S
    return (row if abs(offset_s) <= tolerance_s else None), offset_s


_SIMULATED_CAMERA_FAULTS = (
    "late_frames", "incomplete_frames", "ignored_triggers", "extra_frames", "exchanged_frames", "free_running",
    "late_stamps",
)  # fmt: skip


def with_cameras(scenario: Scenario, count: int | None) -> Scenario:
    """Return the scenario with `count` cameras and a board as wide as they can see; unchanged if `count` is None."""
    array = scenario.array
    if count is None or count == array.cameras:
        return scenario
    width_mm = scenario.board.width_mm + (count - array.cameras) * array.pitch_mm
    if width_mm < 8:
        raise InputError.field("vaoi rig", "--cameras", count, "enough to see a board of 8 mm")
    board = scenario.board.model_copy(update={"width_mm": round(width_mm, 3), "name": f"{scenario.board.name}-{count}"})
    return scenario.model_copy(update={"array": array.model_copy(update={"cameras": count}), "board": board})


def check_supported(scenario: Scenario) -> None:
    """Raise InputError if the scenario contains camera faults; on the rig, `--fault` injects such faults."""
    for name in _SIMULATED_CAMERA_FAULTS:
        if getattr(scenario.faults, name):
            action = f"Take them out, and ask for {', '.join(KINDS)} by --fault."
            raise InputError(
                f"scenario: faults.{name} apply to the cameras of the in-process twin only.", action=action
            )


def lighting_of(scenario: Scenario) -> Lighting:
    """Assign one LED channel to each light of the scenario."""
    program = program_of(scenario)
    names = tuple(dict.fromkeys(row.light for row in program)) or tuple(dict.fromkeys(scenario.line.lights))
    if len(names) > len(CHANNELS):
        key = "program" if program else "line.lights"
        raise InputError.field("scenario", f"lights of {key}", names, f"at most {len(CHANNELS)} different ones")
    exposures_us = tuple(scenario.array.exposure_us(n) for n in range(scenario.array.cameras))
    return Lighting({name: (n,) for n, name in enumerate(names)}, exposures_us, program)


def min_interval_s(scenario: Scenario, boards: Sequence[RenderedBoard]) -> float:
    """Return the shortest interval between boards, s: one must have passed, and its bay be free, before the next."""
    # 0.8 s are for the result and the release of the bay. The sum is rounded up to a tenth of a second.
    return max(scenario.line.interval_s, math.ceil(10 * (max(b.duration_s for b in boards) + 0.8)) / 10)


READY_TIMEOUT_S = 30.0
"""Longest wait until the station is ready for a board, and until it permits the board, s each. After it, the board
passes nevertheless."""
FEED_MARGIN_S = 1.0


class BoardFeeder:
    """A thread, as a context manager, that lets boards pass. At the end of the context no more boards come.

    If the chip ends unexpectedly, the end of the context raises the thread's DeviceError.
    """

    def __init__(
        self,
        line: VirtualLine,
        boards: Sequence[RenderedBoard],
        interval_s: float,
        wait_ready: Callable[[float], bool] = lambda _: True,
        wait_permitted: Callable[[float], bool] = lambda _: True,
    ) -> None:
        """Prepare the feeder."""
        self._line, self._boards, self._interval_s, self._wait_ready = line, boards, interval_s, wait_ready
        self._wait_permitted = wait_permitted
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="feeder")
        self.passages: list[BoardPassage] = []
        self.finished = threading.Event()
        self._failure: DeviceError | None = None

    def __enter__(self) -> BoardFeeder:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        if self._failure is not None and kind is None:
            raise self._failure

    def _work(self) -> None:
        try:
            self._feed()
        except DeviceError as error:
            # An exception that leaves a thread is only printed. So it is kept here, and __exit__ raises it.
            self._failure = error
        self.finished.set()

    def _feed(self) -> None:
        due_s = time.monotonic()
        for board in self._boards:
            if self._closing.wait(max(due_s - time.monotonic(), 0.0)):
                return
            self._wait_ready(READY_TIMEOUT_S)
            came_s = time.monotonic()
            permitted = self._wait_permitted(READY_TIMEOUT_S)
            held_s = time.monotonic() - came_s if permitted else None
            # This is counted from the time at which the station was ready, so that a slow station does not get two
            # boards at once.
            due_s = time.monotonic() + self._interval_s
            passage = self._line.start_passage(board)
            passage.held_s = held_s
            self.passages.append(passage)
            if self._closing.wait(board.duration_s + FEED_MARGIN_S):
                return
