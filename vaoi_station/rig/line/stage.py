"""The line under the cameras: boards pass the barrier, the chip fires, the cameras see what the twin shows then.

    belt ──barrier edges──▶ chip ──edges of its pins──▶ shots ──pictures of the film──▶ cameras

Everything is dated by the chip's cycles: a passage's barrier edges are planned in cycles, and the board's place in a
frame follows from the cycle of its trigger. What was fired, and what became of it, is written down for the score.
"""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from vaoi_station.errors import InternalError
from vaoi_station.rig.devices.camera_orders import DARK, Order
from vaoi_station.rig.devices.camera_wire import CameraWire
from vaoi_station.rig.devices.chip import HZ, Chip, Edge
from vaoi_station.rig.devices.pins import Pins, Shot
from vaoi_station.rig.line.extra_frames import View
from vaoi_station.rig.line.films import Film

LEAD_S = 0.05
"""From the order to let a board pass to the passage's start: the emulator must have heard of it by then."""
BOUND_S = 5e-6
"""Film and chip agree so well about the time of a pulse; 0.02 px at 100 mm/s and 40 px/mm."""
SAME_LIGHT = 0.005
"""LED on-times are right to 0.2 us; what differs no more than this share is the film's light."""
SOME_PACKETS = 0.05
"""Of a frame that is hit by packet loss; with a hundred packets one frame in two hundred escapes unhurt."""

_LOOKS, _MOST_LOOKS, _NARROW_NS = 3, 100, 20_000
OVER_S = 0.5
"""So long after the film's end nothing of its board is fired any more."""

Fate = Literal["sent", "ignored", "hit", "lost", "dead", "late", "unarmed"]
"""What became of a camera's frame: sent whole; trigger ignored; packets missing; all packets missing; no camera;
rendered on demand; no frame, as no client had the camera armed."""


@dataclass(frozen=True)
class Lamp:
    """How the station was told to light: LED channels of every light's name."""

    channels: dict[str, tuple[int, ...]]
    exposures_us: tuple[float, ...]
    """Of every camera; LEDs outside an exposure are not seen."""

    def light_of(self, shot: Shot) -> str | None:
        """Name of the light that was lit; None: none, or LEDs that belong to no one light."""
        return next((name for name, channels in self.channels.items() if channels == shot.channels), None)

    def brightness(self, shot: Shot, camera: int) -> float:
        """Relative to a light that is as long as the camera's exposure."""
        if self.light_of(shot) is None:
            return 0.0
        share = min(shot.on_us / self.exposures_us[camera], 1.0)
        return 1.0 if abs(share - 1) < SAME_LIGHT else share


@dataclass
class Fired:
    """One pulse as it was."""

    row: int | None
    """Of the film; None: at a time the film does not have."""
    shot: Shot
    off_us: float
    """Time of the pulse minus the film's."""
    fates: list[Fate]
    """Of every camera."""
    light: list[float]
    """Brightness for every camera, relative to the film's."""
    note: str = ""
    """Why the film does not have it; empty: it does."""
    sent_ms: dict[int, float] = field(default_factory=dict)
    """Camera → how long after the pulse its first packet left."""


@dataclass
class Passing:
    """One board's passage as it was."""

    board: int
    film: Film
    start_cycle: int
    blocked_ns: int
    """CLOCK_MONOTONIC when it interrupted the barrier."""
    fired: list[Fired] = field(default_factory=list)


@dataclass(frozen=True)
class Mischief:
    """What the stage itself does wrong."""

    loss: float = 0.0
    """Share of the frames that are hit by packet loss."""
    ignored: frozenset[tuple[int, int, int]] = frozenset()
    """(board, row, camera) of pulses that a camera does not answer."""


