"""The card of the camera: its picture with the spot and the target, and how the spot is moved. See static/camera.js."""

from nicegui import ui

from mirrormount.panel.camera_html import html
from mirrormount.panel.camera_view import CameraView
from mirrormount.panel.cards_of_motion import card, number, send


def build(view: CameraView) -> None:
    """The card. Its picture and its lines are drawn by the browser, which asks for them (camera_route.py)."""
    with card("Camera"):
        ui.html(html(1, view.live.name, clicks=True), sanitize=False).classes("camera-box")
        with ui.element("div").classes("line"):
            ui.label("x, y in px").classes("name")
            number("place_x", "", "x of the place, in pixels of the picture")
            number("place_y", "", "y of the place, in pixels of the picture")
            send("Move the spot there", {"do": "place"}, "x:place_x y:place_y", enter="place_x place_y")
            send("Learn", {"do": "learn"}).props("outline")
        ui.label(
            "Click on the picture: the spot goes there, a second later, in small moves that the camera checks."
            " Learn first: it measures what a step of each axis does to the spot. STOP or any other button ends it."
        ).classes("hint")
