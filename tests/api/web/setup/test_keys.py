"""Keys in a real browser: make, see once, replace, revoke."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser


def test_a_key_is_made_shown_once_replaced_and_revoked(
    page: Page, engineer: Any, keys: Any, admin: str, fits: Any
) -> None:
    page.goto(f"{admin}/#/setup/keys")
    expect(page.locator(".wizard td").first).to_have_text("ada")
    page.get_by_label("Name of the program or person").fill("tester-1")
    page.get_by_label("operate: arm").check()
    page.get_by_role("button", name="Make the key").click()
    secret = page.locator("#secret").input_value()
    assert set(keys.find(secret).scopes) == {"read", "operate"}
    fits("keys", ".wizard td")
    expect(page.locator("#secret")).to_have_count(0)
    row = page.locator("tr", has_text="tester-1")
    row.get_by_role("button", name="Replace").click()
    expect(page.locator("#secret")).to_be_visible()
    assert keys.find(secret) is None
    page.get_by_role("button", name="I have kept it").click()
    expect(page.locator("#secret")).to_have_count(0)
    row.get_by_role("button", name="Revoke").click()
    row.get_by_role("button", name="Revoke tester-1 now").click()
    expect(row).to_have_count(0)
    page.get_by_label("Name of the program or person").fill("ada")
    page.get_by_role("button", name="Make the key").click()
    expect(page.locator(".answer.refused")).to_contain_text("ada")
    page.get_by_label("read: state").uncheck()
    page.get_by_role("button", name="Make the key").click()
    expect(page.locator(".answer.refused")).to_have_text("Choose at least one scope.")