class Stage:
    """Owns no process: chip and cameras are given, and live longer."""

    def __init__(
        self,
        cameras: Sequence[CameraWire],
        lamp: Lamp,
        mischief: Mischief | None = None,
        noticed: Callable[[int, int], None] = lambda _board, _row: None,
        unforeseen: Callable[[View], Path | None] = lambda _: None,
        seed: int = 1,
    ) -> None:
        """Nothing passes yet.

        Args:
            cameras: the wires to them.
            lamp: which LEDs make which light.
            mischief: what shall go wrong here.
            noticed: hears of board and row before the cameras are fired, in the chip's thread.
            unforeseen: renders what no film has; None: it stays dark.
            seed: chooses the frames that are hit by packet loss.
        """
        self._cameras, self._lamp, self._mischief = cameras, lamp, mischief or Mischief()
        self._unforeseen = unforeseen
        self._noticed = noticed
        self._dice = random.Random(seed)
        self._pins = Pins()
        self._change = threading.Lock()
        self._passing: Passing | None = None
        self._chip: Chip | None = None
        self._boards = 0
        self._over_ns = 0
        self.strays: list[Shot] = []
        """Pulses while no board passed."""

    def use(self, chip: Chip) -> None:
        """The chip whose edges will be heard."""
        self._chip = chip

    def hear(self, edge: Edge) -> None:
        """An output of the chip has changed."""
        shot = self._pins.edge(edge)
        if shot is not None:
            with self._change:
                self._fire(shot)

    def answered(self, camera: int, word: str, picture: int) -> None:
        """A camera says what it has done with an order; comes in its wire's own thread and waits for nobody."""
        now_ns, passing = time.monotonic_ns(), self._passing
        if passing is None or picture < 0:
            return
        for fired in list(passing.fired):
            if fired.row == picture // len(self._cameras):
                if word == "ignored":
                    fired.fates[camera] = "unarmed"
                else:
                    fired.sent_ms[camera] = (now_ns - fired.shot.host_ns) * 1e-6

    def let_pass(self, film: Film) -> Passing:
        """A board onto the belt; the one before must have passed."""
        assert self._chip is not None
        for camera in self._cameras:
            camera.show(film.frames)
        start = self._chip.cycle_at(time.monotonic_ns() + round(LEAD_S * 1e9))
        blocked_s = next(t for t, blocked in film.sheet.edges if blocked)
        passing = Passing(self._boards, film, start, self._chip.host_ns(start + round(blocked_s * HZ)))
        with self._change:
            self._passing, self._boards = passing, self._boards + 1
            self._over_ns = self._chip.host_ns(start + round((film.lasts_s + OVER_S) * HZ))
        self._plan_edges(passing, start)
        return passing

    def chip_restarted(self) -> None:
        """The chip was reset: its outputs are low, and it has forgotten the barrier's edges to come."""
        assert self._chip is not None
        self._pins = Pins()
        if self._passing is not None:
            self._plan_edges(self._passing, self._chip.cycle_at(time.monotonic_ns()))

    def _plan_edges(self, passing: Passing, after_cycle: int) -> None:
        assert self._chip is not None
        for t, blocked in passing.film.sheet.edges:
            cycle = passing.start_cycle + round(t * HZ)
            if cycle >= after_cycle:
                self._chip.tell(f"at {cycle} PB0 {int(blocked)}")

    def _fire(self, shot: Shot) -> None:
        passing = self._passing
        row, off_s = _row(passing, shot) if passing is not None else (None, 0.0)
        if passing is None or shot.host_ns > self._over_ns:
            self.strays.append(shot)
            self._later(View(None), shot)
            return
        if row is not None:
            self._noticed(passing.board, row)
        note, count = self._note(passing, row, shot), len(self._cameras)
        light = [self._lamp.brightness(shot, n) for n in range(count)]
        fired = Fired(row, shot, off_s * 1e6, ["late"] * count, light, note)
        passing.fired.append(fired)  # before the cameras can answer
        if row is not None and not note:
            stamp_ns = wall_clock_ns(shot.host_ns)
            for n in range(count):
                self._fire_camera(passing, fired, row, n, stamp_ns)
        if note:
            t = (shot.cycle - passing.start_cycle) / HZ
            light_name = self._lamp.light_of(shot) or passing.film.sheet.lights[0]
            self._later(View(passing.film.sheet.board, t, light_name, len(passing.fired)), shot)

    def _note(self, passing: Passing, row: int | None, shot: Shot) -> str:
        """Why the film does not have what is to be seen."""
        if row is None:
            return "fired at a time that the film does not have"
        light = passing.film.sheet.lights[row]
        if self._lamp.light_of(shot) not in (light, None) or (shot.channels and self._lamp.light_of(shot) is None):
            return f"LED channels {shot.channels} were lit, not those of {light!r}"
        return ""

    def _fire_camera(self, passing: Passing, fired: Fired, row: int, camera: int, stamp_ns: int) -> None:
        if (passing.board, row, camera) in self._mischief.ignored:
            fired.fates[camera] = "ignored"
            return
        fired.fates[camera], lost = self._fate(passing, row, camera)
        picture = row * len(self._cameras) + camera
        if not self._cameras[camera].fire(Order(picture, stamp_ns, fired.light[camera], lost)):
            fired.fates[camera] = "dead"

    def _fate(self, passing: Passing, row: int, camera: int) -> tuple[Fate, float]:
        """And the share of packets that are not sent."""
        if (camera, row) in passing.film.sheet.lost:
            return "lost", 1.0
        return ("hit", SOME_PACKETS) if self._dice.random() < self._mischief.loss else ("sent", 0.0)

    def _later(self, view: View, shot: Shot) -> None:
        """Rendered aside; the cameras send it when it is there, with the time it is of."""

        def send() -> None:
            with contextlib.suppress(InternalError):  # the rig is being taken down
                pictures = self._unforeseen(view)
                self._send_all(pictures, shot)

        threading.Thread(target=send, name="late frames", daemon=True).start()

    def _send_all(self, pictures: Path | None, shot: Shot) -> None:
        stamp_ns = wall_clock_ns(shot.host_ns)
        for n, camera in enumerate(self._cameras):
            order = Order(n if pictures else DARK, stamp_ns, self._lamp.brightness(shot, n))
            camera.fire(order, pictures)


def wall_clock_ns(host_ns: int) -> int:
    """CLOCK_REALTIME at a time of CLOCK_MONOTONIC: the cameras' clock.

    Whoever is interrupted between looking at two clocks is wrong by that; so the narrowest of a few looks counts.
    """
    looks: list[tuple[int, int]] = []
    while len(looks) < _LOOKS or (min(looks)[0] > _NARROW_NS and len(looks) < _MOST_LOOKS):
        before_ns, wall_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        looks.append((after_ns - before_ns, wall_ns - (before_ns + after_ns) // 2))
    return host_ns + min(looks)[1]


def _row(passing: Passing, shot: Shot) -> tuple[int | None, float]:
    """The film's row of a pulse, and how far it is from the film's time, s; None: the film has no such time."""
    t = (shot.cycle - passing.start_cycle) / HZ
    pulses = passing.film.sheet.pulses_s
    if not pulses:
        return None, 0.0
    row = min(range(len(pulses)), key=lambda j: abs(pulses[j] - t))
    off_s = t - pulses[row]
    return (row if abs(off_s) <= BOUND_S else None), off_s
