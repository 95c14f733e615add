"""Inline Video-AOI station: films a board on its way into the tester and provides images of its components.

`import vaoi_station as vaoi` gives the public Python API: the names in `__all__`, and nothing else, are stable.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from vaoi_station.version import __version__

if TYPE_CHECKING:
    from vaoi_station.board_check.check import CheckedBoardType
    from vaoi_station.errors import (
        BusyError,
        DeviceError,
        GoneError,
        InputError,
        InternalError,
        NotFoundError,
        StateError,
        VaoiError,
    )
    from vaoi_station.library.async_station import AsyncBoardTypes, AsyncStation, AsyncStationRun, connect_async
    from vaoi_station.library.board_data import ImportedBoard, import_board_data
    from vaoi_station.library.component_images import ComponentImage, ComponentImages
    from vaoi_station.library.documents import (
        read_board_type,
        read_calibration,
        read_image,
        read_result,
        write_board_type,
        write_calibration,
        write_image,
    )
    from vaoi_station.library.live_station import MergedPicture, Station, StationBoardTypes, StationRun, connect
    from vaoi_station.library.picture_stream import ComponentPictures
    from vaoi_station.library.recordings import RecordedRun, StitchedRun, open_recording, simulate, stitch
    from vaoi_station.model import BoardType, Calibration, Component, Status
    from vaoi_station.model import Stitch as Result

_LOCATIONS = {
    "AsyncBoardTypes": "library.async_station",
    "AsyncStation": "library.async_station",
    "AsyncStationRun": "library.async_station",
    "BoardType": "model",
    "BusyError": "errors",
    "Calibration": "model",
    "Component": "model",
    "CheckedBoardType": "board_check.check",
    "ComponentImage": "library.component_images",
    "ComponentImages": "library.component_images",
    "ComponentPictures": "library.picture_stream",
    "DeviceError": "errors",
    "GoneError": "errors",
    "ImportedBoard": "library.board_data",
    "InputError": "errors",
    "InternalError": "errors",
    "MergedPicture": "library.live_station",
    "NotFoundError": "errors",
    "RecordedRun": "library.recordings",
    "Result": "model:Stitch",
    "StateError": "errors",
    "Station": "library.live_station",
    "StationImport": "library.live_station",
    "StationRun": "library.live_station",
    "StationBoardTypes": "library.live_station",
    "Status": "model",
    "StitchedRun": "library.recordings",
    "VaoiError": "errors",
    "connect": "library.live_station",
    "connect_async": "library.async_station",
    "import_board_data": "library.board_data",
    "open_recording": "library.recordings",
    "read_board_type": "library.documents",
    "read_calibration": "library.documents",
    "read_image": "library.documents",
    "read_result": "library.documents",
    "simulate": "library.recordings",
    "stitch": "library.recordings",
    "write_board_type": "library.documents",
    "write_calibration": "library.documents",
    "write_image": "library.documents",
}
"""For every public name, the module that defines it, and after a colon the name in that module if it differs."""

__all__ = [
    "AsyncBoardTypes",
    "AsyncStation",
    "AsyncStationRun",
    "BoardType",
    "BusyError",
    "Calibration",
    "CheckedBoardType",
    "Component",
    "ComponentImage",
    "ComponentImages",
    "ComponentPictures",
    "DeviceError",
    "GoneError",
    "ImportedBoard",
    "InputError",
    "InternalError",
    "MergedPicture",
    "NotFoundError",
    "RecordedRun",
    "Result",
    "StateError",
    "Station",
    "StationBoardTypes",
    "StationImport",
    "StationRun",
    "Status",
    "StitchedRun",
    "VaoiError",
    "__version__",
    "connect",
    "connect_async",
    "import_board_data",
    "open_recording",
    "read_board_type",
    "read_calibration",
    "read_image",
    "read_result",
    "simulate",
    "stitch",
    "write_board_type",
    "write_calibration",
    "write_image",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `vaoi --help` loads neither numpy nor numba (PEP 562)."""
    location = _LOCATIONS.get(name)
    if location is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = location.partition(":")
    value = getattr(importlib.import_module(f"{__name__}.{module}"), attribute or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
