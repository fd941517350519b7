"""Draw docs/images/align.gif, what the cameras of the virtual table see while it is aligned: python tools/animation.py

Every picture is a frame of a camera, taken while the loop looks or works. Needs Pillow, which matplotlib brings along.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mirrormount.cli.main import parser
from mirrormount_beam.cli.hold import virtual_table
from mirrormount_beam.control.calibrate import Calibration
from mirrormount_beam.control.events import Event, Observed, SpotSeen
from mirrormount_beam.control.hold import align

IMAGE = Path(__file__).resolve().parent.parent / "docs" / "images" / "align.gif"
TABLE = ("align", "--virtual", "--profile", "hardware", "--seed", "7", "--off", "6")
WIDTH = 300  # of one camera's picture, pixels
LAST_MS, EACH_MS = 2500, 450


def main() -> None:
    """Calibrate without a picture, align with one of each observation, and write them."""
    pictures: list[Image.Image] = []
    with virtual_table(parser(TABLE[:1]).parse_args(TABLE)) as (loop, table, _):
        newest: dict[str, Any] = {}
        for camera in table.cameras:
            _watch(camera, newest)
        calibration = Calibration(loop)
        response = calibration.run()
        table.truth.misalign(6.0, np.random.default_rng(7))
        begin_s = loop.now_s()
        font = ImageFont.load_default(size=15)

        def listen(event: Event) -> None:
            if isinstance(event, Observed) and event.complete:
                pictures.append(_draw(event, newest, event.time_s - begin_s, font))

        align(loop, response, calibration.gaps, listen)
    times = [EACH_MS] * (len(pictures) - 1) + [LAST_MS]
    pictures[0].save(IMAGE, save_all=True, append_images=pictures[1:], duration=times, loop=0, optimize=True)
    print(f"{IMAGE}: {len(pictures)} pictures, {IMAGE.stat().st_size} bytes")


def _watch(camera: Any, newest: dict[str, Any]) -> None:
    """Keep the newest frame of a camera beside whoever takes it."""
    frames = camera.frames

    def watched() -> Iterator[Any]:
        for frame in frames():
            newest[camera.name] = frame.image
            yield frame

    camera.frames = watched


def _draw(event: Observed, newest: dict[str, Any], time_s: float, font: Any) -> Image.Image:
    """The cameras side by side, with the target's cross and the error."""
    sheet = Image.new("L", (2 * WIDTH + 10, WIDTH * 3 // 4 + 26), 255)
    pen = ImageDraw.Draw(sheet)
    for i, (spot, picture) in enumerate(zip(event.spots, newest.values(), strict=True)):
        assert isinstance(spot, SpotSeen)
        whole = Image.fromarray(picture)
        at = i * (WIDTH + 10)
        sheet.paste(whole.resize((WIDTH, WIDTH * 3 // 4)), (at, 26))
        x, y = at + WIDTH // 2, 26 + WIDTH * 3 // 8
        pen.line((x - 14, y, x + 14, y), fill=160)
        pen.line((x, y - 14, x, y + 14), fill=160)
        error = np.hypot(*spot.error_um) / 1000
        text = f"camera {i + 1}: {error:.2f} mm off" + (f", {time_s:.0f} s (simulated)" if i else "")
        pen.text((at + 4, 4), text, fill=0, font=font)
    sixteen = [grey // 16 * 17 for grey in range(256)]
    return sheet.point(sixteen).quantize(16, dither=Image.Dither.NONE)  # a sixth of the bytes


if __name__ == "__main__":
    main()
