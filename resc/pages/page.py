"""A page in one file: sections, charts drawn from data within it, pictures within it."""

import base64
import html
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

from PIL import Image

HERE = Path(__file__).parent
PICTURES_B = 3_500_000
"""Bytes of all pictures of a page; those beyond are linked, so that the page stays small."""
WIDEST = 1800
"""Columns of a picture within a page; wider ones are made smaller."""
NUMBER = re.compile(r"[-+]?\d[\d,.]*( ?%)?( \(.*\)|-[\d.]+| / [\d.]+)?|fails|-|")
"""What is set to the right: a number, with its interval or another one, or that there is none."""


class Html(str):
    """Text that is HTML already; other text is escaped."""

    __slots__ = ()


def escaped(text: object) -> Html:
    """Text as it stands in HTML."""
    return text if isinstance(text, Html) else Html(html.escape(str(text)))


def table(
    head: Sequence[object],
    rows: Iterable[Sequence[object]],
    marks: Iterable[Mapping[str, object]] | None = None,
) -> Html:
    """A table; numbers are set to the right.

    Args:
        head: What the columns are.
        rows: Their cells.
        marks: Of each row, what the script of the page knows it by.
    """
    rows = list(rows)
    found = list(marks) if marks is not None else [{}] * len(rows)
    right = [bool(rows) and all(_is_number(row[i]) for row in rows) for i in range(len(head))]
    told = [_row("th", head, right)]
    for row, mark in zip(rows, found, strict=True):
        own = "".join(f' data-{name}="{escaped(value)}"' for name, value in mark.items())
        told.append(_row("td", row, right, own))
    return Html(f'<div class="wide"><table>\n{chr(10).join(told)}\n</table></div>')


def _row(kind: str, cells: Sequence[object], right: Sequence[bool], own: str = "") -> str:
    classes = [' class="number"' if number else "" for number in right]
    pairs = zip(cells, classes, strict=True)
    return f"<tr{own}>{''.join(f'<{kind}{c}>{escaped(cell)}</{kind}>' for cell, c in pairs)}</tr>"


def _is_number(cell: object) -> bool:
    return isinstance(cell, int | float) or bool(NUMBER.fullmatch(str(cell)))


def tiles(facts: Mapping[str, object]) -> Html:
    """The few numbers that a reader looks for first."""
    parts = [
        f'<div class="tile"><b>{escaped(value)}</b>{escaped(name)}</div>'
        for name, value in facts.items()
    ]
    return Html(f'<div class="tiles">{"".join(parts)}</div>')


def link(path: Path, folder: Path, text: object | None = None) -> Html:
    """A link to a file or folder beside the page."""
    name = path.relative_to(folder).as_posix() + ("/" if path.is_dir() else "")
    target = html.escape(quote(name))
    return Html(f'<a href="{target}">{escaped(name if text is None else text)}</a>')


def paragraph(text: object, kind: str = "") -> Html:
    """Text of its own."""
    return Html(f'<p class="{kind}">{escaped(text)}</p>' if kind else f"<p>{escaped(text)}</p>")


def details(title: str, *parts: Html) -> Html:
    """Parts that are closed at first."""
    return Html(f"<details><summary>{escaped(title)}</summary>{''.join(parts)}</details>")


def grid(kind: str, parts: Iterable[Html]) -> Html:
    """Charts or pictures beside one another."""
    return Html(f'<div class="{kind}">{"".join(parts)}</div>')


@dataclass
class Page:
    """What is put together to a page.

    Args:
        folder: That it is of, and in.
        about: Where it is from, in a line.
        command: That made the folder.
        runs: Of a sweep, what the filter chooses from.
    """

    folder: Path
    about: str = ""
    command: str = ""
    runs: list[dict[str, Any]] = field(default_factory=list)
    sections: list[tuple[str, str]] = field(default_factory=list)
    charts: list[dict[str, Any]] = field(default_factory=list)
    pictures_b: int = 0

    def add(self, title: str, *parts: Html) -> None:
        """Adds a section, unless it holds nothing."""
        if any(parts):
            self.sections.append((title, "\n".join(parts)))

    def chart(self, title: str, kind: str, **settings: Any) -> Html:  # noqa: ANN401 - JSON
        """A chart for the script of the page: `lines` or `intervals`."""
        self.charts.append({"title": title, "kind": kind, **settings})
        number = len(self.charts) - 1
        return Html(f'<figure data-chart="{number}"><h3>{escaped(title)}</h3></figure>')

    def picture(self, path: Path, title: object, source: bool = True) -> Html:
        """A picture within the page; beyond `PICTURES_B` a link to it, or nothing without a source.

        Args:
            path: Of the picture.
            title: What it shows.
            source: Whether it stays beside the page.
        """
        data, width, height = _small(path)
        caption = Html(f"{escaped(title)} {link(path, self.folder, path.name) if source else ''}")
        if self.pictures_b + len(data) > PICTURES_B:
            return paragraph(caption) if source else Html()
        self.pictures_b += len(data)
        place = f"data:image/webp;base64,{base64.b64encode(data).decode()}"
        return Html(
            f'<figure><img src="{place}" width="{width}" height="{height}" alt="{escaped(title)}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )

    def text(self) -> str:
        """The whole file."""
        names = [re.sub(r"\W+", "-", title.lower()) for title, _ in self.sections]
        pairs = list(zip(names, self.sections, strict=True))
        data = {"charts": self.charts, "runs": self.runs}
        packed = json.dumps(data, separators=(",", ":"), allow_nan=False)
        return Template((HERE / "page.html").read_text(encoding="utf-8")).substitute(
            title=escaped(f"{self.folder.parent.name}/{self.folder.name}"),
            about=escaped(self.about),
            command=f"<pre>{escaped(self.command)}</pre>" if self.command else "",
            nav="".join(f'<a href="#{name}">{escaped(title)}</a>' for name, (title, _) in pairs),
            body="\n".join(
                f'<section id="{name}"><h2>{escaped(title)}</h2>\n{body}\n</section>'
                for name, (title, body) in pairs
            ),
            data=packed.replace("<", "\\u003c"),  # nothing in it ends the script
            css=(HERE / "page.css").read_text(encoding="utf-8"),
            js=(HERE / "page.js").read_text(encoding="utf-8"),
        )


def _small(path: Path) -> tuple[bytes, int, int]:
    """The picture as WebP, which takes a fraction of a PNG, with its width and height."""
    with Image.open(path) as found:
        picture = found.convert("RGB")
    if picture.width > WIDEST:
        picture = picture.resize((WIDEST, round(picture.height * WIDEST / picture.width)))
    kept = io.BytesIO()
    picture.save(kept, "WEBP", quality=82)
    return kept.getvalue(), picture.width, picture.height
