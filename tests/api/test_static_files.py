"""Files of a page: from memory, without threads, and as they are on disk now."""

from __future__ import annotations

from pathlib import Path

import pytest
from starlette.applications import Starlette
from starlette.routing import Mount, Route
from starlette.testclient import TestClient

from vaoi_station.api.pages import StaticFiles


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    web = tmp_path / "web"
    (web / "parts").mkdir(parents=True)
    (web / "page.html").write_text("<p>ü</p>")
    (web / "parts" / "one.js").write_text("export {};")
    (web / "parts" / "two.js").write_text("export [];")
    (web / "data").write_bytes(b"\0")
    (tmp_path / "secret.js").write_text("1")
    return web


@pytest.fixture
def client(folder: Path) -> TestClient:
    files = StaticFiles(folder)
    joined = Route("/both", files.page("parts/one.js", "parts/two.js"))
    return TestClient(Starlette(routes=[Mount("/web", files), Route("/", files.page("page.html")), joined]))


@pytest.mark.parametrize(
    ("path", "media_type", "content"),
    [
        ("/", "text/html; charset=utf-8", "<p>ü</p>".encode()),
        ("/web/page.html", "text/html; charset=utf-8", "<p>ü</p>".encode()),
        ("/web/parts/one.js", "text/javascript; charset=utf-8", b"export {};"),
        ("/both", "text/javascript; charset=utf-8", b"export {};export [];"),
        ("/web/data", "application/octet-stream", b"\0"),
    ],
)
def test_a_file_has_its_type_and_is_revalidated(client: TestClient, path: str, media_type: str, content: bytes) -> None:
    reply = client.get(path)
    assert (reply.status_code, reply.content) == (200, content)
    assert (reply.headers["content-type"], reply.headers["cache-control"]) == (media_type, "no-cache")
    again = client.get(path, headers={"if-none-match": reply.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert (again.headers["etag"], again.headers["cache-control"]) == (reply.headers["etag"], "no-cache")


@pytest.mark.parametrize(
    "path",
    [
        "",
        "/",
        "/parts",
        "/parts/",
        "/missing.js",
        "/page.html/",
        "//page.html",
        "/%2e/page.html",
        "/parts/%2e%2e/page.html",
        "/%2e%2e/secret.js",
        "/parts/..%2f..%2fsecret.js",
        "/page.html%00",
        "/" + 300 * "a",
    ],
)
def test_only_files_of_the_folder_are_there(client: TestClient, path: str) -> None:
    assert client.get(f"/web{path}").status_code == 404
