"""Contrast of texts on a page (WCAG 2)."""

from __future__ import annotations

from playwright.sync_api import Locator, Page


def contrast(element: Locator) -> float:
    """Contrast ratio of an element's text and background (WCAG 2)."""
    ink, ground = element.evaluate("""e => {
        const ink = getComputedStyle(e).color;
        while (e && getComputedStyle(e).backgroundColor === "rgba(0, 0, 0, 0)") e = e.parentElement;
        return [ink, e ? getComputedStyle(e).backgroundColor : "rgb(255, 255, 255)"];
    }""")
    return ratio(ink, ground)


def contrasts(page: Page, selector: str) -> dict[str, float]:
    """Contrast ratio of every visible text that a selector finds, by the text."""
    found = page.evaluate(
        """selector => [...document.querySelectorAll(selector)].filter((e) => e.checkVisibility() && e.innerText)
            .map((e) => {
            const [ink, text] = [getComputedStyle(e).color, e.innerText];
            while (e && getComputedStyle(e).backgroundColor === "rgba(0, 0, 0, 0)") e = e.parentElement;
            return [text, ink, e ? getComputedStyle(e).backgroundColor : "rgb(255, 255, 255)"];
        })""",
        selector,
    )
    return {text: ratio(ink, ground) for text, ink, ground in found}


def ratio(ink: str, ground: str) -> float:
    """Contrast ratio of two colours as the browser states them."""
    lighter, darker = sorted((luminance(ink), luminance(ground)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def luminance(color: str) -> float:
    parts = [float(p) / 255 for p in color.removeprefix("rgb(").removesuffix(")").split(",")]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
