"""How fast a browser shows the whole board and moves it: `python -m tests.api.web.cost.zoom_cost`.

The station is that of `vaoi demo`, on loopback, with the board of the paper: 420 frames, 262 megapixels. Its workers
render the tiles of fine levels when they are asked for. Its processes and the browser share the cores of this machine.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from tests.api.web.conftest import ARGUMENTS
from tests.needs import chromium
from vaoi_station.benchmarks.process_usage import CpuMeter
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.temporary_folder import temporary_folder
from vaoi_station.demo.waiting import poll, wait_until_idle
from vaoi_station.simulation.scenario_files import scenario_path

IDLE_S, LONGEST_REST_S = 3.0, 120.0
COMPLETE = """() => {
    const item = window.OpenSeadragon?.getViewer("zoom-view")?.world?.getItemAt(0);
    return item?.getFullyLoaded() ? performance.now() : 0;
}"""
"""The time since the navigation once every tile in view is there, in the best resolution for the screen; else 0."""
SHOWN_1_TO_1 = """() => {
    performance.setResourceTimingBufferSize(10000);
    const { viewport, world } = OpenSeadragon.getViewer("zoom-view");
    viewport.zoomTo(world.getItemAt(0).imageToViewportZoom(1), undefined, true);
}"""
PAN = """(seconds) => new Promise((done) => {
    const { viewport } = OpenSeadragon.getViewer("zoom-view");
    const [speed, from] = [600, performance.now()];  // px/s, as a person follows a row of parts
    const times = [];
    let by = 1;
    const step = (now) => {
        if (times.length) {
            const px = new OpenSeadragon.Point(speed * (now - times.at(-1)) / 1000, 0);
            const moved = viewport.deltaPointsFromPixels(px);
            const { x, width } = viewport.getBounds(true);
            if (x + width > 0.95 || x < 0.05) by = x < 0.05 ? 1 : -1;
            viewport.panBy(moved.times(by), true);
        }
        times.push(now);
        if (now - from < seconds * 1000) requestAnimationFrame(step);
        else done(times);
    };
    requestAnimationFrame(step);
})"""
"""Move the board in the browser's own beat; the times of its frames."""
TILES = """() => performance.getEntriesByType("resource").filter(({ name }) => name.includes("_files/"))
    .map(({ requestStart, responseEnd }) => responseEnd - requestStart)"""


@contextmanager
def station(scenario: str) -> Iterator[tuple[str, str]]:
    """Run a station until it has filmed one board whose frames stay; yield its address and the run."""
    with temporary_folder("zoom-cost") as folder:
        config, twin = write_station_files(scenario_path(scenario), folder, boards=1)
        with Service(config) as service:
            client = Client(service.address)
            wait_until_idle(client, print)
            client.post("/station/arm", board_type=twin.board_type.name)
            run = None
            while run is None:
                run = poll(client, None)
            client.post("/station/disarm")
            yield service.address, run["id"]


def workers_of(url: str) -> CpuMeter:
    """Return a meter of the CPU time of a station's workers, which render the tiles."""
    processes = Client(url).get("/station")["processes"]
    return CpuMeter({p["name"]: p["pid"] for p in processes if p["name"].startswith("worker")})


def wait_for_rest(url: str) -> float:
    """Wait until the workers have done what follows a board, such as heights; return how long, s."""
    client, began_s = Client(url), time.monotonic()
    busy_s = began_s
    # Every event wakes the loop, heartbeats too, so no timer is needed.
    for _ in client.messages():
        workers = [p for p in client.get("/station")["processes"] if p["name"].startswith("worker")]
        now_s = time.monotonic()
        if any(p["doing"] != "idle" for p in workers):
            busy_s = now_s
        if now_s - busy_s > IDLE_S or now_s - began_s > LONGEST_REST_S:
            break
    return time.monotonic() - began_s


def first_pictures_ms(browser: Browser, address: str, repetitions: int) -> list[float]:
    """Return the times from the navigation to the complete picture, with an empty cache each time, ms."""
    times = []
    for _ in range(repetitions):
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address, wait_until="commit")
        found: Any = page.wait_for_function(COMPLETE, polling="raf", timeout=120_000).json_value()
        times.append(float(found))
        page.close()
    return times


def pan(page: Page, address: str, seconds: float) -> tuple[list[float], list[float]]:
    """Move the board at 1:1; return the times between frames of the browser and the times of tiles, ms."""
    page.goto(address)
    page.wait_for_function(COMPLETE, polling="raf", timeout=120_000)
    page.evaluate(SHOWN_1_TO_1)
    page.wait_for_function(COMPLETE, polling="raf", timeout=120_000)
    page.evaluate("performance.clearResourceTimings()")
    times: list[float] = page.evaluate(PAN, seconds)
    page.wait_for_function(COMPLETE, polling="raf", timeout=120_000)
    return [b - a for a, b in pairwise(times)], page.evaluate(TILES)


def described(values: Sequence[float]) -> str:
    """Return number, median and 95th percentile of times; a small board needs no further tiles."""
    if not values:
        return "none"
    last = sorted(values)[int(0.95 * len(values))]
    return f"{len(values)}, median {statistics.median(values):.1f} ms, 95 % {last:.1f} ms"


def measure(url: str, run: str, repetitions: int, seconds: float) -> None:
    """Measure the page of a run, and print the figures with the load of the machine."""
    address = f"{url}/#/board/{run}"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=ARGUMENTS)
        (first,) = first_pictures_ms(browser, address, 1)
        (busy,) = first_pictures_ms(browser, address, 1)
        waited_s = wait_for_rest(url)
        pictures = workers_of(url)
        later = first_pictures_ms(browser, address, repetitions)
        rendered_s = sum(pictures.read().values()) / repetitions
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        frames, tiles = pan(page, address, seconds)
        browser.close()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print(f"first complete picture: {first:.0f} ms, with the plan if there was none; the next one {busy:.0f} ms")
    print(f"when the workers were idle, after {waited_s:.0f} s: {described(later)}")
    print(f"for each of these pictures the workers took {1000 * rendered_s:.0f} ms of CPU time")
    print(f"pan at 1:1: {1000 * len(frames) / sum(frames):.0f} frames/s; between frames {described(frames)}")
    print(f"tiles meanwhile: {described(tiles)}")


def main() -> None:
    """Measure a station of the paper's board, or one that runs already."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="paper")
    parser.add_argument("--station", help="address of a running `vaoi demo`, which has filmed a board; for repetitions")
    parser.add_argument("--repetitions", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    if options.station:
        run = Client(options.station).get("/runs?limit=1")["runs"][0]["id"]
        measure(options.station, run, options.repetitions, options.seconds)
    else:
        with station(options.scenario) as (url, run):
            measure(url, run, options.repetitions, options.seconds)


if __name__ == "__main__":
    main()
