"""The board types of a running station: their documents and versions, what they are placed against, and the method."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from vaoi_station.config import MethodName
from vaoi_station.demo.client import Client
from vaoi_station.errors import NotFoundError
from vaoi_station.library.arguments import require_instance, require_text
from vaoi_station.library.replies import BoardTypeListReply, VersionListReply, checked
from vaoi_station.model import BoardType
from vaoi_station.model.board_type import BoardTypeState
from vaoi_station.runs.archive.board_type_history import BoardTypeVersion
from vaoi_station.runs.states.schemas import BoardTypeSummary
from vaoi_station.runs.states.stitching_schemas import ReferenceStatus, StitchingMethod


class StationBoardTypes:
    """The board types of a station. Changes apply from the next arming on.

    A `tag` names the version that the caller has read (`get_tagged`); if the board type was changed since, a change
    with this tag is refused with the code `changed`.
    """

    def __init__(self, client: Client) -> None:
        self._client = client

    def list(self) -> tuple[BoardTypeSummary, ...]:
        """Return a summary of each board type, sorted by name; `fault` says why a file cannot be used."""
        return self._listing().board_types

    def deleted(self) -> tuple[str, ...]:
        """Return the names of deleted board types, of which a version can be restored."""
        return self._listing().deleted

    def get(self, name: str) -> BoardType:
        """Return a board type."""
        path = _path("get", name)
        return checked(BoardType, self._client.get(path), self._client.url(path))

    def get_tagged(self, name: str) -> tuple[BoardType, str]:
        """Return a board type, and the tag of this version."""
        path = _path("get_tagged", name)
        document, tag = self._client.tagged(path)
        return checked(BoardType, document, self._client.url(path)), tag

    def put(self, board_type: BoardType, *, tag: str | None = None, new: bool = False) -> BoardType:
        """Store a board type, or replace it; the version before can be restored. Return what was stored.

        Args:
            board_type: the board type, under its name.
            tag: replace only the version with this tag.
            new: replace none: refuse if there is a board type of this name.
        """
        require_instance("put", "board_type", board_type, BoardType)
        path = _path("put", board_type.name)
        headers = conditions(tag, new=new)
        document = board_type.model_dump(mode="json", exclude_none=True)
        reply = self._client.put_document(path, document, headers)
        return checked(BoardType, reply, self._client.url(path))

    def delete(self, name: str, *, tag: str | None = None) -> None:
        """Delete a board type, of which a version is kept; refused while the line is armed with it."""
        self._client.delete(_path("delete", name), conditions(tag))

    def set_state(self, name: str, state: BoardTypeState, revision: str | None = None) -> BoardType:
        """Set the state `draft`, `approved` or `retired`, and the revision of the data if it is given."""
        path = _path("set_state", name, "/state")
        document = {"state": require_text("set_state", "state", state)}
        document |= {} if revision is None else {"revision": require_text("set_state", "revision", revision)}
        return checked(BoardType, self._client.put_document(path, document), self._client.url(path))

    def versions(self, name: str) -> tuple[BoardTypeVersion, ...]:
        """Return the versions that were replaced or deleted, newest first."""
        path = _path("versions", name, "/revisions")
        return checked(VersionListReply, self._client.get(path), self._client.url(path)).revisions

    def version(self, name: str, version: str) -> BoardType:
        """Return the document of a version; `latest` is the one before the present."""
        path = _path("version", name, f"/revisions/{quote(require_text('version', 'version', version), safe='')}")
        return checked(BoardType, self._client.get(path), self._client.url(path))

    def restore(self, name: str, version: str = "latest") -> BoardType:
        """Put a version in force again; the present one becomes a version itself."""
        escaped = quote(require_text("restore", "version", version), safe="")
        path = _path("restore", name, f"/revisions/{escaped}/restore")
        return checked(BoardType, self._client.post(path), self._client.url(path))

    def reference(self, name: str) -> ReferenceStatus | None:
        """Return the run against which boards of the type are placed; None if there is none."""
        path = _path("reference", name, "/reference")
        try:
            reply = self._client.get(path)
        except NotFoundError as error:
            if error.code != "no-reference":
                raise
            return None
        return checked(ReferenceStatus, reply, self._client.url(path))

    def teach(self, name: str, run: str, *, confirm_orientation: bool = False) -> ReferenceStatus:
        """Make a finished run the reference of its board type.

        Args:
            name: name of the board type.
            run: id of a run whose verdict is `ok`, and whose frames are in memory.
            confirm_orientation: a person has checked that the board did not lie turned by 180°.
        """
        path = _path("teach", name, "/reference")
        document: dict[str, Any] = {"run": require_text("teach", "run", run)}
        document |= {"confirm_orientation": True} if confirm_orientation else {}
        return checked(ReferenceStatus, self._client.put_document(path, document), self._client.url(path))

    def forget_reference(self, name: str) -> None:
        """Delete the reference of a board type."""
        self._client.delete(_path("forget_reference", name, "/reference"))

    def method(self, name: str) -> StitchingMethod:
        """Return the stitching method of a board type, and whether it was set for it."""
        path = _path("method", name, "/method")
        return checked(StitchingMethod, self._client.get(path), self._client.url(path))

    def set_method(self, name: str, method: MethodName) -> StitchingMethod:
        """Set the stitching method of a board type."""
        path = _path("set_method", name, "/method")
        document = {"method": require_text("set_method", "method", method)}
        return checked(StitchingMethod, self._client.put_document(path, document), self._client.url(path))

    def forget_method(self, name: str) -> StitchingMethod:
        """Delete the method that was set for a board type; return the station's, which applies then."""
        path = _path("forget_method", name, "/method")
        return checked(StitchingMethod, self._client.delete(path), self._client.url(path))

    def _listing(self) -> BoardTypeListReply:
        path = "/board-types"
        return checked(BoardTypeListReply, self._client.get(path), self._client.url(path))


def _path(function: str, name: object, rest: str = "") -> str:
    return f"/board-types/{quote(require_text(function, 'name', name), safe='')}{rest}"


def conditions(tag: str | None, *, new: bool = False) -> dict[str, str]:
    """Return the headers by which a change replaces only the version with a tag, or none."""
    match = {} if tag is None else {"If-Match": require_text("board types", "tag", tag)}
    return match | ({"If-None-Match": "*"} if new else {})
