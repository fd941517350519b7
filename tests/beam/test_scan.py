"""Scans on the virtual table: the pattern's places, the signal at each, the files, and every way in which they end."""

import contextlib
import csv
import itertools
import json
import math
import resource

import cv2
import numpy as np
import pytest

from mirrormount.beam import find_spot
from mirrormount.beam.open_camera import open_camera
from mirrormount.beam.patterns import FARTHEST, line, raster, spiral
from mirrormount.beam.scan import Signal, find, grey_signal, scan, spot_signal
from mirrormount.beam.scan_files import UNKNOWN, CsvFile, metadata, of_camera, write_hdf5
from mirrormount.beam.scan_page import ScanPage
from mirrormount.cli import scan_work
from mirrormount.cli.main import main
from mirrormount.common.beam_errors import CameraGone
from mirrormount.common.errors import BadValue, CannotWrite, MoveEnded
from mirrormount.device.mount import Mount
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_table
from mirrormount.virtual.sensor import EXPOSURE_S

h5py = pytest.importorskip("h5py")


@pytest.fixture
def table():
    with contextlib.closing(open_table("virtual-table://?mounts=1&cameras=2")) as opened:
        yield opened


@pytest.fixture
def mount(table):
    with Mount(Link(table.ports[0])) as opened:
        yield opened


def measured(pattern):
    return [(place.x, place.y) for place in pattern.places if place.measured]


def rows_of(path):
    """The rows of a CSV file, and what its comments say."""
    lines = path.read_text("utf-8").splitlines()
    about = dict(text[2:].split(": ", 1) for text in lines if text.startswith("# "))
    return list(csv.DictReader(text for text in lines if not text.startswith("#"))), about


def at_rest(table):
    """No motor is driven, as the bench sees it from the pins."""
    bench = table.simulations[0].bench
    before = bench.mirrors_rad(None)
    table.sleep(0.5)
    return np.allclose(before, bench.mirrors_rad(None), atol=1e-9)


# ---- patterns


def test_each_place_of_a_raster_is_approached_from_the_left():
    pattern = raster(3, 2, 2, approach=4)
    assert measured(pattern) == [(-2, -1), (0, -1), (2, -1), (-2, 1), (0, 1), (2, 1)]
    for before, place in zip(pattern.places, pattern.places[1:], strict=False):
        assert not place.measured or (place.x > before.x and place.y == before.y)


def test_a_raster_comes_to_its_first_row_from_below():
    assert raster(3, 2, approach=4).places[0].y == -4 + raster(3, 2, approach=4).places[1].y


def test_a_serpentine_never_goes_back():
    places = measured(raster(3, 3, serpentine=True))
    assert places == [(-1, -1), (0, -1), (1, -1), (1, 0), (0, 0), (-1, 0), (-1, 1), (0, 1), (1, 1)]


def test_a_spiral_visits_each_place_of_its_square_once_by_its_neighbours():
    places = measured(spiral(3, 2))
    assert places[0] == (0, 0)
    assert sorted(places) == sorted((x, y) for x in range(-6, 7, 2) for y in range(-6, 7, 2))
    assert all(abs(x - u) + abs(y - v) == 2 for (x, y), (u, v) in itertools.pairwise(places))


def test_a_line_begins_at_the_start():
    assert measured(line(-1, 2, 3)) == [(0, 0), (-1, 2), (-2, 4)]


@pytest.mark.parametrize(
    "make",
    [
        lambda: raster(0, 3),
        lambda: raster(3.5, 3),
        lambda: raster(1000, 1000),
        lambda: raster(2, 2, 2 * FARTHEST + 1),
        lambda: raster(2, 2, approach=-1),
        lambda: spiral(-1),
        lambda: spiral(10, FARTHEST),
        lambda: spiral(3, 0),
        lambda: line(0, 0, 5),
        lambda: line(1, 0, 0),
        lambda: line(1, 0, FARTHEST + 2),
    ],
)
def test_a_pattern_without_bounds_or_sense_is_refused(make):
    with pytest.raises(BadValue):
        make()


# ---- scans


def test_a_raster_of_the_spot_has_the_shape_of_the_truth(mount, table):
    """Columns and rows lie where the steps of this bench bring the spot; no row is sheared against the next."""
    truth = []
    camera = table.cameras[0]
    spot = spot_signal(camera)

    def read(here):
        values = spot.read(here)
        truth.append(camera.truth_px(table.truth.spots_mm(table.now_s())[0]))
        return values

    samples = list(scan(mount, raster(3, 2, 4), Signal(spot.columns, read), back=True))
    assert [(sample.x, sample.y) for sample in samples] == measured(raster(3, 2, 4))
    seen = np.array([sample.values[:2] for sample in samples])
    assert np.allclose(seen, truth, atol=0.5)  # the air and the laser move it between the frames
    rows = seen.reshape(2, 3, 2)
    step = (rows[:, 2] - rows[:, 0])[:, 0] / 2
    assert abs(step).min() > 8  # px of four steps
    assert np.abs(rows[1, :, 0] - rows[0, :, 0]).max() < abs(step).mean() / 4
    assert (mount.x.position, mount.y.position) == (0, 0)
    assert samples[0].certainty_x == mount.status().x.certainty


