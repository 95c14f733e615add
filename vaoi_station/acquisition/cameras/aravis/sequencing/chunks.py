"""Let a camera state exposure and gain behind the pixels of each frame (chunk data), and read them.

Only cameras with a sequencer are asked to. What a frame states proves with which set it was exposed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from vaoi_station.acquisition.cameras.aravis.library import glib_error
from vaoi_station.acquisition.cameras.aravis.settings import Setting, feature_setting, write_and_compare
from vaoi_station.acquisition.cameras.interface import StatedExposure
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError

CHUNK_MODE = "ChunkModeActive"
_EXPOSURE, _GAIN = "ExposureTime", "Gain"


def switch_on(camera: Any, config: CameraConfig) -> None:
    """Let each frame state exposure and, if the camera has one, gain.

    Raises:
        DeviceError: the camera cannot do it, or refuses or ignores a setting.
    """
    device = camera.get_device()
    offered = (
        camera.dup_available_enumerations_as_strings("ChunkSelector")
        if device.is_feature_available(CHUNK_MODE) and device.is_feature_available("ChunkSelector")
        else ()
    )
    wanted = [_EXPOSURE, *([_GAIN] if camera.is_gain_available() else [])]
    if missing := [name for name in wanted if name not in offered]:
        raise DeviceError(
            f"{config.label}: its frames cannot state {' and '.join(missing)} as chunk data (ChunkSelector offers "
            f"{', '.join(offered) or 'nothing'}), without which the exposures of its sequencer are not proven.",
            action='Set exposure_by = "trigger-width" or "register" in station.toml for this camera.',
            code="sequencer-absent",
        )
    for setting in _settings(device, wanted):
        write_and_compare(config.label, setting)


def _settings(device: Any, wanted: list[str]) -> Iterator[Setting]:
    yield feature_setting(device, CHUNK_MODE, True)
    for name in wanted:
        # All chunks share one selector.
        yield replace(feature_setting(device, "ChunkSelector", name), transient=True)
        yield replace(feature_setting(device, "ChunkEnable", True), transient=True)


class ChunkReader:
    """Reads the exposure that the frames of one camera state."""

    def __init__(self, camera: Any, nbytes: int) -> None:
        """Prepare to read.

        Args:
            camera: the `Aravis.Camera`, with its chunk data switched on.
            nbytes: size of the chunk data of each frame.
        """
        self.nbytes = nbytes
        # The parser has a description of its own: it is used by the pulling thread, while others access the camera.
        self._parser = camera.create_chunk_parser()
        self._has_gain = bool(camera.is_gain_available())

    def read(self, buffer: Any) -> StatedExposure | None:
        """Return what a complete frame states; None if it cannot be read."""
        try:
            exposure_us = float(self._parser.get_float_value(buffer, f"Chunk{_EXPOSURE}"))
            gain_db = float(self._parser.get_float_value(buffer, f"Chunk{_GAIN}")) if self._has_gain else None
        except glib_error():
            return None
        return StatedExposure(exposure_us, gain_db)
