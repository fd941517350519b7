"""A screen for Phoebus (.bob) with the records of `mirrormount ioc`.

A row for each motor, each camera and the loop; a STOP for each mount.
"""

from collections.abc import Iterator, Mapping
from xml.sax.saxutils import escape

_ROW_PX, _LEFT_PX = 30, 10
# what stands in a motor's row: the widget, the field, its left edge and width in pixels
_COLUMNS = (
    ("textupdate", "RBV", 150, 90),
    ("textentry", "VAL", 245, 90),
    ("textupdate", "EGU", 340, 50),
    ("action", "TWR", 395, 35),
    ("textentry", "TWV", 435, 60),
    ("action", "TWF", 500, 35),
    ("led", "MOVN", 545, 20),
    ("action", "STOP", 575, 60),
    ("combo", "SPMG", 640, 80),
    ("textupdate", "CERT", 725, 90),
    ("textupdate", "ESTP$", 820, 400),
)
_LABELS = {"TWR": "<", "TWF": ">", "STOP": "STOP", "GO": "GO"}
# the same of a camera's and of the loop's row
_LINKED_COLUMNS = {
    "camera": (
        ("textupdate", "VAL", 150, 150),
        ("textupdate", "X", 305, 90),
        ("textupdate", "Y", 400, 90),
        ("textupdate", "SX", 495, 90),
        ("textupdate", "SY", 590, 90),
        ("textupdate", "MSG$", 690, 530),
    ),
    "loop": (
        ("textupdate", "VAL", 150, 150),
        ("checkbox", "HOLD", 305, 100),
        ("action", "GO", 415, 40),
        ("textupdate", "ERR", 465, 90),
        ("textupdate", "ANGLE", 560, 90),
        ("textupdate", "WHY$", 660, 560),
    ),
}


def screen(mounts: Mapping[str, tuple[str, ...]], linked: Mapping[str, str]) -> str:
    """The screen, as XML. mounts: names of the mount records with their prefix, and their axes.

    linked: names of cameras and of the loop, and their record types.
    """
    widgets, y = [], 10
    for mount, axes in mounts.items():
        widgets += [
            _widget("label", mount, _LEFT_PX, y, 130, text=mount),
            _button("STOP all", f"{mount}.STOP", 150, y, 90),
            _widget("led", mount, 245, y, 20, pv_name=f"{mount}.CONN"),
            _widget("textupdate", mount, 275, y, 540, pv_name=f"{mount}.MSG$"),
        ]
        for axis in axes:
            y += _ROW_PX
            widgets += [_widget("label", axis, _LEFT_PX + 20, y, 110, text=axis), *_row(f"{mount}:{axis}", _COLUMNS, y)]
        y += _ROW_PX * 3 // 2
    for name, kind in linked.items():
        widgets += [_widget("label", name, _LEFT_PX, y, 130, text=name), *_row(name, _LINKED_COLUMNS[kind], y)]
        y += _ROW_PX
    body = "\n".join(widgets)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<display version="2.0.0">\n<name>mirror mounts</name>\n'
        f"<width>1230</width>\n<height>{y}</height>\n{body}\n</display>\n"
    )


def _row(record: str, columns: tuple[tuple[str, str, int, int], ...], y: int) -> Iterator[str]:
    for kind, field, x, width in columns:
        pv = f"{record}.{field}"
        if kind == "action":
            yield _button(_LABELS[field], pv, x, y, width)
        else:
            yield _widget(kind, pv, x, y, width, pv_name=pv, **({"label": field} if kind == "checkbox" else {}))


def _widget(kind: str, name: str, x: int, y: int, width: int, inner: str = "", **texts: str) -> str:
    texts = {"name": name, "x": str(x), "y": str(y), "width": str(width), "height": "20", **texts}
    return f'<widget type="{kind}" version="2.0.0">{_elements(texts)}{inner}</widget>'


def _button(label: str, pv: str, x: int, y: int, width: int) -> str:
    """A button that writes a 1."""
    action = f'<actions><action type="write_pv"><pv_name>{escape(pv)}</pv_name><value>1</value></action></actions>'
    return _widget("action_button", pv, x, y, width, action, text=label)


def _elements(texts: Mapping[str, str]) -> str:
    return "".join(f"<{key}>{escape(text)}</{key}>" for key, text in texts.items())
