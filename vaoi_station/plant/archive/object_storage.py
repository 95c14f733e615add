"""Archives on object stores and other systems, through fsspec."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from typing import Any

from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.plant.archive.storage import Entry


class FsspecStorage:
    """A folder of a system that fsspec knows, for example a bucket of an S3-compatible server."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._system, self._root = _open(url)

    def read(self, key: str) -> bytes:
        """Return an object; NotFoundError if it is absent, DeviceError if the store does not answer."""
        with self._explained(key, "read", "archive-absent"):
            return bytes(self._system.cat_file(self._path(key)))

    def write(self, key: str, content: bytes) -> None:
        """Write an object by one request; DeviceError if the store refuses it."""
        with self._explained(key, "written", "file-not-written"):
            self._system.pipe_file(self._path(key), content)

    def entry(self, key: str) -> Entry | None:
        """Return size and time of an object; None if it is absent."""
        with suppress(NotFoundError), self._explained(key, "read", "archive-absent"):
            return self._entry(self._system.info(self._path(key)))
        return None

    def names(self, prefix: str) -> list[str]:
        """Return the sorted names directly below a prefix; none if it is absent."""
        found = []
        with suppress(NotFoundError), self._explained(prefix, "read", "archive-absent"):
            found = self._system.ls(self._path(prefix), detail=False)
        return sorted(str(path).rstrip("/").rpartition("/")[2] for path in found)

    def entries(self, prefix: str) -> Iterator[Entry]:
        """Yield all objects below a prefix, sorted by key."""
        found = {}
        with suppress(NotFoundError), self._explained(prefix, "read", "archive-absent"):
            found = self._system.find(self._path(prefix), detail=True)
        for path in sorted(found):
            yield self._entry(found[path])

    def leftovers(self) -> Iterator[Entry]:
        """Yield nothing: an object is written by one request, and is there as a whole or not at all."""
        return iter(())

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with suppress(NotFoundError), self._explained(key, "deleted", "file-not-written"):
            self._system.rm_file(self._path(key))

    def _path(self, key: str) -> str:
        return f"{self._root}/{key}".rstrip("/")

    def _entry(self, info: dict[str, Any]) -> Entry:
        key = str(info["name"]).strip("/").removeprefix(f"{self._root.strip('/')}/")
        changed = info.get("LastModified") or info.get("mtime") or info.get("created")
        if isinstance(changed, int | float):
            changed = datetime.fromtimestamp(changed, UTC)
        if not isinstance(changed, datetime):
            # A system without times: the object counts as just written, so that nothing is deleted too early.
            changed = datetime.now(UTC)
        return Entry(key, int(info["size"]), changed if changed.tzinfo else changed.replace(tzinfo=UTC))

    @contextmanager
    def _explained(self, key: str, done: str, code: str) -> Iterator[None]:
        """Turn every error of the system into one that names the object."""
        try:
            yield
        except FileNotFoundError as error:
            raise NotFoundError(f"{self.url}/{key}: there is no such object.") from error
        except Exception as error:  # Every system raises errors of its library.
            raise DeviceError(
                f"{self.url}/{key}: cannot be {done} ({type(error).__name__}: {str(error)[:200]}).",
                action="Check the address, the credentials, the space and the connection of the store.",
                code=code,
            ) from error


def _open(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError as error:
        raise InputError(
            f"{url}: archives on other systems than directories need fsspec, which is not installed.",
            action="Install vaoi-station[plant], and for s3:// vaoi-station[plant-s3].",
        ) from error
    try:
        # Other machines write too: what was listed before may be old.
        system, root = fsspec.core.url_to_fs(url, use_listings_cache=False, skip_instance_cache=True)
    except ImportError as error:
        raise InputError(
            f"{url}: fsspec needs a further package for this address ({error}).",
            action="For s3:// install vaoi-station[plant-s3].",
        ) from error
    except ValueError as error:
        raise InputError(f"{url}: is no address of an archive ({error}).") from error
    return system, str(root).rstrip("/")
