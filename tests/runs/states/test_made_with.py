"""What a run was made with is one frozen document; runs of earlier versions have none."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.runs.states.made_with import MadeWith


def test_only_the_digests_and_the_method_are_required() -> None:
    made = MadeWith.model_validate({"configuration": "", "board_type": "c0ffee", "method": "auto"})
    assert (made.reference, made.clock_synchronised, made.utc_offset_s) == (None, None, 0)
    assert MadeWith.model_validate_json(made.model_dump_json()) == made
    with pytest.raises(ValidationError):
        MadeWith.model_validate({**made.model_dump(), "method": "guess"})
