"""What of a picture is looked at: region, mask, channel, contrast; in Python, in commands, and in table.toml."""

import csv
import json

import cv2
import numpy as np
import pytest
import scenes

from mirrormount.cli.main import main
from mirrormount.errors import BadValue
from mirrormount_beam import find_spot
from mirrormount_beam.camera import Limits, Picture, checked
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.selection import Selection
from mirrormount_beam.spot.find import NoSpotReason

X, Y, WIDTH = 143.3, 96.8, 6.0
WINDOW = (slice(30, 190), slice(230, 320))
BESIDE = (40, 20, 180, 200)  # a region without the window


def picture(x=X, y=Y, peak=150.0, seed=1, window=False):
    """One beam on a slope, 320 x 240 pixels; with a bright window beside it."""
    rows, columns = np.mgrid[:240, :320]
    image = scenes.expose(12 + 0.02 * columns + peak * beam(x, y, WIDTH), rng(seed))
    if window:
        image[WINDOW] = np.where((rows + columns)[WINDOW] % 40 < 34, 255, 120)
    return image


def rng(seed):
    return np.random.default_rng(seed)


def beam(x, y, width):
    """Light of a round beam with peak 1."""
    rows, columns = np.mgrid[:240, :320]
    return np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * width**2))


def hiding(*slices):
    mask = np.zeros((240, 320), bool)
    mask[slices] = True
    return mask


def colours(blue, green, red):
    """A picture of three exposures of one beam."""
    light = beam(X, Y, 12)
    parts = [8 + part * light + rng(at).normal(size=light.shape) for at, part in enumerate((blue, green, red))]
    return np.dstack([np.clip(np.rint(part), 0, 255).astype(np.uint8) for part in parts])


# ---- region and mask


@pytest.mark.parametrize("how", [{"region": BESIDE}, {"mask": hiding(slice(25, 195), slice(225, 320))}], ids=str)
def test_a_beam_beside_a_window_is_found_where_the_window_is_not_looked_at(how):
    image = picture(window=True)
    assert not find_spot(image)
    found, alone = find_spot(image, **how), find_spot(picture())
    assert abs(found.x - X) < 4 * found.sigma_x and abs(found.y - Y) < 4 * found.sigma_y
    assert abs(found.x - alone.x) < 2 * alone.sigma_x and found.sigma_x < 1.5 * alone.sigma_x


def test_what_is_told_of_a_region_is_in_pixels_of_the_whole_picture():
    whole, part = find_spot(picture()), find_spot(picture(), region=BESIDE)
    (first,), (same,) = whole.detection.blobs, part.detection.blobs
    assert (first.x, first.y) == pytest.approx((same.x, same.y), abs=1.5)
    levels = [spot.detection.background_along(70, 320)[60:200].mean() for spot in (whole, part)]
    assert levels[0] == pytest.approx(levels[1], abs=0.5)


@pytest.mark.parametrize(
    ("x", "y", "how", "reason"),
    [
        (48, 96, {"region": BESIDE}, NoSpotReason.REGION),
        (143, 214, {"region": BESIDE}, NoSpotReason.REGION),
        (7, 96, {"region": (0, 0, 200, 240)}, NoSpotReason.EDGE),
        (7, 96, {"mask": hiding(slice(0, 240), slice(250, 320))}, NoSpotReason.EDGE),
        (243, 96, {"mask": hiding(slice(0, 240), slice(250, 320))}, NoSpotReason.MASK),
        (143, 96, {"mask": hiding(slice(80, 120), slice(148, 170))}, NoSpotReason.MASK),
        (143, 96, {"mask": hiding(slice(92, 100), slice(139, 147))}, NoSpotReason.MASK),
        (143, 96, {"contrast": 170}, NoSpotReason.CONTRAST),
    ],
)
def test_a_spot_that_is_cut_says_what_cuts_it(x, y, how, reason):
    found = find_spot(picture(x, y), **how)
    assert not found and found.reason is reason
    assert str(found) == f"no spot: {reason.words}"


def test_what_a_mask_hides_of_the_rim_is_in_the_error():
    pulls, growth = [], []
    for seed in range(12):
        x, y = X + rng(seed).random(), Y
        image, free = picture(x, y, seed=seed), find_spot(picture(x, y, seed=seed))
        mask = hiding(slice(60, 130), slice(round(x + 2.4 * WIDTH), 200))
        image[mask] = 255
        found = find_spot(image, mask=mask)
        pulls += [(found.x - x) / found.sigma_x, (found.y - y) / found.sigma_y]
        growth.append(found.sigma_x / free.sigma_x)
    assert max(map(abs, pulls)) < 3.5 and min(growth) > 3


