"""A real nginx in front of a station: with the site that the package ships, or with settings from the documents."""

from __future__ import annotations

import re
import socket
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx2

from tests.needs import need, program
from tests.peers.certificates import Certificate

ROOT = Path(__file__).parents[3]
SHIPPED = ROOT / "deploy" / "nginx.conf"
FRAME = """
daemon off; master_process off; pid {folder}/pid; error_log stderr warn;
worker_rlimit_nofile 16384;
events {{ worker_connections 4096; }}
http {{
  access_log off;
  client_body_temp_path {folder}; proxy_temp_path {folder}; fastcgi_temp_path {folder};
  uwsgi_temp_path {folder}; scgi_temp_path {folder};
  {site}
}}
"""


def documented(document: str) -> tuple[str, str]:
    """Return the two settings that a document has: the whole one, and it with the lines of the second one."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    whole, replaced = re.findall(r"^```nginx\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    other = whole
    for line in replaced.splitlines():
        start = re.match(r" *proxy_\S+ (?:X-\S+)?", line)
        assert start is not None
        other, count = re.subn(rf"^{start[0]}.*$", line, other, flags=re.MULTILINE)
        assert count == 1, line
    return whole, other


def free_port() -> int:
    """Return a port of loopback that no program uses."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    return port


def shipped_site(port: int, made: Certificate | None) -> str:
    """Return the site of the package at another port: with a certificate, or without TLS."""
    site = SHIPPED.read_text(encoding="utf-8").replace("    listen [::]:443 ssl;\n", "")
    if made is None:
        site = re.sub(r"^ +ssl_.*\n", "", site, flags=re.MULTILINE)
        return site.replace("listen 443 ssl;", f"listen 127.0.0.1:{port};")
    site = site.replace("/etc/vaoi-station/station.pem", f"{made.certificate}")
    site = site.replace("/etc/vaoi-station/station.key", f"{made.private_key}")
    return site.replace("listen 443 ssl;", f"listen 127.0.0.1:{port} ssl;")


@contextmanager
def running(site: str, station_port: int, folder: Path) -> Iterator[None]:
    """Run nginx with a site, in front of the station at a port, during a `with` block."""
    need("nginx")
    site = site.replace("127.0.0.1:8350", f"127.0.0.1:{station_port}")
    (folder / "nginx.conf").write_text(FRAME.format(folder=folder, site=site))
    command = [str(program("nginx")), "-e", "stderr", "-p", str(folder), "-c", str(folder / "nginx.conf")]
    listen = re.search(r"listen 127\.0\.0\.1:(\d+)", site)
    assert listen is not None
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        while True:
            assert server.poll() is None, server.stderr and server.stderr.read()
            with suppress(ConnectionRefusedError):
                socket.create_connection(("127.0.0.1", int(listen[1]))).close()
                break
        yield
    finally:
        server.terminate()
        server.communicate()


@contextmanager
def before(
    station_port: int, location: str | None, folder: Path, made: Certificate | None = None
) -> Iterator[httpx2.Client]:
    """Run nginx with a location, or without one the site of the package, and yield a client of it; perhaps with TLS."""
    port = free_port()
    tls = "" if made is None else f" ssl; ssl_certificate {made.certificate}; ssl_certificate_key {made.private_key}"
    site = f"server {{ listen 127.0.0.1:{port}{tls}; {location} }}" if location else shipped_site(port, made)
    trusted = True if made is None else ssl.create_default_context(cafile=str(made.certificate))
    address = f"http://127.0.0.1:{port}" if made is None else f"https://localhost:{port}"
    with (
        running(site, station_port, folder),
        httpx2.Client(base_url=address, verify=trusted, timeout=20) as client,
    ):
        yield client
