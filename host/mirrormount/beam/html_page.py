"""Pages of reports: one file with style and curves inside, for screen and phone."""

import html
import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# On a phone the rows of a table of many columns become blocks: its name, and a line for each figure.
# Curves are drawn dark on light; in the dark their lightness is turned round and their hues are kept.
_STYLE = """
:root{color-scheme:light dark;--ink:#1a1a1a;--paper:#fff;--line:#ddd;--soft:#595959;--warn:#fff3cd}
@media(prefers-color-scheme:dark){:root{--ink:#e6e6e6;--paper:#16181b;--line:#3a3d42;--soft:#a8a8a8;--warn:#4a3b0a}
.curve svg{filter:invert(.91) hue-rotate(180deg)}}
body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:60rem;padding:1rem;color:var(--ink);
background:var(--paper);overflow-wrap:anywhere}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}img,svg{max-width:100%;height:auto}
.wide{overflow-x:auto}table{border-collapse:collapse}td,th{padding:.25rem .75rem .25rem 0;text-align:left;
border-bottom:1px solid var(--line);white-space:nowrap}td.n{text-align:right;font-variant-numeric:tabular-nums}
.curve svg{display:block;width:100%;max-width:44rem}
.partial{background:var(--warn);padding:.5rem 1rem;border-left:4px solid #b58100}
@media(max-width:600px){td,th{padding-right:.5rem}td:first-child{white-space:normal;overflow-wrap:normal}
.many tr{display:block;border-bottom:1px solid var(--line);padding:.3rem 0}
.many tr:first-child{display:none}.many td{display:flex;justify-content:space-between;border:0;padding:0 0 0 1rem;
white-space:normal;text-align:right}.many td:first-child{font-weight:600;padding:0;text-align:left}
.many td:empty{display:none}
.many td.n::before{content:attr(data-of);color:var(--soft);padding-right:1rem;text-align:left}}
"""
_FEW = 3  # columns of a table that fit a phone
BEGINS = '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '


def text(value: object) -> str:
    """Anything as text of a page."""
    return html.escape(str(value))


def page(title: str, parts: Sequence[str], reload_s: int | None = None) -> str:
    """A whole page. title is text, parts are HTML. reload_s: a browser loads it again after so many seconds."""
    again = f'<meta http-equiv="refresh" content="{reload_s}">' if reload_s else ""
    return (
        f'{BEGINS}content="width=device-width, initial-scale=1">{again}'
        f"<title>{text(title)}</title><style>{_STYLE}</style></head><body>\n" + "\n".join(parts) + "\n</body></html>\n"
    )


def table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """Rows of texts; the first of each is a name, the others are figures."""
    titles = "".join(f"<th>{text(title)}</th>" for title in head)
    lines = "".join(
        f"<tr><td>{_breakable(name)}</td>"
        + "".join(
            f'<td class=n data-of="{text(of)}">{text(cell)}</td>' for of, cell in zip(head[1:], cells, strict=True)
        )
        + "</tr>"
        for name, *cells in rows
    )
    kind = "wide many" if len(head) > _FEW else "wide"
    return f'<div class="{kind}"><table><tr>{titles}</tr>{lines}</table></div>'


def _breakable(name: object) -> str:
    """A name that a phone may break between its words: x.to_positive.repeatability."""
    return text(name).replace("_", "_<wbr>").replace(".", ".<wbr>")


def chart(title: str, draw: "Callable[[Axes], object]", height: float = 3.2, width: float = 7.0) -> str:
    """A curve as SVG. draw(axes) draws it; title makes the ids in the SVG repeatable. height, width: inches.

    The letters have 10 points, so those of a narrower chart are larger on a phone, which shows its whole width.
    """
    import matplotlib  # a page without curves needs none
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title, "font.family": "sans-serif"}):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot()
        draw(axes)
        axes.grid(alpha=0.3)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None}, transparent=True)
    svg = out.getvalue()
    return f'<div class="curve">{svg[svg.index("<svg") :]}</div>'
