"""A running station, used over REST (docs/rest.md): its runs, and component images as numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from vaoi_station.demo.client import Client
from vaoi_station.errors import InputError
from vaoi_station.files.documents import parse
from vaoi_station.library.component_images import ComponentImage, ComponentImages
from vaoi_station.library.stitched_run import component_height
from vaoi_station.model import Status, Stitch


@dataclass(frozen=True, eq=False)
class StationRun:
    """One run of a station. Its images can be fetched while the station keeps the frames of the run."""

    id: str
    summary: dict[str, Any]
    """The reply of the station to `GET runs/{id}`."""
    _client: Client = field(repr=False)

    @cached_property
    def result(self) -> Stitch:
        """Matrices, uncertainty and verdict of the run, fetched at the first access."""
        path = f"/runs/{quote(self.id)}/matrices"
        return parse(Stitch, self._client.get(path), path)

    @property
    def status(self) -> Status:
        """The verdict of the run: ok, degraded or failed."""
        return self.result.status

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons for a verdict other than ok, in sentences."""
        return self.result.reasons

    @cached_property
    def refs(self) -> tuple[str, ...]:
        """Addresses of all components of the board type."""
        listing = self._client.get(f"/runs/{quote(self.id)}/components")
        return tuple(entry["address"] for entry in listing["components"])

    def component(self, ref: str, *, px_per_mm: float | None = None, min_coverage: float = 0.5) -> ComponentImages:
        """Return the images of a component from every frame that shows it. Pixels are fetched when they are accessed.

        Raises:
            NotFoundError: the board type has no such component.
            GoneError: at access to pixels, if the station no longer keeps the frames of the run.
        """
        # On a panel, `ref` is `panel/ref`; `quote` keeps the slash, which the path of the component contains as well.
        path = f"/runs/{quote(self.id)}/components/{quote(ref)}"
        views = self._client.get(path, px_per_mm=px_per_mm, min_coverage=min_coverage)["views"]
        height, sigma = component_height(self.result, ref)
        return ComponentImages(ref, tuple(self._image(view) for view in views), height, sigma, self.status)

    def release(self) -> None:
        """Give up the frames of the run, so that the next board can use their memory; the result stays."""
        self._client.post(f"/runs/{quote(self.id)}/release")

    def _image(self, view: dict[str, Any]) -> ComponentImage:
        def load() -> NDArray[Any]:
            return self._client.picture(view["url"])[1]

        covariance = view.get("covariance_px2")
        return ComponentImage(
            camera=view["camera"],
            row=view["row"],
            coverage=view["coverage"],
            px_per_mm=view["px_per_mm"],
            crop_from_cad=np.array(view["crop_from_cad"]),
            image_from_crop=np.array(view["image_from_crop"]),
            distorted=view["distorted"],
            covariance_px2=None if covariance is None else np.array(covariance),
            _load=load,
        )


class Station:
    """A connection to a running station. Every refusal is raised as the `VaoiError` that the station reports."""

    def __init__(self, address: str) -> None:
        """Set the address of the station, `http://HOST:PORT`. No request is sent yet."""
        if not address.startswith(("http://", "https://")):
            raise InputError(f"address is {address!r}, but must start with http:// or https://.")
        self._client = Client(address.rstrip("/"))

    def snapshot(self) -> dict[str, Any]:
        """Return the present state of the station as `GET station` gives it."""
        return dict(self._client.get("/station"))

    def runs(self, limit: int = 50) -> list[dict[str, Any]]:
        """Return summaries of the newest runs, newest first."""
        return list(self._client.get("/runs", limit=limit)["runs"])

    def run(self, run_id: str = "latest") -> StationRun:
        """Return a run by its id, by default the one that finished last."""
        summary = self._client.get(f"/runs/{quote(run_id)}")
        return StationRun(summary["id"], summary, self._client)

    def wait_for_run(self, after: str | None = None, timeout_s: float = 30.0) -> StationRun | None:
        """Wait for the next finished run; return None if no run finishes in time.

        Args:
            after: id of the last run that the caller knows, so that no run is missed. By default the call returns the
                next run to finish.
            timeout_s: at most 60.
        """
        summary = self._client.get("/runs/next", after=after, timeout=timeout_s)
        return None if summary is None else StationRun(summary["id"], summary, self._client)


def connect(address: str = "http://127.0.0.1:8350") -> Station:
    """Connect to a running station.

    Raises:
        DeviceError: no station replies at the address.
    """
    station = Station(address)
    # One request now, so that a wrong address is an error here and not at the first use.
    station.snapshot()
    return station
