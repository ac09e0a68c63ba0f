"""A report as one HTML file: everything is in it, nothing is asked of any other place, and no script runs."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping
from html import escape
from typing import Final

from taut.record.report.page import Page, Picture, Table, versions, without_folders

__all__ = ["html_of"]

MOST_BYTES: Final = 3_000_000
SHARPNESS: Final = (160, 120, 90, 60)  # [dots per inch], the first one that fits
STYLE: Final = """
:root { color-scheme: light dark; --ink: #1c1c1c; --paper: #fff; --line: #d0d0d0; --soft: #f4f4f4; --bad: #a40000;
  --edge: rgba(0, 0, 0, .35); }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e6e6; --paper: #17181a; --line: #44474b; --soft: #222427; --bad: #ff8a80;
    --edge: rgba(255, 255, 255, .35); }
}
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1rem; background: var(--paper); color: var(--ink);
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", sans-serif; }
h1 { font-size: 1.4rem; line-height: 1.25; }
h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; border-bottom: 1px solid var(--line); }
.fault { border-left: .3rem solid var(--bad); padding: .2rem .8rem; background: var(--soft); }
.fault, h1, p { overflow-wrap: anywhere; }
.fault b { color: var(--bad); }
.wide, pre { overflow-x: auto; background-repeat: no-repeat; background-attachment: local, local, scroll, scroll;
  background-size: 2.5rem 100%, 2.5rem 100%, .8rem 100%, .8rem 100%; background-position: 0 0, 100% 0, 0 0, 100% 0;
  background-image: linear-gradient(to right, var(--under) 40%, transparent),
    linear-gradient(to left, var(--under) 40%, transparent),
    linear-gradient(to right, var(--edge), transparent), linear-gradient(to left, var(--edge), transparent); }
.wide { --under: var(--paper); margin: .5rem 0 1rem; }
table { border-collapse: collapse; font-size: .875rem; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { padding: .2rem .7rem .2rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
td { overflow-wrap: break-word; }
.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
.w { min-width: 6.5rem; }
@media (min-width: 40rem) { td.w:first-child { white-space: nowrap; } }
.note { font-size: .875rem; margin-top: -.6rem; }
pre { --under: var(--soft); background-color: var(--soft); padding: .7rem; white-space: pre;
  font: .8rem/1.4 ui-monospace, Consolas, "Liberation Mono", monospace; }
.again { white-space: pre-wrap; overflow-wrap: anywhere; }
th.n { white-space: normal; }
figure { margin: .5rem 0 1rem; }
figure img { width: 100%; min-width: 40rem; height: auto; background: #fff; display: block; }
@media print {
  :root { --ink: #000; --paper: #fff; --line: #bbb; --soft: #f4f4f4; --bad: #a40000; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  .wide, pre { overflow: visible; background-image: none; }
  table { font-size: 7.5pt; }
  th, td { padding-right: .4rem; overflow-wrap: anywhere; }
  .n, td.w:first-child { white-space: normal; }
  .w { min-width: 0; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; }
  figure img { min-width: 0; max-height: 24cm; width: auto; max-width: 100%; }
  figure, tr, .fault { break-inside: avoid; }
  h2 { break-after: avoid; }
}
"""
POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def html_of(page: Page) -> str:
    """The whole file, of at most three megabytes: pictures are as sharp as that allows."""
    for dpi in SHARPNESS:
        text = "\n".join(_lines(page, dpi))
        if len(text.encode()) < MOST_BYTES:
            break
    return text


def _text(text: str) -> str:
    """A text as HTML, its files without folders; what no page can hold is shown as a question mark."""
    kept = "".join(
        letter if letter.isprintable() or letter in "\n\t" else "\N{REPLACEMENT CHARACTER}" for letter in text
    )
    return escape(without_folders(kept))


def _lines(page: Page, dpi: int) -> Iterator[str]:
    yield "<!DOCTYPE html>"
    yield '<html lang="en">'
    yield '<head><meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f'<meta http-equiv="Content-Security-Policy" content="{escape(POLICY)}">'
    yield '<meta name="generator" content="taut">'
    yield f"<title>{_text(page.title)}</title>"
    yield f"<style>{STYLE}</style></head>"
    yield "<body><main>"
    yield f"<h1>{_text(page.title)}</h1>"
    for fault in page.faults:
        yield f'<p class="fault"><b>Fault:</b> {_text(fault)}</p>'
    for sentence in page.summary:
        yield f"<p>{_text(sentence)}</p>"
    if page.tables:
        yield "<h2>Numbers</h2>"
    for table in page.tables:
        yield from _table(table)
    if page.pictures:
        yield "<h2>Pictures</h2>"
    for picture in page.pictures:
        yield _picture(picture, dpi)
    if page.settings:
        yield "<h2>Settings</h2>"
        yield from _pairs("setting", "value", page.settings)
    for title, text in page.texts.items():
        yield f"<h2>{_text(title)}</h2>"
        yield f'<pre tabindex="0">{_text(text)}</pre>'
    if page.repeat:
        yield "<h2>How to repeat it</h2>"
        yield f'<pre class="again">{_text(page.repeat)}</pre>'
    yield "<h2>Versions</h2>"
    yield from _pairs("program", "version", page.versions or versions())
    yield "</main></body>"
    yield "</html>\n"


def _pairs(name: str, value: str, pairs: Mapping[str, str]) -> Iterator[str]:
    yield from _table(Table(title="", heads=(name, value), rows=list(pairs.items()), words=2))


def _table(table: Table) -> Iterator[str]:
    """A table that scrolls by itself where the page is narrow, with a shade where more of it is."""
    label = f' role="region" aria-label="{_text(table.title)}"' if table.title else ""
    yield f'<div class="wide" tabindex="0"{label}><table>'
    if table.title:
        yield f"<caption>{_text(table.title)}</caption>"
    yield "<thead><tr>" + "".join(_cell("th", head, i, table, ' scope="col"') for i, head in enumerate(table.heads))
    yield "</tr></thead><tbody>"
    for row in table.rows:
        yield "<tr>" + "".join(_cell("td", text, i, table) for i, text in enumerate(row)) + "</tr>"
    yield "</tbody></table></div>"
    if table.note:
        yield f'<p class="note">{_text(table.note)}</p>'


def _cell(kind: str, text: str, column: int, table: Table, more: str = "") -> str:
    shown = "w" if column < table.words else "n"
    told = _text(text).replace("_", "_<wbr>") if kind == "th" else _text(text)  # names of joints are long
    return f'<{kind} class="{shown}"{more}>{told}</{kind}>'


def _picture(picture: Picture, dpi: int) -> str:
    data = io.BytesIO()
    picture.figure.savefig(data, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})
    encoded = base64.b64encode(data.getvalue()).decode()
    title = _text(picture.title)
    return (
        f'<figure><div class="wide" tabindex="0"><img alt="{title}" src="data:image/png;base64,{encoded}"></div>'
        f"<figcaption>{title}</figcaption></figure>"
    )
