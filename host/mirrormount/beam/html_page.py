"""Pages of reports: one file with style and curves inside, for screen and phone."""

import html
import io
from collections.abc import Callable, Sequence

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:60rem;padding:1rem;color:#1a1a1a;background:#fff}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}img,svg{max-width:100%;height:auto}
.wide{overflow-x:auto}table{border-collapse:collapse}td,th{padding:.25rem .75rem .25rem 0;text-align:left;
border-bottom:1px solid #ddd;white-space:nowrap}td.n{text-align:right;font-variant-numeric:tabular-nums}
.curve svg{display:block;width:100%;max-width:44rem}td.name{white-space:normal;min-width:8.5rem}
.partial{background:#fff3cd;padding:.5rem 1rem;border-left:4px solid #b58100}
"""


def text(value: object) -> str:
    """Anything as text of a page."""
    return html.escape(str(value))


def page(title: str, parts: Sequence[str]) -> str:
    """A whole page. title is text, parts are HTML."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{text(title)}</title><style>{_STYLE}</style></head><body>\n" + "\n".join(parts) + "\n</body></html>\n"
    )


def table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """Rows of texts; the first of each is a name, the others are figures."""
    titles = "".join(f"<th>{text(title)}</th>" for title in head)
    lines = "".join(
        f"<tr><td>{text(row[0])}</td>{''.join(f'<td class=n>{text(cell)}</td>' for cell in row[1:])}</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><tr>{titles}</tr>{lines}</table></div>'


def chart(title: str, draw: Callable[[Axes], object], height: float = 3.2, width: float = 7.0) -> str:
    """A curve as SVG. draw(axes) draws it; title makes the ids in the SVG repeatable. height, width: inches.

    The letters have 10 points, so those of a narrower chart are larger on a phone, which shows its whole width.
    """
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title, "font.family": "sans-serif"}):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot()
        draw(axes)
        axes.grid(alpha=0.3)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    svg = out.getvalue()
    return svg[svg.index("<svg") :]
