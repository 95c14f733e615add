"""Wait for boards and read one component of each: python tester.py BOARD_TYPE COMPONENT [BOARDS]."""

import json
import os
import sys
import urllib.error
import urllib.parse
import urllib.request

STATION = os.environ.get("VAOI_STATION", "http://127.0.0.1:8350")
KEY = os.environ.get("VAOI_KEY")  # needed from other machines than the station's
HEADERS = {"Authorization": f"Bearer {KEY}"} if KEY else {}


def call(method, path, **query):
    """Return body and headers of the reply; raise a refusal with detail and action."""
    address = f"{STATION}/api/v1{path}"
    if query:
        address += "?" + urllib.parse.urlencode(query)
    try:
        request = urllib.request.Request(address, method=method, headers=HEADERS)
        with urllib.request.urlopen(request, timeout=90) as reply:
            return reply.read(), reply.headers
    except urllib.error.HTTPError as error:
        problem = json.load(error)
        raise RuntimeError(f"{problem['code']}: {problem['detail']} {problem['action']}") from None


def get(path, **query):
    """Return the JSON of a reply; None if it has no body."""
    body, _ = call("GET", path, **query)
    return json.loads(body) if body else None


def latest():
    """Return the id of the newest run; None if no board was filmed yet."""
    try:
        return get("/runs/latest")["id"]
    except RuntimeError:
        return None


def read_component(run, component):
    """Read every picture of a component."""
    views = get(f"/runs/{run['id']}/components/{component}")["views"]
    for view in views:
        body, headers = call("GET", f"/runs/{run['id']}/components/{component}/images/{view['k']}", format="raw")
        width, height = int(headers["X-Image-Width"]), int(headers["X-Image-Height"])
        assert len(body) == int(headers["X-Image-Stride"]) * height
        print(f"  camera {view['camera']} row {view['row']}: {width} x {height}, mean {sum(body) / len(body):.1f}")


def main(board_type, component, boards=1):
    """Arm the station, and read a component of each board that passes."""
    after = latest()
    call("POST", "/station/arm", board_type=board_type, job_id="guide")
    while boards > 0:
        run = get("/runs/next", timeout=30, **({"after": after} if after else {}))
        if run is None:
            continue  # none in 30 s: repeat
        after, boards = run["id"], boards - 1
        print(f"run {run['id']}: {run['verdict']}")
        if run["verdict"] != "failed":
            call("PUT", f"/runs/{run['id']}/hold", holder="guide")  # no later board gets its memory meanwhile
            read_component(run, component)
        call("POST", f"/runs/{run['id']}/release", holder="guide")
    call("POST", "/station/disarm")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
