"""Text and tables as HTML: for a notebook, which shows what `_repr_html_` returns, and for the pages of reports."""

import html
from collections.abc import Sequence


def html_text(value: object) -> str:
    """Anything as text of a page."""
    return html.escape(str(value))


def html_table(head: Sequence[object], rows: Sequence[Sequence[object]], caption: object = "") -> str:
    """Rows of texts; the first of each is a name, the others are figures, which know their column for a phone."""
    titles = "".join(f"<th>{html_text(title)}</th>" for title in head)
    lines = "".join(
        f"<tr><td>{_breakable(name)}</td>"
        + "".join(
            f'<td class=n data-of="{html_text(of)}">{html_text(cell)}</td>'
            for of, cell in zip(head[1:], cells, strict=True)
        )
        + "</tr>"
        for name, *cells in rows
    )
    told = f"<caption>{html_text(caption)}</caption>" if caption else ""
    return f"<table>{told}<tr>{titles}</tr>{lines}</table>"


def _breakable(name: object) -> str:
    """A name that a phone may break between its words: x.to_positive.repeatability."""
    return html_text(name).replace("_", "_<wbr>").replace(".", ".<wbr>")
