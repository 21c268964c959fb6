# SPDX-License-Identifier: Apache-2.0
"""Reports as one HTML page, with their pictures inside; pictures as files."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from waferbot_lockstep.atomic_files import replacing

matplotlib.rcParams['text.parse_math'] = False  # a $ in the name of a log is a $

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
p.verdict { font-size: 1.15rem; background: #eef3fa; padding: .8rem 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .8rem; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; } img { max-width: 100%; }
"""


def html_page(title: str, body: Iterable[str]) -> str:
    """Return a page of these pieces of HTML."""
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f'<title>{html.escape(title)}</title><style>{STYLE}</style></head>'
        f'<body>{"".join(body)}</body></html>\n'
    )


def picture(figure: Figure) -> str:
    """Return a figure as an image inside the page, and close it."""
    buffer = io.BytesIO()
    save_picture(figure, buffer)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="" src="data:image/png;base64,{data}">'


def save_picture(figure: Figure, file: Path | io.BytesIO) -> None:
    """Write a figure as PNG, and close it."""
    figure.savefig(file, dpi=100, format='png', metadata={'Software': 'waferbot'})
    plt.close(figure)


def set_title(figure: Figure, title: str) -> None:
    """Write a title above all panels, whatever the height of the figure, and arrange them below it."""
    figure.suptitle(title, fontsize=11, y=1.0 - 0.08 / figure.get_figheight(), va='top')
    figure.tight_layout()


def save_drawing(figure: Figure, file: Path) -> None:
    """
    Write a figure as what the name of `file` ends in (`.png`, `.svg`, `.pdf`), whole, and close it.

    Raises `OSError` if it cannot be written; what was there stays then.
    """
    metadata = {'Software': 'waferbot'} if file.suffix == '.png' else None
    try:
        with replacing(file) as stream:
            figure.savefig(stream, dpi=110, format=file.suffix[1:], metadata=metadata)
    finally:
        plt.close(figure)
