"""The sequencer of the test camera (SFNC): its sets, and which of them is active."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tests.gige.description import ADDRESSES

FRAME_START = 1
_NAMES = {address: name for name, address in ADDRESSES.items()}


@dataclass(frozen=True)
class SequencerSet:
    """What is saved in one set."""

    exposure_us: int
    gain_centibel: int
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
    def active(self) -> tuple[int, int] | None:
        """Exposure (µs) and gain (0.01 dB) of the active set; None while the sequencer is off."""
        if not self.on:
            return None
        chosen = self.sets[self._number]
        return chosen.exposure_us, chosen.gain_centibel

    def advance(self) -> None:
        """Go to the next set, as the start of a frame was the signal to do so."""
        if self.on and self.sets[self._number].source == FRAME_START:
            self._number = self.sets[self._number].next_set

    def refuses(self, address: int, get: Callable[[str], int]) -> bool:
        """Whether a write is refused: SequencerMode is locked during configuration, and while no set is saved."""
        return _NAMES[address] == "SequencerMode" and (not self.sets or bool(get("SequencerConfigurationMode")))

    def write(self, address: int, get: Callable[[str], int], put: Callable[[str, int], None]) -> None:
        """React to a client's write to a register of the sequencer, which has its new value already."""
        name, configuring = _NAMES[address], bool(get("SequencerConfigurationMode"))
        selected = get("SequencerSetSelector")
        if name == "SequencerMode":
            self.on, self._number = bool(get(name)) and not configuring and bool(self.sets), self._start
            put(name, int(self.on))
        elif name == "SequencerSetStart":
            self._start = get(name)
        elif name == "SequencerSetSave" and configuring and not self.forgets_saving:
            self.sets[selected] = SequencerSet(
                get("ExposureTimeRaw"), get("GainCentibel"), get("SequencerSetNext"), get("SequencerTriggerSource")
            )
        elif name == "SequencerSetLoad" and configuring:
            chosen = self.sets.get(selected, SequencerSet(10_000, 0, 0, 0))
            put("ExposureTimeRaw", chosen.exposure_us)
            put("GainCentibel", chosen.gain_centibel)
            put("SequencerSetNext", chosen.next_set)
            put("SequencerTriggerSource", chosen.source)