def test_a_lost_beam_is_found_and_the_mount_stays_there(mount, table):
    camera = table.cameras[1]
    table.truth.bump(0, 5000, 0)  # the spot leaves the picture of the far camera
    frames = camera.frames()

    def see(_mount):
        table.sleep(0.5)
        return find_spot(next(frames))

    assert not see(mount)
    found = find(mount, see, rings=5, pitch=4)
    assert found is not None
    assert (mount.x.position, mount.y.position) == (found.x, found.y) != (0, 0)
    assert find_spot(next(frames))
    assert at_rest(table)


def test_a_beam_that_is_nowhere_leaves_the_mount_at_its_start(mount):
    assert find(mount, lambda _mount: False, rings=1) is None
    assert (mount.x.position, mount.y.position) == (0, 0)


def test_a_place_without_a_spot_has_a_reason_and_no_value(mount, table):
    table.truth.laser.blocked = True
    (sample,) = scan(mount, line(1, 0, 1), spot_signal(table.cameras[0]))
    assert sample.values == ()
    assert "no spot" in sample.missing


def test_a_value_that_is_not_finite_is_none(mount):
    (sample,) = scan(mount, line(1, 0, 1), lambda _mount: float("nan"))
    assert (sample.values, sample.missing) == ((), "value is not finite: nan")


def test_the_mean_grey_value_falls_when_the_beam_is_blocked(mount, table):
    signal = grey_signal(table.cameras[0])
    (light,) = scan(mount, line(1, 0, 1), signal)
    table.truth.laser.blocked = True
    (dark,) = scan(mount, line(1, 0, 1), signal)
    assert light.values[0] > dark.values[0] + 0.5


def test_a_stop_between_two_places_ends_the_scan(mount):
    samples = scan(mount, line(1, 0, 3), lambda _mount: 1.0)
    next(samples)
    mount.stop()
    with pytest.raises(MoveEnded):
        next(samples)
    assert mount.x.position == 0


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ZeroDivisionError("the meter")])
def test_an_error_of_the_signal_ends_the_scan_with_the_motors_off(mount, table, error):
    def read(here):
        here.x.jog(0.5)  # the worst that a signal can leave behind
        raise error

    with pytest.raises(type(error)):
        list(scan(mount, line(1, 0, 3), read, back=True))
    assert not mount.status().moving
    assert at_rest(table)


# ---- files


def test_both_files_have_all_samples_and_the_same_metadata(mount, tmp_path):
    signal, pattern = (
        Signal({"power": "mW"}, lambda here: (here.x.position / 3 if here.x.position else float("nan"),)),
        line(1, -1, 3),
    )
    about = metadata(mount, pattern, signal)
    file = CsvFile(tmp_path / "a.csv", about, signal)
    samples = []
    for sample in scan(mount, pattern, signal):
        file.add(sample)
        samples.append(sample)
        assert len(rows_of(tmp_path / "a.csv")[0]) == len(samples)  # before the file is closed
    file.end("complete")
    write_hdf5(tmp_path / "a.h5", about, signal, samples, "complete")
    rows, said = rows_of(tmp_path / "a.csv")
    assert [row["power"] for row in rows] == ["", str(1 / 3), str(2 / 3)]
    assert rows[0]["missing"] == "power is not finite: nan"
    assert json.loads(said["settings"]) == mount.settings()
    assert json.loads(said["units"])["power"] == "mW"
    with h5py.File(tmp_path / "a.h5") as whole:
        assert np.array_equal(whole["power"], [np.nan, 1 / 3, 2 / 3], equal_nan=True)
        assert list(whole["y"]) == [0, -1, -2]
        assert whole["power"].attrs["unit"] == "mW"
        assert set(whole["certainty_x"].asstr()) == {samples[0].certainty_x}
        assert set(whole.attrs) == set(said)
        assert whole.attrs["started"] == json.loads(said["started"])
        assert json.loads(whole.attrs["settings"]) == mount.settings()
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.csv", "a.h5"]


def test_a_file_that_exists_is_not_touched(mount, tmp_path):
    signal, path = Signal.of(lambda _mount: 1.0), tmp_path / "a.csv"
    path.write_text("mine")
    with pytest.raises(CannotWrite, match="exists"):
        CsvFile(path, metadata(mount, line(1, 0, 1), signal), signal)
    assert path.read_text() == "mine"


