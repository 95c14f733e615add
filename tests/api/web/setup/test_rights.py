"""What needs a scope asks for a key, and begins anew with it."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser
SMALL = """() => [...document.querySelectorAll(".setup :is(button, select, .button)")].filter((e) => e.checkVisibility()
    && Math.min(e.getBoundingClientRect().width, e.getBoundingClientRect().height) < 44).map((e) => e.outerHTML)"""
ORDERS = """() => [...document.querySelectorAll(
    ".setup :is(a, button:enabled, input, select, summary, svg[tabindex])")]
    .filter((e) => e.checkVisibility()).length"""


def test_board_types_need_the_scope_teach(page: Page, engineer: Any, keys: Any) -> None:
    engineer.access._open_loopback = False
    page.goto(f"{engineer.url}/#/setup")
    page.get_by_label("Key").fill(keys.create("reader", ["read"]).secret)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="This needs a key with the scope teach")).to_be_visible()
    page.get_by_label("Key").fill(keys.create("other", ["operate"]).secret)
    page.keyboard.press("Enter")
    expect(page.locator(".answer")).to_have_text("The key other has not the scope teach.")
    page.get_by_label("Key").fill(keys.create("teacher", ["teach"]).secret)
    page.keyboard.press("Enter")
    expect(page.get_by_role("link", name="demo-board")).to_be_visible()


def test_what_is_pressed_is_large_and_all_orders_are_reached_by_keyboard(page: Page, engineer: Any) -> None:
    page.goto(f"{engineer.url}/#/setup/types/of/demo-board")
    expect(page.locator(".board-drawing")).to_be_visible()
    assert page.evaluate(SMALL) == []
    page.locator(".wizards a").first.focus()
    reached = 0
    while page.evaluate("document.activeElement.closest('.setup') !== null"):
        assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        reached += 1
        page.keyboard.press("Tab")
        assert reached < 100
    assert reached == page.evaluate(ORDERS)
