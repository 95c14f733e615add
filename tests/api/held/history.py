"""The versions of board types of a held station."""

from __future__ import annotations

from vaoi_station.errors import NotFoundError
from vaoi_station.model import BoardLimits, BoardType
from vaoi_station.model.board_type import BoardTypeState
from vaoi_station.runs.archive.board_type_history import BoardTypeVersion

TIME = "2026-01-01T12:00:00.000Z"


class HeldTypes(dict[str, BoardType]):
    """Board types by name, which notes what is replaced or deleted."""

    def __init__(self, known: dict[str, BoardType]) -> None:
        super().__init__(known)
        self.before: dict[str, dict[str, BoardType]] = {}

    def __setitem__(self, name: str, board_type: BoardType) -> None:
        self._note(name)
        super().__setitem__(name, board_type)

    def __delitem__(self, name: str) -> None:
        self._note(name)
        super().__delitem__(name)

    def _note(self, name: str) -> None:
        if name in self:
            versions = self.before.setdefault(name, {})
            versions[f"20260101T12000000{len(versions)}Z-00000000"] = self[name]


class HeldHistory:
    """Lists and restores what a held station has noted."""

    def __init__(self, types: HeldTypes) -> None:
        self._types = types

    def deleted(self) -> tuple[str, ...]:
        return tuple(sorted(set(self._types.before) - set(self._types)))

    def list(self, name: str) -> tuple[BoardTypeVersion, ...]:
        if name not in self._types and name not in self._types.before:
            raise NotFoundError(f"There is no board type {name!r}.", code="unknown-board-type")
        found = self._types.before.get(name, {})
        return tuple(BoardTypeVersion(id=r, stored=TIME, ended=TIME, size_bytes=1) for r in reversed(found))

    def get(self, name: str, revision: str) -> BoardType:
        try:
            versions = self._types.before[name]
            return versions[max(versions) if revision == "latest" else revision]
        except KeyError:
            raise NotFoundError(f"There is no version {revision!r}.", code="unknown-revision") from None

    def set_state(self, name: str, state: BoardTypeState, revision: str | None = None) -> BoardType:
        if name not in self._types:
            raise NotFoundError(f"There is no board type {name!r}.", code="unknown-board-type")
        changes = {"state": state} | ({} if revision is None else {"revision": revision})
        self._types[name] = self._types[name].model_copy(update=changes)
        return self._types[name]

    def set_limits(self, board_type: BoardType, limits: BoardLimits) -> BoardType:
        self._types[board_type.name] = board_type.model_copy(update={"limits": limits})
        return self._types[board_type.name]

    def restore(self, name: str, revision: str) -> BoardType:
        self._types[name] = self.get(name, revision)
        return self._types[name]
