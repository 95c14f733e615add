"""The page around the sections of the report: one HTML file that loads no other file and runs no script."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources

from vaoi_station.reporting.drawing.svg import tag, text

# The browser enforces this policy: even if an error in the escaping let markup through, nothing is loaded or run.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"


@dataclass(frozen=True)
class Section:
    """One section of the report. Links within the page use `name` as the address of the section."""

    name: str
    heading: str
    lead: str
    """A sentence that explains how to read the section."""
    body: str

    def html(self) -> str:
        """Return the HTML of the section: heading, explanation, content."""
        lead = tag("p", text(self.lead), class_="lead") if self.lead else ""
        return tag("section", tag("h2", text(self.heading)), lead, self.body, id=self.name)


def page(title: str, head: str, sections: Sequence[Section], data: str) -> str:
    """Return the report as one HTML document. `data` is the script element that contains the numbers as JSON."""
    # The style is embedded: the report must look the same without network and without this package.
    style = resources.files("vaoi_station.reporting").joinpath("report.css").read_text(encoding="utf-8")
    contents = "".join(tag("a", text(s.heading), href=f"#{s.name}") for s in sections)
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{text(title)}</title>",
            f"<style>\n{style}</style>\n</head>\n<body>",
            head,
            tag("nav", contents),
            "<main>",
            *(s.html() for s in sections),
            "</main>",
            data,
            "</body>\n</html>\n",
        ]
    )


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: int | None = None) -> str:
    """Return an HTML table of texts. The columns from index `numbers` on contain numbers, aligned to the right."""
    first = len(columns) if numbers is None else numbers
    head = "".join(tag("th", text(c), class_="n" if k >= first else None) for k, c in enumerate(columns))
    body = "".join(
        tag("tr", *(tag("td", text(v), class_="n" if k >= first else None) for k, v in enumerate(row))) for row in rows
    )
    return tag("div", tag("table", tag("thead", tag("tr", head)), tag("tbody", body)), class_="scroll")


def facts(entries: Sequence[tuple[str, str]]) -> str:
    """Return pairs of name and value as an HTML definition list."""
    return tag("dl", *(tag("dt", text(name)) + tag("dd", text(value)) for name, value in entries))


def figures(*drawings: tuple[str, str]) -> str:
    """Return drawings side by side, each with its caption. Drawings and captions are HTML already."""
    shown = (tag("figure", drawing, tag("figcaption", caption)) for drawing, caption in drawings if drawing)
    return tag("div", *shown, class_="figures")


def folded(summary: str, content: str) -> str:
    """Return HTML that shows `summary`; a click on it unfolds `content`."""
    return tag("details", tag("summary", text(summary)), content)
