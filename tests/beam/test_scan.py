"""Scans on the virtual table: the pattern's places, the signal at each, and the files."""

import errno
import itertools
import json
import math
import os

import cv2
import numpy as np
import pytest
from scanning import rows_of

from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, CannotWrite, MoveEnded
from mirrormount.transport.link import Link
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.scan import (
    FARTHEST,
    UNKNOWN,
    CsvFile,
    Hdf5File,
    ScanPage,
    Signal,
    find,
    grey_signal,
    line,
    metadata,
    of_camera,
    raster,
    scan,
    spiral,
    spot_signal,
)
from mirrormount_beam.spot.find import find_spot

h5py = pytest.importorskip("h5py")


@pytest.fixture
def mount(table):
    with Mount(Link(table.ports[0])) as opened:
        yield opened


def measured(pattern):
    return [(place.x, place.y) for place in pattern.places if place.measured]


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


def test_a_signal_that_is_no_number_is_refused_in_words(mount):
    with pytest.raises(BadValue, match=r"one number at each place, not \(1, 2\); for several of them give a Signal"):
        list(scan(mount, line(1, 0, 1), lambda _mount: (1, 2)))


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
    file, whole = CsvFile(tmp_path / "a.csv", about, signal), Hdf5File(tmp_path / "a.h5", about, signal, 3)
    samples = []
    for sample in scan(mount, pattern, signal):
        file.add(sample)
        samples.append(sample)
        assert len(rows_of(tmp_path / "a.csv")[0]) == len(samples)  # before the file is closed
    file.end("complete")
    whole.end(samples, "complete")
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
    whole = Hdf5File(path, metadata(mount, line(1, 0, 1), signal), signal, 1)
    monkeypatch.setattr("mirrormount_beam.scan.os.fsync", full)
    with pytest.raises(CannotWrite, match="No space left"):
        whole.end([], "complete")
    assert list(tmp_path.iterdir()) == []


def test_of_two_scans_under_way_only_one_writes_an_hdf5_file(mount, tmp_path):
    signal, path = Signal.of(lambda _mount: 1.0), tmp_path / "a.h5"
    about = metadata(mount, line(1, 0, 1), signal)
    first = Hdf5File(path, about, signal, 1)
    with pytest.raises(CannotWrite, match=r"a\.h5\.part: exists; another scan writes a\.h5 now"):
        Hdf5File(path, about, signal, 1)
    first.end([], "complete")
    with h5py.File(path) as whole:
        assert whole.attrs["ended"] == "complete"


def test_a_file_that_comes_in_mid_scan_is_not_replaced_and_the_scan_is_kept_beside_it(mount, tmp_path):
    signal, path = Signal.of(lambda _mount: 1.0), tmp_path / "a.h5"
    whole = Hdf5File(path, metadata(mount, line(1, 0, 1), signal), signal, 1)
    path.write_text("mine")
    with pytest.raises(CannotWrite, match=r"a\.h5: File exists; the scan is in .*a\.h5\.part"):
        whole.end([], "complete")
    assert path.read_text() == "mine"
    with h5py.File(tmp_path / "a.h5.part") as kept:
        assert kept.attrs["ended"] == "complete"


def test_a_scan_that_cannot_get_its_name_stays_in_the_part_and_leaves_no_empty_file(mount, tmp_path, monkeypatch):
    def full(_part, _path):
        raise OSError(errno.EIO, "Input/output error")

    signal, path = Signal.of(lambda _mount: 1.0), tmp_path / "a.h5"
    whole = Hdf5File(path, metadata(mount, line(1, 0, 1), signal), signal, 1)
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(CannotWrite, match=r"a\.h5: Input/output error; the scan is in .*a\.h5\.part"):
        whole.end([], "complete")
    assert not path.exists() and (tmp_path / "a.h5.part").exists()


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
        "camera_selection": "channel automatic",
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