def test_no_spot_is_invented_where_a_mask_hides_one():
    mask = hiding(slice(70, 124), slice(110, 176))
    assert find_spot(picture(), mask=mask).reason in (NoSpotReason.NOTHING, NoSpotReason.DIM)


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"region": (200, 0, 200, 200)}, "the region 200,0,200,200 .* is not in the picture of 320 x 240 pixels"),
        ({"region": (0, 0, 20, 200)}, "make it at least 32 x 32"),
        ({"region": (0.5, 0, 99, 99)}, "a region is x, y, width and height in whole pixels"),
        ({"mask": np.zeros((120, 160), bool)}, "the mask has 160 x 120 pixels, the picture 320 x 240"),
        ({"mask": np.ones((240, 320), bool)}, "is it the wrong way round"),
        ({"mask": np.ones((240, 320), np.uint8)}, "a mask is an array of truth values"),
        ({"channel": "violet"}, "the channel is red, green, blue, grey, automatic, not 'violet'"),
        ({"channel": "red"}, "the picture is grey, and has no channel red"),
        ({"contrast": -1}, "the contrast is 0 to 65535 grey values"),
    ],
)
def test_what_no_picture_can_have_is_refused_in_words(how, says):
    with pytest.raises(BadValue, match=says):
        find_spot(picture(), **how)


def test_hot_pixels_of_a_dark_picture_count_in_a_region_too():
    hot, dark = picture(peak=0), picture(peak=0, seed=2)
    hot[100:104, 100:104] = dark[100:104, 100:104] = 230
    assert find_spot(hot, dark, region=BESIDE).reason is NoSpotReason.NOTHING


# ---- channel


@pytest.mark.parametrize(
    ("light", "channel", "saturated"),
    [
        ((60, 200, 90), "green", ()),
        ((240, 30, 90), "blue", ()),
        ((500, 30, 130), "red", ("blue",)),  # the blue core is large, and red sees enough
        ((500, 30, 40), "blue", ("blue",)),  # red is too dim to be better
        ((60, 270, 120), "green", ("green",)),  # a small core does not matter
    ],
)
def test_the_channel_is_the_brightest_that_is_not_saturated(light, channel, saturated):
    image = colours(*light)
    (frame,) = checked(iter([Picture(image, 0.0)]), "cam", None, Limits())
    assert frame.colour == (channel, saturated)
    found, alone = find_spot(image), find_spot(image, channel=channel)
    assert (found.x, found.sigma_x) == (alone.x, alone.sigma_x) == (find_spot(frame).x, find_spot(frame).sigma_x)
    assert abs(found.x - X) < 4 * found.sigma_x < 0.5


def test_a_camera_keeps_its_channel_until_another_one_is_clearly_brighter():
    lights = (100, 20, 110), (110, 20, 100), (100, 20, 110), (160, 20, 80), (110, 20, 100)
    pictures = (Picture(colours(*light), at / 30) for at, light in enumerate(lights))
    frames = checked(pictures, "cam", None, Limits())
    assert [frame.colour.channel for frame in frames] == ["red", "red", "red", "blue", "blue"]


def test_the_region_chooses_the_channel():
    image = colours(60, 30, 150)
    image[:, 300:, 0] = 250  # a blue lamp
    assert abs(find_spot(image, region=(0, 0, 280, 240)).x - X) < 0.3


# ---- commands and table.toml


