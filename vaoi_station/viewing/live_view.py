"""Film continuously and serve the latest frames, or film once and report one row.

By default the light barrier is not used, because no board passes while cameras are mounted and focused.
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
"""Number of runs that means filming without end, because it is never reached."""
NOTICES = 20
"""Number of the latest notices that the page shows."""


def show(
    config: StationConfig,
    specs: Sequence[MarkSpec | None],
    port: int,
    say: Callable[[str], None],
    rate_hz: float | None = None,
) -> None:
    """Film and serve the page on loopback, until interrupted (KeyboardInterrupt) or a device fails.

    With `rate_hz`, the controller fires at this rate without the light barrier. Otherwise, boards are filmed. When a
    simulated or replayed line has no more boards, the last frames stay visible.
    """
    latest, ended = LatestFrames(specs), threading.Event()
    notices: deque[str] = deque(maxlen=NOTICES)

    def notice(sentence: str) -> None:
        notices.append(sentence)
        say(sentence)

    def settled(report: FrameSettled, ring: Ring, generation: int) -> None:
        frame = report.frame
        assert frame.slot is not None
        latest.put(frame.camera, report.run, frame.row, ring.snapshot(frame.slot, generation))
        # The filming loop is the only place that notices a dead web server while boards are filmed.
        if ended.is_set():
            web.check()

    with open_listener(LOOPBACK, port, "--port") as socket_:
        web = WebServer(create_app(config, latest, notices), socket_, ended.set)
        web.start()
        say(f"Live frames: {web.address}")
        try:
            if rate_hz is not None:
                notice(f"{rate_hz:g} pulses per second, independent of the light barrier.")
            runs = (_supply(config) if rate_hz is None else 0) or FOR_EVER
            _film(config, runs, rate_hz, FilmingHandlers(lambda *_: None, notice, settled))
            notice("No more boards; these are the last frames.")
            # Nothing is left to film, but the page stays open until Ctrl-C or a failure of the server.
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
    """Film one board (with `rate_hz`: one pulse) and return the document of one row, by default the middle row.

    Raises:
        InputError: the run has no such row.
    """
    documents: list[dict[str, Any]] = []

    def report_row(finished: RunFinished, ring: Ring, generation: int) -> None:
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
                viewed = ViewedFrame(f.camera, finished.run, f.row, f.camera + 1, pixels, specs[f.camera])
                cameras.append(frame_document(viewed, config))
            else:
                cameras.append({"camera": f.camera, "name": config.cameras[f.camera].name, "missing": f.cause})
        documents.append({"run": finished.run, "row": chosen, "rows": rows, "cameras": cameras})

    _film(config, 1, rate_hz, FilmingHandlers(report_row, notice))
    return documents[0]


def _film(config: StationConfig, runs: int, rate_hz: float | None, handlers: FilmingHandlers) -> None:
    if rate_hz is None:
        film(config, runs, handlers)
    else:
        film_pulses(config, runs, rate_hz, handlers)


def _supply(config: StationConfig) -> int:
    """Return the number of boards that the line supplies; 0 means without end."""
    if config.simulation is not None:
        return config.simulation.boards
    return config.replay.runs if config.replay is not None else 0
