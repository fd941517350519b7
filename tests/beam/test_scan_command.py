"""`mirrormount scan`: what it says, what it writes, and what is left of a scan that is cut."""

import contextlib
import itertools
import json
import resource

import pytest
from scanning import rows_of

from mirrormount.cli.main import main
from mirrormount.device.mount import Mount
from mirrormount_beam.cli import scan
from mirrormount_beam.errors import CameraGone
from mirrormount_beam.scan import ScanPage
from mirrormount_sim.optics import EXPOSURE_S

h5py = pytest.importorskip("h5py")


@pytest.fixture
def opened(table, monkeypatch):
    """The command opens this table, so that a test can order its faults."""
    monkeypatch.setattr(scan, "open_table", lambda _address: table)
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


def test_a_scan_that_does_not_begin_leaves_no_part_of_an_hdf5_file(tmp_path, capsys):
    rows = tmp_path / "map.csv"
    rows.write_text("mine")
    words = ["scan", "line", "1", "0", "2", "--virtual", "--csv", str(rows), "--hdf5", str(tmp_path / "map.h5")]
    assert main(words) == 1
    assert capsys.readouterr().err == f"mirrormount: {rows}: exists; a scan is a new file\n"
    assert list(tmp_path.iterdir()) == [rows]


def test_the_part_of_a_scan_that_was_killed_is_told_before_anything_moves(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(scan, "open_table", pytest.fail)
    path, part = tmp_path / "map.h5", tmp_path / "map.h5.part"
    part.touch()
    assert main(["scan", "line", "1", "0", "2", "--virtual", "--hdf5", str(path)]) == 1
    assert capsys.readouterr().err == (
        f"mirrormount: {part}: exists; another scan writes map.h5 now, or one was cut off: then move it away\n"
    )


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
        (
            ["find", "--port", "virtual://", "--camera", "virtual-table://"],
            "a command with --virtual has both, and 1 or 2",
        ),
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


@contextlib.contextmanager
def little_room():
    """There is room for 3000 bytes of a file."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3_000, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_an_hdf5_file_for_which_there_is_no_room_is_told_before_anything_moves(opened, tmp_path, capsys):
    path = tmp_path / "a.h5"
    with little_room():
        assert main(["scan", "raster", "9", "9", "--virtual", "--hdf5", str(path)]) == 1
    assert capsys.readouterr().err == f"mirrormount: {path}: File too large\n"
    assert not opened.simulations[0].edges
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_leaves_whole_rows_and_is_told_by_the_files_name(opened, tmp_path, capsys):
    path = tmp_path / "a.csv"
    with little_room():
        assert main(["scan", "raster", "9", "9", "--virtual", "--csv", str(path)]) == 1
    assert capsys.readouterr().err.startswith(f"mirrormount: {path}: File too large")
    text = path.read_bytes()
    assert text.endswith(b"\n")
    rows = [line for line in text.decode().splitlines() if not line.startswith("#")]
    assert len(rows) > 2
    assert len({row.count(",") for row in rows}) == 1
