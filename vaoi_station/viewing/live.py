"""Films boards again and again and shows the newest frames; or films once and tells the figures of one row."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from vaoi_station.acquisition.filming import film
from vaoi_station.acquisition.messages import FrameSettled, RunFinished
from vaoi_station.acquisition.ring import Ring
from vaoi_station.api.serving import WebServer, listener
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.model import Verdict
from vaoi_station.viewing.app import create_app
from vaoi_station.viewing.newest import Newest, Shot
from vaoi_station.viewing.shapes import shot_document
from vaoi_station.viewing.spec import MarkSpec

_log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
FOR_EVER = 2**62
NOTICES = 20
"""So many of the last notices are told."""


def show(config: StationConfig, specs: Sequence[MarkSpec | None], port: int, say: Callable[[str], None]) -> None:
    """Film and serve the page on loopback, until interrupted (KeyboardInterrupt) or a device fails.

    When a line that has only so many boards is out of them, the last frames stay.
    """
    newest, ended = Newest(specs), threading.Event()
    notices: deque[str] = deque(maxlen=NOTICES)

    def notice(sentence: str) -> None:
        notices.append(sentence)
        say(sentence)

    def settled(report: FrameSettled, ring: Ring, generation: int) -> None:
        frame = report.frame
        assert frame.slot is not None
        newest.put(frame.camera, report.run, frame.row, ring.snapshot(frame.slot, generation))
        if ended.is_set():
            web.check()

    with listener(LOOPBACK, port, "--port") as socket_:
        web = WebServer(create_app(config, newest, notices), socket_, ended)
        web.start()
        say(f"Live frames: {web.address}")
        try:
            film(config, _supply(config) or FOR_EVER, lambda *_: None, notice, settled)
            notice("No more boards will come; these are the last frames.")
            ended.wait()
            web.check()
        finally:
            web.stop()


def one_row(
    config: StationConfig, specs: Sequence[MarkSpec | None], row: int | None, notice: Callable[[str], None]
) -> dict[str, Any]:
    """Film one board; the figures of one row of it, by default the middle one.

    Raises:
        InputError: the run has no such row.
    """
    documents: list[dict[str, Any]] = []

    def look(finished: RunFinished, ring: Ring, generation: int) -> None:
        rows = finished.head.rows
        chosen = rows // 2 if row is None else row
        if chosen >= rows:
            raise InputError.field("--row", "row", row, f"below {rows}, the rows of this run")
        cameras = []
        for f in finished.frames:
            if f.row != chosen:
                continue
            if f.verdict is Verdict.OK and f.slot is not None:
                pixels = ring.snapshot(f.slot, generation)
                shot = Shot(f.camera, finished.run, f.row, f.camera + 1, pixels, specs[f.camera])
                cameras.append(shot_document(shot, config))
            else:
                cameras.append({"camera": f.camera, "name": config.cameras[f.camera].name, "missing": f.cause})
        documents.append({"run": finished.run, "row": chosen, "rows": rows, "cameras": cameras})

    film(config, 1, look, notice)
    return documents[0]


def _supply(config: StationConfig) -> int:
    """How many boards there are; 0: they keep coming."""
    if config.simulation is not None:
        return config.simulation.boards
    return config.replay.runs if config.replay is not None else 0
