"""A report in a browser: on a phone nothing of its tables is cut off, and a figure keeps its unit."""

from datetime import UTC, datetime

import pytest
from looks import DESK, PHONE, SYSTEMS, assert_readable

from mirrormount_beam.estimates import Estimate, Result
from mirrormount_beam.report import Origin, write_page
from mirrormount_beam.scale import Optics

NOTHING_MEASURED_ON_IT = Origin(datetime(2026, 11, 23, tzinfo=UTC), "0.2.0", "a board", "a camera", {}, Optics())


@pytest.mark.full
@pytest.mark.parametrize("viewport", [PHONE, DESK])
def test_a_report_of_long_names_shows_each_figure_with_its_unit(open_page, tmp_path, viewport):
    result = Result("backlash", remarks=["a remark"])
    result.estimates["x.to_negative.repeatability"] = Estimate(0.135, 0.034, "steps")
    result.estimates["x.take_up"] = Estimate(337_000.0, 9_800.0, "us")
    write_page(tmp_path / "report.html", result, NOTHING_MEASURED_ON_IT, None)
    page = open_page((tmp_path / "report.html").as_uri(), until="td", viewport=viewport)
    for theme in SYSTEMS:
        page.emulate_media(color_scheme=theme)
        assert_readable(page, "0.135 ± 0.034 steps", "337000 ± 9800 µs")
    rights = page.locator("td.n").evaluate_all("(all) => all.map((e) => e.getBoundingClientRect().right)")
    assert len(rights) == 2 and max(rights) <= viewport["width"]
