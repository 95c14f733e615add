"""The earlier versions of board types, from before they were replaced or deleted: list them and restore them."""

from __future__ import annotations

from collections.abc import Callable

from vaoi_station.model import BoardLimits, BoardType, Strict
from vaoi_station.model.board_type import BoardTypeState
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.store import BoardTypeDirectory


class BoardTypeVersion(Strict):
    """A version of a board type that was replaced or deleted."""

    id: str
    stored: str
    """Time at which the version was written."""
    ended: str
    """Time at which the version was replaced or deleted."""
    size_bytes: int


class BoardTypeHistory:
    """Lists and restores earlier versions of board types. Methods may be called from any thread except the
    coordinator's."""

    def __init__(
        self, directory: BoardTypeDirectory, put: Callable[[BoardType, str], bool], returned: Callable[[str], object]
    ) -> None:
        """Serve the versions of a directory's board types.

        `put` stores a board type, with its origin for the event; `returned` is called for a deleted one that is back.
        """
        self._directory, self._put, self._returned = directory, put, returned

    def deleted(self) -> tuple[str, ...]:
        """Return the names of deleted board types that can be restored, sorted."""
        return self._directory.deleted()

    def list(self, name: str) -> tuple[BoardTypeVersion, ...]:
        """Return the versions of a board type, newest first; `NotFoundError` if the name never existed."""
        return tuple(
            BoardTypeVersion(id=r.id, stored=utc(r.stored), ended=utc(r.ended), size_bytes=r.size_bytes)
            for r in self._directory.revisions_of(name)
        )

    def get(self, name: str, revision: str) -> BoardType:
        """Return one version of a board type; `NotFoundError` if there is none."""
        return self._directory.revision(name, revision)

    def set_state(self, name: str, state: BoardTypeState, revision: str | None = None) -> BoardType:
        """Store a board type in another state, with another revision if one is given, and return it."""
        present = self._directory.get(name)
        changes: dict[str, str] = {"state": state} | ({} if revision is None else {"revision": revision})
        board_type = present.model_copy(update=changes)
        self._put(board_type, f": it is now {state}")
        return board_type

    def set_limits(self, board_type: BoardType, limits: BoardLimits) -> BoardType:
        """Store a board type with other limits of its parts, and return it."""
        changed = board_type.model_copy(update={"limits": None if limits == BoardLimits() else limits})
        self._put(changed, " with other limits of its parts")
        return changed

    def restore(self, name: str, revision: str) -> BoardType:
        """Put an earlier version in force again, as if it were stored now, and return it.

        The present one is kept as a version.
        """
        board_type = self._directory.revision(name, revision)
        if self._put(board_type, f" by its version {revision}"):
            self._returned(name)
        return board_type
