"""The section with every frame: thumbnail, state, and number of links with weight."""

from __future__ import annotations

from collections import Counter

from vaoi_station.reporting.drawing.html_page import Section, folded, table
from vaoi_station.reporting.drawing.svg import tag, text
from vaoi_station.reporting.stitched_run import StitchedRun
from vaoi_station.stitching.matching.evidence import FrameKey

_WIDTH_PX = 120


def picture_store(stitched: StitchedRun) -> str:
    """Return all thumbnails as SVG definitions. Sections refer to them, so that the file holds each only once."""
    # There is one definition per frame, because tile graph and frame table show the same picture, and pictures are most
    # of the file.
    images = "".join(
        tag("image", id=picture_id(key), width=t.width, height=t.height, href=t.uri, preserveAspectRatio="none")
        for key, t in stitched.thumbnails.items()
    )
    return tag("svg", tag("defs", images), width=0, height=0, class_="store", aria_hidden="true")


def picture_id(key: FrameKey) -> str:
    """Return the id of a frame's thumbnail, by which the page refers to it."""
    return f"f{key[0]}-{key[1]}"


def frame_table(stitched: StitchedRun) -> Section:
    """Return the section that shows the state of every frame, in a table of rows and cameras."""
    links = links_of(stitched)
    head = tag("tr", tag("th"), *(tag("th", text(f"camera {i}")) for i in range(stitched.cameras)))
    body = "".join(
        tag("tr", tag("th", text(f"row {j}")), *(_cell(stitched, (i, j), links) for i in range(stitched.cameras)))
        for j in range(stitched.head.rows)
    )
    film = tag("div", tag("table", tag("thead", head), tag("tbody", body), class_="film"), class_="scroll tall")
    bad = [[str(c), str(r), verdict, cause] for (c, r), (verdict, cause) in sorted(stitched.causes.items())]
    listed = (
        folded(f"frames that are not ok: {len(bad)}", table(["camera", "row", "state", "cause"], bad)) if bad else ""
    )
    lead = (
        "The number counts links with weight in the adjustment. A dotted line marks a frame without such links; the "
        "other frames of its row place it, or the nominal motion. A dashed line marks a frame that was not delivered."
    )
    return Section("frames", "Frames", lead, film + listed)


def links_of(stitched: StitchedRun) -> Counter[FrameKey]:
    """Count for each frame the links that have a weight above 0 in the adjustment."""
    count: Counter[FrameKey] = Counter()
    for pair in stitched.pairs:
        count[pair.a] += pair.used
        count[pair.b] += pair.used
    return count


def _cell(stitched: StitchedRun, key: FrameKey, links: Counter[FrameKey]) -> str:
    if key in stitched.causes:
        verdict, cause = stitched.causes[key]
        return tag("td", text(verdict), class_="bad", title=cause)
    t = stitched.thumbnails[key]
    width = min(_WIDTH_PX, t.width)
    use = tag("use", href=f"#{picture_id(key)}")
    height = width * t.height / t.width
    shown = tag("svg", use, viewBox=f"0 0 {t.width} {t.height}", width=width, height=height)
    count = text(f"{links[key]}") if links[key] else text("no links")
    return tag("td", shown, count, class_=None if links[key] else "alone", title=f"camera {key[0]}, row {key[1]}")
