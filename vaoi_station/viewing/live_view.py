"""Films what lies under the cameras and shows the newest frames; or films once and tells the figures of one row.

Without the light barrier by default: whoever mounts and focuses cameras has no board that passes.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from vaoi_station.acquisition.process.filming import FilmingHandlers, film, film_pulses
from vaoi_station.acquisition.process.messages import FrameSettled, RunFinished
from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.api.web_server import WebServer, open_listener
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.model import Verdict
from vaoi_station.viewing.app import create_app
from vaoi_station.viewing.frame_documents import frame_document
from vaoi_station.viewing.latest_frames import LatestFrames, ViewedFrame
from vaoi_station.viewing.mark_spec import MarkSpec

_log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
FOR_EVER = 2**62
NOTICES = 20
"""So many of the last notices are told."""


def show(
    config: StationConfig,
    specs: Sequence[MarkSpec | None],
    port: int,
    say: Callable[[str], None],
    rate_hz: float | None = None,
) -> None:
    """Film and serve the page on loopback, until interrupted (KeyboardInterrupt) or a device fails.

    With a rate, so many pulses a second are fired without the light barrier; else boards are filmed. When a
    line that has only so many boards is out of them, the last frames stay.
    """
    newest, ended = LatestFrames(specs), threading.Event()
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

    with open_listener(LOOPBACK, port, "--port") as socket_:
        web = WebServer(create_app(config, newest, notices), socket_, ended.set)
        web.start()
        say(f"Live frames: {web.address}")
        try:
            if rate_hz is not None:
                notice(f"{rate_hz:g} pulses a second, whether a board passes or not.")
            runs = (_supply(config) if rate_hz is None else 0) or FOR_EVER
            _film(config, runs, rate_hz, FilmingHandlers(lambda *_: None, notice, settled))
            notice("No more boards will come; these are the last frames.")
            ended.wait()
            web.check()
        finally:
            web.stop()


def one_row(
    config: StationConfig,
    specs: Sequence[MarkSpec | None],
    row: int | None,
    notice: Callable[[str], None],
    rate_hz: float | None = None,
) -> dict[str, Any]:
    """Film one board, or with a rate one pulse; the figures of one row of it, by default the middle one.

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
                shot = ViewedFrame(f.camera, finished.run, f.row, f.camera + 1, pixels, specs[f.camera])
                cameras.append(frame_document(shot, config))
            else:
                cameras.append({"camera": f.camera, "name": config.cameras[f.camera].name, "missing": f.cause})
        documents.append({"run": finished.run, "row": chosen, "rows": rows, "cameras": cameras})

    _film(config, 1, rate_hz, FilmingHandlers(look, notice))
    return documents[0]


def _film(config: StationConfig, runs: int, rate_hz: float | None, handlers: FilmingHandlers) -> None:
    if rate_hz is None:
        film(config, runs, handlers)
    else:
        film_pulses(config, runs, rate_hz, handlers)


def _supply(config: StationConfig) -> int:
    """How many boards there are; 0: they keep coming."""
    if config.simulation is not None:
        return config.simulation.boards
    return config.replay.runs if config.replay is not None else 0
