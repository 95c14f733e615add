"""Pages and static files; see web/ for the page in a browser."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from vaoi_station.api import pages
from vaoi_station.api.access import AccessControl
from vaoi_station.api.app import create_app
from vaoi_station.api.audit import AuditLog
from vaoi_station.api.problems import KINDS
from vaoi_station.doctor.runner import MACHINE_CHECKS, STATION_CHECKS
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.model import ReasonCode
from vaoi_station.model.codes import code_sections

NO_HELP = 'header a[href="help"] { display: none; }'


@pytest.mark.parametrize(
    ("path", "media_type"),
    [
        ("/", "text/html"),
        ("/docs", "text/html"),
        ("/favicon.ico", "image/svg+xml"),
        ("/web/app.js", "text/javascript"),
        ("/web/style.css", "text/css"),
    ],
)
def test_pages_are_revalidated(untouched_client: Any, path: str, media_type: str) -> None:
    reply = untouched_client.get(path)
    assert reply.status_code == 200
    assert reply.headers["content-type"].startswith(media_type)
    assert reply.headers["cache-control"] == "no-cache"
    assert untouched_client.get(path, headers={"if-none-match": reply.headers["etag"]}).status_code in (200, 304)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_problem_kind_is_explained(untouched_client: Any, kind: str) -> None:
    status, title, action = KINDS[kind]
    assert untouched_client.get(f"/problems/{kind}").text == f"{title} (HTTP {status}, {kind}).\n{action}\n"


def test_every_code_is_explained_at_its_address(untouched_client: Any) -> None:
    for section in code_sections():
        for entry in section.codes:
            for code in {*entry.codes} - {*KINDS}:
                text = untouched_client.get(f"/problems/{code}").text
                assert text.startswith(f"{code}\n\n")
                assert "What to do: " in text
                assert "](" not in text, "a link of the documents"
    assert untouched_client.get("/problems/no-such-code").status_code == 404


def codes_of(*titles: str) -> set[str]:
    """Return the codes that some sections of the list have."""
    sections = [section for section in code_sections() if section.title in titles]
    assert len(sections) == len(titles)
    return {code for section in sections for entry in section.codes for code in entry.codes}


def codes_of_boards() -> set[str]:
    """Return the codes of reasons of a run and of its identity, without those that have an order by their family."""
    codes = codes_of("Reasons of a run", "Reasons of an identity")
    return {code for code in codes if not code.startswith(("stitch-", "trigger-"))}


def dictionary(client: Any, language: str, name: str) -> str:
    """Return the group of texts of a name, as it stands in the file of a language."""
    texts = client.get(f"/web/texts/{language}.js").text
    found = re.search(rf"^const {name} = {{\n.*?^}};", texts, re.MULTILINE | re.DOTALL)
    assert found, name
    return found[0]


def test_the_page_has_an_order_for_every_reason(untouched_client: Any) -> None:
    """An operator cannot act on a sentence about fiducials or overlaps alone."""
    groups = re.search(
        r"const BOARD_GROUPS = {\n(.*?)\n};", untouched_client.get("/web/parts/orders.js").text, re.DOTALL
    )
    assert groups
    named = re.findall(r'"([a-z-]+)"', groups[1])
    assert len(named) == len(set(named))
    assert {code.value for code in ReasonCode} | codes_of_boards() <= set(named)
    for language in ("en", "de"):
        texts = untouched_client.get(f"/web/texts/{language}.js").text
        orders = re.search(r"  boardOrders: {\n(.*?)\n  }},?".replace("}}", "}"), texts, re.DOTALL)
        assert orders
        assert set(re.findall(r"^    ([a-z]+): ", orders[1], re.MULTILINE)) == set(
            re.findall(r"^  ([a-z]+): \[", groups[1], re.MULTILINE)
        )


def test_german_pages_translate_only_known_refusals(untouched_client: Any) -> None:
    translated = dictionary(untouched_client, "de", "translated")
    found = re.search(r"^  refusals: {\n(.*?)^  },", translated, re.MULTILINE | re.DOTALL)
    assert found
    assert set(re.findall(r'^    "?([a-z-]+)"?: "', found[1], re.MULTILINE)) <= codes_of("Refusals of requests")


def test_german_pages_translate_every_finding_of_the_doctor(untouched_client: Any) -> None:
    sections = ("Reasons, warnings and events of the station", "Devices and files", "Findings of `vaoi doctor`")
    texts = [dictionary(untouched_client, "de", name) for name in ("warnings", "findings")]
    assert {code for text in texts for code in re.findall(r'^  "?([a-z0-9-]+)"?: \[', text, re.MULTILINE)} == codes_of(
        *sections
    )
    translated = dictionary(untouched_client, "de", "translated")
    checks = re.search(r"^  checks: {\n(.*?)^  },", translated, re.MULTILINE | re.DOTALL)
    assert checks
    named = {name for name, _ in (*MACHINE_CHECKS, *STATION_CHECKS)} | {"configuration", "others"}
    assert {a or b for a, b in re.findall(r'(?:"([^"]+)"|\b(\w+)): "', checks[1])} == named


@pytest.mark.parametrize(
    ("name", "section"),
    [
        ("remarks", "Remarks of an import"),
        ("notes", "Notes of a calibration"),
        ("program", "Faults of a light program"),
    ],
)
def test_german_pages_translate_every_note(untouched_client: Any, name: str, section: str) -> None:
    texts = dictionary(untouched_client, "de", name)
    assert set(re.findall(r'^  "([a-z-]+)": \(', texts, re.MULTILINE)) == codes_of(section)


def test_german_pages_translate_every_reason_of_a_board_with_two_sides(untouched_client: Any) -> None:
    texts = dictionary(untouched_client, "de", "boardSides")
    assert set(re.findall(r'^  "([a-z-]+)": "', texts, re.MULTILINE)) == codes_of("Reasons of a board")


def test_the_documents_are_served_without_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.html").write_text("<title>Documents</title>")
    monkeypatch.setattr(pages, "HELP", tmp_path)
    audit = AuditLog(tmp_path / "audit.jsonl")
    access = AccessControl(KeyFile(tmp_path / "keys"), audit, open_loopback=False)
    client = TestClient(create_app(HeldStation(), (), access), base_url="http://127.0.0.1")
    reply = client.get("/help")
    assert reply.url.path == "/help/docs/index.html"
    assert reply.text == "<title>Documents</title>"
    assert "script-src" not in reply.headers["content-security-policy"]  # default-src 'self' holds for scripts
    assert client.get("/api/v1/runs").status_code == 401
    assert NO_HELP not in client.get("/web/styles.css").text
    (tmp_path / "docs" / "index.html").unlink()
    assert "docs/build_site" in client.get("/help").text
    audit.close()


def test_a_station_without_documents_shows_no_entry_of_help(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "HELP", tmp_path)
    client = TestClient(create_app(HeldStation(), ["testserver"]))
    assert NO_HELP in client.get("/web/styles.css").text
    assert '<a href="help"' in client.get("/").text


def test_style_sheets_of_two_views_name_no_element_of_both_but_those_of_a_shared_part() -> None:
    """All sheets are served as one, so that equal ids would share their rules."""
    named: dict[str, list[str]] = {}
    for sheet in sorted((Path(pages.__file__).parent / "web").glob("*/*.css")):
        for element in set(re.findall(r"#(?![0-9a-f]{3,8}\b)([a-z][a-z-]+)", sheet.read_text(encoding="utf-8"))):
            named.setdefault(element, []).append(sheet.name)
    shared = {element: sheets for element, sheets in named.items() if len(sheets) > 1}
    # The order, the verdict and the decisions of a board are on its page and on the line's.
    assert shared.keys() == {"board-order", "decisions", "verdict-shape"}, shared
