# SPDX-License-Identifier: Apache-2.0
"""The page as one HTML file with its pictures inside, to be sent around."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

_STYLE = """
body { max-width: 960px; margin: 2em auto; padding: 0 1em; font: 15px/1.5 system-ui, sans-serif; color: #22303c; }
img { max-width: 100%; }
table { border-collapse: collapse; font-size: 13px; display: block; overflow-x: auto; }
td, th { padding: 3px 9px; border-bottom: 1px solid #dbe1e7; text-align: left; }
th { background: #f6f7f8; }
code { background: #f0f2f4; padding: 0 3px; }
"""


def write_html(page: Path, pictures: Sequence[str], path: Path) -> None:
    """Write a markdown page of headings, paragraphs, lists, tables and pictures as one file.

    Args:
        page: markdown.
        pictures: names of the pictures beside it.
        path: where to write it.

    Raises:
        OSError: a file cannot be read or written.
    """
    inside = {name: base64.b64encode((page.parent / name).read_bytes()).decode() for name in pictures}
    blocks = page.read_text("utf-8").strip().split("\n\n")
    title = html.escape(blocks[0].lstrip("# "))
    body = "\n".join(_block(block, inside) for block in blocks)
    path.write_text(
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n",
        "utf-8",
    )


def _block(block: str, inside: dict[str, str]) -> str:
    heading = re.match(r"(#+) (.*)", block)
    if heading:
        level = len(heading[1])
        return f"<h{level}>{_inline(heading[2])}</h{level}>"
    picture = re.fullmatch(r"!\[(.*)\]\((.*)\)", block)
    if picture:
        return f'<p><img alt="{html.escape(picture[1])}" src="data:image/png;base64,{inside[picture[2]]}"></p>'
    if block.startswith("|"):
        return "\n".join(("<table>", *_rows(block.splitlines()), "</table>"))
    if block.startswith("- "):
        return "\n".join(("<ul>", *(f"<li>{_inline(line[2:])}</li>" for line in block.splitlines()), "</ul>"))
    return f"<p>{_inline(block)}</p>"


def _rows(lines: Sequence[str]) -> Iterator[str]:
    for index, line in enumerate(lines):
        if index == 1:  # the rule below the head
            continue
        cell = "td" if index else "th"
        cells = (f"<{cell}>{_inline(each.strip())}</{cell}>" for each in line.strip("|").split("|"))
        yield f"<tr>{''.join(cells)}</tr>"


def _inline(text: str) -> str:
    safe = html.escape(text)
    safe = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", safe)
    safe = re.sub(r"\*(.+?)\*", r"<em>\1</em>", safe)
    return re.sub(r"`(.+?)`", r"<code>\1</code>", safe)