def test_a_disk_that_fails_leaves_no_half_hdf5_file(mount, tmp_path, monkeypatch):
    def full(_file):
        raise OSError(28, "No space left on device")

    signal, path = Signal.of(lambda _mount: 1.0), tmp_path / "a.h5"
    about = metadata(mount, line(1, 0, 1), signal)
    monkeypatch.setattr("mirrormount.beam.scan_files.os.fsync", full)
    with pytest.raises(CannotWrite, match="No space left"):
        write_hdf5(path, about, signal, [], "complete")
    assert list(tmp_path.iterdir()) == []


# ---- the command


@pytest.fixture
def opened(table, monkeypatch):
    """The command opens this table, so that a test can order its faults."""
    monkeypatch.setattr(scan_work, "open_table", lambda _address: table)
    return table


def test_the_command_scans_and_writes_both_files(tmp_path, capsys):
    files = tmp_path / "a.csv", tmp_path / "a.h5"
    words = ["scan", "line", "2", "-1", "2", "--virtual", "--profile", "rough", "--seed", "3", "--back"]
    assert main([*words, "--csv", str(files[0]), "--hdf5", str(files[1])]) == 0
    assert capsys.readouterr().out.splitlines() == ["2 places", *map(str, files)]
    rows, said = rows_of(files[0])
    assert [(row["x"], row["y"]) for row in rows] == [("0", "0"), ("2", "-1")]
    assert said["ended"] == '"complete"'
    assert said["camera"] == '"virtual camera 1"'
    scale = json.loads(said["camera_scale"])
    assert (scale["mm_per_px"], scale["distance_mm"], scale["width"]) == (0.05, 400.0, 640)
    assert json.loads(said["camera_exposure"]) == {"value": EXPOSURE_S, "unit": "s", "fixed": True}
    assert json.loads(said["camera_gain"]) == {"value": 1.0, "fixed": True}
    with h5py.File(files[1]) as whole:
        assert json.loads(whole.attrs["camera_scale"]) == scale
        assert json.loads(whole.attrs["camera_exposure"])["value"] == EXPOSURE_S


def test_what_a_camera_does_not_know_is_said_to_be_unknown_and_never_invented(tmp_path):
    picture = tmp_path / "pictures" / "1.png"
    picture.parent.mkdir()
    cv2.imwrite(str(picture), np.zeros((40, 60), np.uint8))
    assert of_camera(open_camera(str(picture.parent)), None) == {
        "camera": "pictures",
        "camera_size": "60 x 40",
        "camera_scale": UNKNOWN,
        "camera_exposure": {"value": None, "unit": None, "fixed": None},
        "camera_gain": {"value": None, "fixed": None},
    }


def test_the_live_picture_reloads_while_the_scan_is_under_way_and_then_no_more(mount, tmp_path):
    path, values = tmp_path / "scan.html", iter((1.0, 2.0, math.nan, 4.0))
    pattern, signal = raster(2, 2), Signal.of(lambda _mount: next(values))
    live = ScanPage(path, pattern, signal)
    assert "0 of 4 places" in path.read_text("utf-8") and 'http-equiv="refresh"' in path.read_text("utf-8")
    for sample in scan(mount, pattern, signal):
        live.add(sample)
    live.end("complete")
    page = path.read_text("utf-8")
    assert "4 of 4 places" in page and "Ended: complete" in page and "refresh" not in page
    assert page.count("<rect") == 3 and page.count("<path") == 1, "a place without a value is crossed out"
    assert "value: 1 (dark) … 4 (bright)" in page
    lowest = next(line for line in page.split("<rect") if "(0, 0): 1" in line)
    assert 'x="0.00" y="28.00"' in lowest, "up is up"


def test_the_command_makes_a_live_picture_also_of_a_scan_that_is_cut(opened, tmp_path, capsys, monkeypatch):
    path = tmp_path / "scan.html"
    seen = []

    def pulled(self, sample):
        seen.append(sample)
        raise CameraGone("gone")

    monkeypatch.setattr(ScanPage, "add", pulled)
    assert main(["scan", "line", "1", "0", "3", "--virtual", "--page", str(path)]) == 1
    assert "Ended: gone" in path.read_text("utf-8")
    capsys.readouterr()


def test_a_live_picture_replaces_a_page_and_no_other_file(tmp_path, capsys):
    page, rows = tmp_path / "scan.html", tmp_path / "map.csv"
    for places in (2, 3):
        assert main(["scan", "line", "1", "0", str(places), "--virtual", "--page", str(page)]) == 0
        assert f"{places} of {places} places" in page.read_text("utf-8")
    rows.write_text("number,time_s")
    assert main(["scan", "line", "1", "0", "2", "--virtual", "--page", str(rows)]) == 1
    assert capsys.readouterr().err == (
        f"mirrormount: cannot write {rows}: a file of that name exists, and is no report; name another one\n"
    )
    assert rows.read_text() == "number,time_s"


