"""Tables and small figures in HTML, as notebooks show results."""

import html
from collections.abc import Callable, Iterable, Sequence


def escaped(text: str) -> str:
    """A paragraph of `text`."""
    return f"<p>{html.escape(text)}</p>"


def titled(text: str) -> str:
    """A paragraph of `text`, bold."""
    return f"<p><b>{html.escape(text)}</b></p>"


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = (), caption: str = "") -> str:
    """A table of text: `head` and `rows`, each with as many cells as there are columns."""
    parts = [f"<caption>{html.escape(caption)}</caption>"] if caption else []
    parts += [_row(head, "th")] if head else []
    return f"<table>{''.join([*parts, *(_row(row, 'td') for row in rows)])}</table>"


def _row(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in cells) + "</tr>"


class _Figures:
    """What draws a result small; the package's ``__init__`` sets it, because figures are made of results."""

    draw: Callable[[object], str] | None = None


def draw_with(draw: Callable[[object], str]) -> None:
    """Let `draw` make the small figures: of a result, as HTML."""
    _Figures.draw = staticmethod(draw)


def small_figure(result: object) -> str:
    """A small figure of a `Simulation`, an `Ensemble` or a `Distribution`, as HTML."""
    return "" if _Figures.draw is None else _Figures.draw(result)
