"""Documents about storage are closed: a caller can rely on their keys."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.runs.states.storage_schemas import ArchiveStatus


def test_the_state_of_the_archive_has_no_other_keys() -> None:
    status = ArchiveStatus(url="/mnt/archive", waiting=2, adding=None, added=5, dropped=1, refused=0, problem="")
    document = status.model_dump()
    assert ArchiveStatus.model_validate(document) == status
    with pytest.raises(ValidationError):
        ArchiveStatus.model_validate(document | {"full": True})