def test_a_scan_that_does_not_begin_leaves_the_page_of_before(tmp_path, capsys):
    page, rows = tmp_path / "scan.html", tmp_path / "map.csv"
    words = ["scan", "line", "1", "0", "2", "--virtual", "--csv", str(rows), "--page", str(page)]
    assert main(words) == 0
    assert main(words) == 1
    assert "exists; a scan is a new file" in capsys.readouterr().err
    assert "2 of 2 places. Ended: complete" in page.read_text("utf-8")


def test_a_scan_without_a_file_says_first_that_nothing_is_kept(opened, capsys):
    assert main(["scan", "line", "1", "0", "2", "--virtual"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("nothing is kept: --csv FILE") and said[1] == "2 places"


def test_the_command_finds_a_lost_beam(opened, capsys):
    opened.truth.bump(0, 5000, 0)
    assert main(["scan", "find", "5", "--pitch", "4", "--virtual", "--camera", "2"]) == 0
    assert capsys.readouterr().out.startswith("found at x ")


def test_a_beam_that_is_not_found_is_status_1(opened, capsys):
    opened.truth.laser.blocked = True
    assert main(["scan", "find", "0", "--virtual"]) == 1
    assert capsys.readouterr().out == "not found at any of 1 places; the mount is at the start again\n"


@pytest.mark.parametrize(
    ("fault", "status", "ended"),
    [
        (CameraGone("virtual camera 1 was unplugged"), 1, "virtual camera 1 was unplugged"),
        (KeyboardInterrupt(), 130, "stopped by Ctrl-C"),
    ],
)
def test_a_scan_that_is_cut_keeps_its_rows(opened, tmp_path, capsys, fault, status, ended, monkeypatch):
    """In mid-scan the camera is unplugged, or somebody presses Ctrl-C."""
    camera, stops = opened.cameras[0], []
    stop = Mount.stop
    monkeypatch.setattr(Mount, "stop", lambda mount: (stops.append(mount), stop(mount)))

    counted = itertools.count()

    def frames(read=camera.frames):
        for frame in read():
            if next(counted) == 40:
                raise fault
            yield frame

    monkeypatch.setattr(camera, "frames", frames)
    files = tmp_path / "a.csv", tmp_path / "a.h5"
    words = ["scan", "line", "1", "0", "99", "--virtual", "--csv", str(files[0]), "--hdf5", str(files[1])]
    assert main(words) == status
    out, err = capsys.readouterr()
    rows, said = rows_of(files[0])
    assert 1 <= len(rows) < 99
    assert json.loads(said["ended"]) == ended
    assert out == f"{len(rows)} places were measured: {files[0]} and {files[1]}\n"
    assert err.startswith("mirrormount: ")
    assert "traceback" not in err.lower()
    assert stops
    with h5py.File(files[1]) as whole:
        assert len(whole["x"]) == len(rows)
        assert whole.attrs["ended"] == ended


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["raster", "3", "x", "--virtual"], "ROWS is a whole number"),
        (["raster", "3", "3", "--serpentine", "--approach", "2", "--virtual"], "--approach is of rows"),
        (["spiral", "1", "--pitch", "0", "--virtual"], "the pitch: 1 or more"),
        (["line", "0", "0", "5", "--virtual"], "a line leads somewhere"),
        (["find", "--virtual", "--camera", "3"], "the virtual table has the cameras 1 and 2"),
        (["find", "--seed", "3"], "add --virtual"),
        (["find", "--port", "virtual://", "--camera", "virtual-table://"], "give --virtual, and 1 or 2 as the camera"),
        (["find", "--virtual", "--csv", "a", "--hdf5", "a"], "cannot both be a"),
        (["find", "--virtual", "--hdf5", "no folder/a"], "no such folder"),
        (["find", "--virtual", "--csv", "no folder/a"], "No such file or directory"),
    ],
)
def test_what_cannot_be_scanned_is_refused_in_one_line(words, says, capsys):
    assert main(["scan", *words]) == 1
    err = capsys.readouterr().err
    assert says in err
    assert err.startswith("mirrormount: ")


def test_a_disk_that_is_full_leaves_whole_rows_and_is_told_by_the_files_name(opened, tmp_path, capsys):
    path = tmp_path / "a.csv"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3_000, limits[1]))
    try:
        assert main(["scan", "raster", "9", "9", "--virtual", "--csv", str(path)]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert capsys.readouterr().err.startswith(f"mirrormount: {path}: File too large")
    text = path.read_bytes()
    assert text.endswith(b"\n")
    rows = [line for line in text.decode().splitlines() if not line.startswith("#")]
    assert len(rows) > 2
    assert len({row.count(",") for row in rows}) == 1
