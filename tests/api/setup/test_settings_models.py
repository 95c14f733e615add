from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.api.setup.settings_models import SettingChange, SettingsChange


def test_a_change_names_a_key_and_one_without_a_value_removes() -> None:
    assert SettingChange(key="cameras.0.width", value=320).value == 320
    assert SettingChange(key="archive").value is None
    for wrong in ("", "a..b", ".a", "a\nb", "a" * 301):
        with pytest.raises(ValidationError):
            SettingChange(key=wrong)


def test_changes_are_limited_in_number() -> None:
    change = SettingChange(key="name", value="a")
    for count in (0, 501):
        with pytest.raises(ValidationError):
            SettingsChange(changes=[change] * count)
