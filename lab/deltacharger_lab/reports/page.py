# SPDX-License-Identifier: Apache-2.0
"""Pages of reports from a template and the figures, also as one HTML file.

Templates omit the line under the head of a table: a block of rows is a table, its first row the head.
"""

from __future__ import annotations

import base64
import inspect
import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deltacharger_lab.reports import formats

_TEMPLATES = Path(__file__).parent / "templates"
_FILTERS = dict(inspect.getmembers(formats, inspect.isfunction))
_WIDTH = 125
_NO_PROSE = ("#", "- ", "![")  # blocks that are not wrapped


def render(subject: str, figures: Mapping[str, Any], **more: Any) -> str:
    """Return the page of the JSON figures; errors as `rendered`."""
    text = rendered(f"{subject}.md.j2", {**figures, "figures": figures, **more})
    return "\n\n".join(map(_wrapped, re.split(r"\n\s*\n", text.strip()))) + "\n"


def rendered(name: str, values: Mapping[str, Any]) -> str:
    """Return a template rendered with values.

    Raises:
        ModuleNotFoundError: jinja2 is missing.
        jinja2.TemplateError: the template uses an unknown name.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(_FILTERS)
    environment.globals.update(values)
    return environment.get_template(name).render()


def _wrapped(block: str) -> str:
    """Return prose as one paragraph, wrapped between words, and a table with the line under its head."""
    if block.startswith("|"):
        head, newline, rows = block.partition("\n")
        return f"{head}\n|{'---|' * (head.count('|') - 1)}{newline}{rows}"
    if block.startswith(_NO_PROSE):
        return block
    return textwrap.fill(" ".join(block.split()), _WIDTH, break_long_words=False, break_on_hyphens=False)


def write_html(page: Path, path: Path) -> None:
    """Write a Markdown page as one file with its pictures inside.

    Raises:
        ModuleNotFoundError: jinja2 or markdown-it-py is missing.
        OSError: a file cannot be read or written.
    """
    from markdown_it import MarkdownIt

    markdown = MarkdownIt("js-default")
    text = page.read_text("utf-8")
    tokens = markdown.parse(text)
    for token in (child for each in tokens for child in each.children or ()):
        if token.type == "image":
            inside = base64.b64encode((page.parent / str(token.attrs["src"])).read_bytes()).decode()
            token.attrs["src"] = f"data:image/png;base64,{inside}"
    shown = {
        "title": text.partition("\n")[0].lstrip("# "),
        "body": markdown.renderer.render(tokens, markdown.options, {}),
    }
    path.write_text(rendered("page.html.j2", shown), "utf-8")