@pytest.fixture
def pictures(tmp_path, monkeypatch):
    """A folder of two pictures with a window in view; a table.toml of the test."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    monkeypatch.delenv("MIRRORMOUNT_TABLE", raising=False)
    (tmp_path / "run").mkdir()
    for number in (9, 10):
        cv2.imwrite(str(tmp_path / "run" / f"frame{number}.png"), picture(seed=number, window=True))
    mask = 255 * hiding(slice(25, 195), slice(225, 320)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    return tmp_path


@pytest.mark.parametrize("options", [["--roi", "40,20,180,200"], ["--mask", "mask.png"]])
def test_show_names_the_files_and_writes_a_record_for_each_frame(pictures, monkeypatch, capsys, options):
    monkeypatch.chdir(pictures)
    assert main(["camera", "show", "--camera", "run", *options, "--csv", "a.csv", "--json", "a.jsonl"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[-1] for line in lines] == ["frame9.png", "frame10.png"]
    rows = list(csv.DictReader((pictures / "a.csv").read_text().splitlines()))
    records = [json.loads(line) for line in (pictures / "a.jsonl").read_text().splitlines()]
    assert [row["file"] for row in rows] == [one["file"] for one in records] == ["frame9.png", "frame10.png"]
    for row, one in zip(rows, records, strict=True):
        assert list(row) == list(one)
        assert float(row["x_px"]) == one["x_px"] == pytest.approx(X, abs=5 * one["sigma_x_px"])
        assert one["ellipticity"] == pytest.approx(1, abs=0.05) and one["refusal"] is None


def test_a_refusal_is_a_record_too_and_no_file_is_written_over(pictures, capsys):
    words = ["camera", "show", "--camera", str(pictures / "run"), "--json", str(pictures / "a.jsonl")]
    assert main(words) == 0
    one = json.loads((pictures / "a.jsonl").read_text().splitlines()[0])
    reason = NoSpotReason(next(each.value for each in NoSpotReason if each.code == one["refusal"]))
    assert one["refusal_text"] == reason.words and one["x_px"] is None
    capsys.readouterr()
    assert main(words) == 1
    assert "a.jsonl: exists; name a new file" in capsys.readouterr().err


def test_table_toml_keeps_what_is_looked_at_and_a_command_may_change_it(pictures, monkeypatch, capsys):
    monkeypatch.chdir(pictures)
    options = ["--mask", "mask.png", "--channel", "grey", "--contrast", "20"]
    assert main(["table", "camera", "near", str(pictures / "run"), *options, "--roi", "0,0,320,240"]) == 0
    assert "roi 0,0,320,240, mask " in capsys.readouterr().out
    monkeypatch.chdir("/")  # the mask is found from every folder
    camera = open_camera("near")
    assert camera.selection.region == (0, 0, 320, 240) and camera.selection.mask.sum() == 170 * 95
    assert (camera.selection.channel, camera.selection.contrast) == ("grey", 20)
    assert all(find_spot(frame) for frame in camera.frames())
    assert main(["camera", "show", "--camera", "near", "--contrast", "999"]) == 0
    assert "the spot has less contrast than is asked for" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--roi", "300,0,100,100"], "the region 300,0,100,100 (x, y, width, height) is not in the picture"),
        (["--roi", "1,2,3"], "the roi is x,y,width,height in pixels, such as 200,80,640,480, not '1,2,3'"),
        (["--roi", "0,0,8,8"], "32 pixels or more to a side"),
        (["--channel", "violet"], "the channel is red, green, blue, grey, automatic, not 'violet'"),
        (["--channel", "red"], "the picture is grey, and has no channel red: leave the channel out"),
        (["--mask", "none.png"], "none.png: No such file"),
        (["--mask", "mask.txt"], "mask.txt: a mask is a picture"),
        (["--mask", "small.png"], "the mask has 64 x 64 pixels, the picture 320 x 240"),
        (["--contrast", "much"], "--contrast is a number"),
    ],
)
def test_options_that_do_not_fit_are_one_line(pictures, monkeypatch, capsys, options, says):
    monkeypatch.chdir(pictures)
    cv2.imwrite("small.png", np.zeros((64, 64), np.uint8))
    assert main(["camera", "show", "--camera", "run", *options]) == 1
    err = capsys.readouterr().err.splitlines()
    assert says in err[-1] and len(err) <= 2


@pytest.mark.parametrize(
    "command",
    [["camera", "show"], ["measure", "drift"], ["scan", "find"], ["hold"], ["align"], ["calibrate"]],
    ids=" ".join,
)
def test_every_command_that_finds_a_spot_takes_a_region(pictures, monkeypatch, capsys, command):
    monkeypatch.chdir(pictures)
    assert main([*command, "--virtual", "--roi", "600,400,300,300"]) == 1
    assert "the region 600,400,300,300 (x, y, width, height) is not in the picture" in capsys.readouterr().err


def test_people_see_what_is_not_looked_at_dark():
    image = picture(window=True)
    mask = hiding(slice(90, 110), slice(100, 120))
    shown = Selection(region=BESIDE, mask=mask).shown(image)
    kept = Selection(region=BESIDE).pixels(np.arange(image.size).reshape(image.shape))
    kept = np.isin(np.arange(image.size).reshape(image.shape), kept) & ~mask
    assert (shown[kept] == image[kept]).all() and (shown[~kept] == image[~kept] // 3).all()
