"""What a notebook shows of spots, measurements, loops and scans: pictures and tables, with text escaped."""

import base64
import re

import cv2
import numpy as np
import pytest

from mirrormount_beam import SpotCamera, find_spot
from mirrormount_beam.control.events import InterlockTripped
from mirrormount_beam.control.hold import Summary
from mirrormount_beam.control.maximise import Maximum
from mirrormount_beam.estimates import Estimate, Result
from mirrormount_beam.scan import ScanPage, Signal, raster, scan


def gaussian(at, sigma=9.0, shape=(240, 320)):
    y, x = np.indices(shape)
    light = 10 + 180 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 2 / sigma**2)
    return (light + np.random.default_rng(1).normal(0, 1, shape)).clip(0, 255).astype(np.uint8)


def picture_in(page):
    """The first picture of a page: rows, columns, colours."""
    data = base64.b64decode(re.search(r"data:image/png;base64,([^\"]+)", page)[1])
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def coloured(picture):
    """Where it is not grey: what was drawn into it; the mean x and y."""
    y, x = np.nonzero(np.ptp(picture.astype(int), axis=2) > 60)
    return x.mean(), y.mean()


@pytest.mark.parametrize("region", [None, (40, 20, 200, 180)])
def test_a_spot_is_shown_as_a_small_picture_with_the_spot_drawn_where_it_is(region):
    spot = find_spot(gaussian((150, 90)), region=region)
    picture = picture_in(spot._repr_html_())
    scale, (left, top) = spot.detection.scale, spot.detection.corner
    x, y = coloured(picture)
    assert (x * scale + left, y * scale + top) == pytest.approx((150, 90), abs=scale)
    assert f"{spot.x:.3f} ± {spot.sigma_x:.3f}" in spot._repr_html_()
    assert len(spot._repr_html_()) < 30_000
    assert str(spot).startswith("spot at x 150.")


def test_where_there_is_no_spot_the_picture_is_shown_with_the_reason():
    dark = find_spot(np.random.default_rng(1).integers(0, 9, (120, 160)).astype(np.uint8))
    assert not dark and picture_in(dark._repr_html_()).any()
    assert "nothing is brighter than the background" in dark._repr_html_()
    flat = find_spot(np.zeros((120, 160), np.uint8))
    assert flat._repr_html_() == f"<p>{flat}</p>".replace("'", "&#x27;")


def test_a_camera_shows_the_last_picture_that_was_looked_at_and_takes_none(table):
    camera = SpotCamera(table.cameras[0])
    assert "not asked yet" in camera._repr_html_() and camera.png() is None
    spot, before_s = camera.spot(), table.now_s()
    picture = picture_in(camera._repr_html_())
    assert picture.shape == (480, 640, 3)
    assert coloured(picture) == pytest.approx((spot.x, spot.y), abs=1)
    assert table.now_s() == before_s


def test_results_are_tables_whose_texts_are_escaped():
    result = Result("steps", estimates={"x.step<i>": Estimate(13.8, 0.03, "px", 60)}, partial="a <b>hand</b>")
    assert "13.800 ± 0.030 px" in result._repr_html_() and "a &lt;b&gt;hand&lt;/b&gt;" in result._repr_html_()
    tripped = InterlockTripped(1.0, 3, "<i>", "a cause", "a remedy", True)
    shown = Summary([], interlocks=[tripped])._repr_html_()
    assert "NOT reached" in shown and "&lt;i&gt;" in shown
    assert "first.x" in Maximum(0.1, 0.9, 0.9, {"first.x": -1.0}, reached=True)._repr_html_().replace("<wbr>", "")
    for each in (result._repr_html_(), shown):
        assert "<i>" not in each and "<b>hand" not in each


def test_a_scan_shows_its_map_without_a_file(table):
    with table.mount() as mount:
        pattern = raster(2, 2)
        signal = Signal({"power<i>": "W"}, lambda _: (1.0,))
        page = ScanPage(None, pattern, signal)
        for sample in scan(mount, pattern, signal):
            page.add(sample)
    shown = page._repr_html_()
    assert "4 of 4 places" in shown and shown.count("<rect") == 4 and "power&lt;i&gt;" in shown
    assert "power&lt;i&gt;" in shown and "<i>" not in shown
    assert sample._repr_html_().startswith("<table>")
