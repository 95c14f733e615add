"""A real nginx in front of a station, with settings from the documents."""

from __future__ import annotations

import re
import socket
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2

from tests.needs import need, program
from tests.peers.certificates import Certificate

DOCS = Path(__file__).parents[3] / "docs"
FRAME = """
daemon off; master_process off; pid {folder}/pid; error_log stderr warn;
events {{ worker_connections 256; }}
http {{
  access_log off;
  client_body_temp_path {folder}; proxy_temp_path {folder}; fastcgi_temp_path {folder};
  uwsgi_temp_path {folder}; scgi_temp_path {folder};
  server {{
    listen 127.0.0.1:{port}{tls};
    {location}
  }}
}}
"""


def documented(document: str) -> list[str]:
    """Return the blocks of settings that a document has."""
    text = (DOCS / document).read_text(encoding="utf-8")
    return re.findall(r"^```(?:nginx)?\n(location .*?^\})\n```$", text, re.DOTALL | re.MULTILINE)


@contextmanager
def before(station_port: int, location: str, folder: Path, made: Certificate | None = None) -> Iterator[httpx2.Client]:
    """Run nginx with the settings of a location, and yield a client of it; with TLS if there is a certificate."""
    need("nginx")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    tls = "" if made is None else f" ssl; ssl_certificate {made.certificate}; ssl_certificate_key {made.private_key}"
    location = location.replace("127.0.0.1:8350", f"127.0.0.1:{station_port}")
    (folder / "nginx.conf").write_text(FRAME.format(folder=folder, port=port, tls=tls, location=location))
    command = [str(program("nginx")), "-e", "stderr", "-p", str(folder), "-c", str(folder / "nginx.conf")]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    trusted = True if made is None else ssl.create_default_context(cafile=str(made.certificate))
    address = f"http://127.0.0.1:{port}" if made is None else f"https://localhost:{port}"
    with httpx2.Client(base_url=address, verify=trusted, timeout=20) as client:
        try:
            while True:
                assert server.poll() is None, server.stderr and server.stderr.read()
                try:
                    client.get("/")
                    break
                except httpx2.TransportError:
                    continue
            yield client
        finally:
            server.terminate()
            server.communicate()
