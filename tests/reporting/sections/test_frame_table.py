"""The table of frames, with states and links."""

from __future__ import annotations

from dataclasses import replace

from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.frame_table import frame_table, links_of, picture_id, picture_store


def test_every_thumbnail_is_defined_once_and_used_by_its_frame(stitched: StitchedRun) -> None:
    store, html = picture_store(stitched), frame_table(stitched).html()
    for key in stitched.opened.present:
        assert store.count(f'id="{picture_id(key)}"') == 1
        assert html.count(f'href="#{picture_id(key)}"') == 1


def test_both_frames_of_a_link_count_it(stitched: StitchedRun) -> None:
    links = links_of(stitched)
    assert sum(links.values()) == 2 * sum(pair.used for pair in stitched.pairs)
    assert set(links) <= set(stitched.opened.present)


def test_frame_without_links_is_marked(stitched: StitchedRun) -> None:
    assert "no links" not in frame_table(stitched).html()
    lonely = replace(stitched, findings=replace(stitched.findings, links=()))
    assert frame_table(lonely).html().count("no links") == len(stitched.opened.present)


def test_frames_that_are_not_ok_are_listed_with_their_cause(stitched: StitchedRun) -> None:
    head = stitched.head.model_copy(update={"missing": ((0, 1),)})
    recording = replace(stitched.opened.recording, head=head)
    html = frame_table(replace(stitched, opened=replace(stitched.opened, recording=recording))).html()
    assert "frames that are not ok: 1" in html
    assert html.count("the frame was not delivered") == 2
