"""The sequencer of the scripted camera (SFNC): its sets, and which of them is active."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

FRAME_START = 1


@dataclass(frozen=True)
class SequencerSet:
    """What is saved in one set."""

    exposure_us: float
    gain_db: float
    next_set: int
    source: int


class Sequencer:
    """Sets that are saved in configuration mode; once the sequencer is on, each frame start leads to the next one."""

    def __init__(self) -> None:
        self.sets: dict[int, SequencerSet] = {}
        self.forgets_saving = False
        """Whether the camera ignores the command to save a set."""
        self.on = False
        self._number = self._start = 0

    @property
    def active(self) -> tuple[float, float] | None:
        """Exposure (µs) and gain (dB) of the active set; None while the sequencer is off."""
        if not self.on:
            return None
        chosen = self.sets[self._number]
        return chosen.exposure_us, chosen.gain_db

    def advance(self) -> None:
        """Go to the next set, as the start of a frame was the signal to do so."""
        if self.on and self.sets[self._number].source == FRAME_START:
            self._number = self.sets[self._number].next_set

    def refuses(self, name: str, get: Callable[[str], float]) -> bool:
        """Whether a write is refused: SequencerMode is locked during configuration, and while no set is saved."""
        return name == "SequencerMode" and (not self.sets or bool(get("SequencerConfigurationMode")))

    def write(self, name: str, get: Callable[[str], float], put: Callable[[str, float], object]) -> None:
        """React to a client's write to a feature of the sequencer, which has its new value already."""
        configuring, selected = bool(get("SequencerConfigurationMode")), int(get("SequencerSetSelector"))
        if name == "SequencerMode":
            self.on, self._number = bool(get(name)) and not configuring and bool(self.sets), self._start
            put(name, int(self.on))
        elif name == "SequencerSetStart":
            self._start = int(get(name))
        elif name == "SequencerSetSave" and configuring and not self.forgets_saving:
            following, source = int(get("SequencerSetNext")), int(get("SequencerTriggerSource"))
            self.sets[selected] = SequencerSet(get("ExposureTime"), get("Gain"), following, source)
        elif name == "SequencerSetLoad" and configuring:
            chosen = self.sets.get(selected, SequencerSet(10_000, 0, 0, 0))
            put("ExposureTime", chosen.exposure_us)
            put("Gain", chosen.gain_db)
            put("SequencerSetNext", chosen.next_set)
            put("SequencerTriggerSource", chosen.source)
