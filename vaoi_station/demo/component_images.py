"""Fetch the component images of a run by REST: files in folders, and tiles for a contact sheet."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vaoi_station.demo.client import Client
from vaoi_station.files.documents import write_json
from vaoi_station.rendering.contact_sheet import Tile

NOT_SEEN = "not seen"
PARALLEL_REQUESTS = 4
"""Number of components requested at the same time, so that all workers of the station render."""


@dataclass(frozen=True)
class ComponentImages:
    """The outcome of the download: the number of components and images, and tiles for the contact sheet."""

    components: int
    pictures: int
    tiles: tuple[Tile, ...]
    """The best image of every component, in the order of the components in the board type."""


def fetch_component_images(client: Client, run: str, folder: Path) -> ComponentImages:
    """Write every image of every component to `folder`/REF/NN_cCC_rRRR.png, and its matrices to REF/views.json."""
    components = _components(client, run)
    pool = ThreadPoolExecutor(PARALLEL_REQUESTS, thread_name_prefix="pictures")
    try:
        fetched = list(pool.map(lambda component: _fetch(client, component, folder), components))
    finally:
        # After an error or Ctrl-C the remaining components are not requested.
        pool.shutdown(cancel_futures=True)
    return ComponentImages(len(components), sum(count for count, _ in fetched), tuple(tile for _, tile in fetched))


def list_unseen_components(client: Client, run: str) -> ComponentImages:
    """List all components as tiles without images. Used for a run whose result contains no component positions."""
    components = _components(client, run)
    return ComponentImages(len(components), 0, tuple(Tile(None, c["address"], NOT_SEEN) for c in components))


def _components(client: Client, run: str) -> list[dict[str, Any]]:
    return list(client.get(f"/runs/{run}/components")["components"])


def _fetch(client: Client, component: dict[str, Any], folder: Path) -> tuple[int, Tile]:
    """Download all images of one component. Return their number, and a tile that shows the best image."""
    address = component["address"]
    views = client.get(component["url"])["views"]
    # On a panel the address is panel/ref. In a file name the slash would create a folder.
    place = folder / address.replace("/", "_")
    place.mkdir(parents=True, exist_ok=True)
    tile = Tile(None, address, NOT_SEEN)
    for view in views:
        content, pixels = client.picture(view["url"])
        (place / f"{view['k']:02d}_c{view['camera']:02d}_r{view['row']:03d}.png").write_bytes(content)
        # Views are sorted by quality: number 0 is the best.
        if view["k"] == 0:
            tile = Tile(pixels, address, f"c{view['camera']} r{view['row']}")
    write_json(place / "views.json", views)
    return len(views), tile
