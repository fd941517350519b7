"""The elements of a camera on a page, which static/camera.js fills."""

from html import escape

_PROFILE = '<canvas class="profile" role="img" aria-label="Brightness of one row, and the threshold"></canvas>'


def html(number: int, name: str, *, clicks: bool = False, profile: bool = False) -> str:
    """The elements that static/camera.js fills. clicks: a click moves the spot; profile: with a row's brightness."""
    label = escape(f"Picture of {name}" + (": click where the spot should go" if clicks else ""), quote=True)
    return (
        f'<div class="camera" data-camera="{number}"{" data-clicks" if clicks else ""}>'
        f'<canvas class="picture" role="img" aria-label="{label}"></canvas>'
        '<p class="camera-trouble" role="status"></p><p class="camera-says mono"></p><p class="camera-also hint"></p>'
        '<p class="camera-off mono"></p><p class="camera-doing" role="status"></p>'
        + (_PROFILE if profile else "")
        + "</div>"
    )
