"""How long the page takes to its first view, and how much it loads per board: `python -m tests.api.web.cost.page_cost`.

The station is the one of the tests, on loopback, without frames to stitch: the page is measured. Bytes are those
of the bodies, as they are sent.
"""

from __future__ import annotations

import argparse
import statistics
from collections import Counter
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import Browser, expect, sync_playwright

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.api.web.conftest import ARGUMENTS
from tests.needs import chromium

READY = "() => performance.now() > 0 && document.querySelector('#state-word')?.textContent ? performance.now() : 0"


def first_view_ms(browser: Browser, url: str) -> float:
    """Return the time from the navigation to the word of the state, in a browser with an empty cache, ms."""
    page = browser.new_page()
    page.goto(url, wait_until="commit")
    found: Any = page.wait_for_function(READY, polling="raf").json_value()
    page.close()
    return float(found)


def bytes_per_board(browser: Browser, served: Served, boards: int) -> dict[str, float]:
    """Return the mean number of bytes that the page loads for each board: tiles of the picture, and all else."""
    page = browser.new_page()
    served.station.arm("demo-board")
    page.goto(served.url)
    expect(page.locator("#state-word")).to_have_text("Ready")
    client, kinds, sizes = page.context.new_cdp_session(page), dict[str, str](), Counter[str]()

    def asked(event: Any) -> None:
        tile = "/mosaics/" in event["request"]["url"] and PurePosixPath(urlsplit(event["request"]["url"]).path).suffix
        kinds[event["requestId"]] = "picture" if tile in (".jpg", ".png") else "other"

    client.on("Network.requestWillBeSent", asked)

    def received(event: Any) -> None:
        # The length as sent is not known of a stream that goes on.
        length = event["encodedDataLength"] or event["dataLength"]
        sizes[kinds.get(event["requestId"], "events")] += length

    client.on("Network.dataReceived", received)
    client.send("Network.enable")
    for n in range(boards):
        served.station.film(board_id=f"SN-{n}")
        expect(page.locator("#board-name")).to_have_text(f"SN-{n}")
        expect(page.locator("#last-picture .board-picture")).to_be_visible()
    page.wait_for_timeout(500)
    page.close()
    return {kind: size / boards for kind, size in sizes.items()}


def main() -> None:
    """Print both figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=int, default=40)
    parser.add_argument("--repetitions", type=int, default=9)
    options = parser.parse_args()
    served = Served(HeldStation())
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=ARGUMENTS)
        times_ms = sorted(first_view_ms(browser, served.url) for _ in range(options.repetitions))
        loaded = bytes_per_board(browser, served, options.boards)
        browser.close()
    served.stop()
    print(f"first view: median {statistics.median(times_ms):.0f} ms, slowest {times_ms[-1]:.0f} ms of {len(times_ms)}")
    print("per board: " + ", ".join(f"{kind} {size / 1e3:.1f} kB" for kind, size in sorted(loaded.items())))


if __name__ == "__main__":
    main()
