"""Cameras: OpenCV's VideoCapture on real files, a fake one with faults, folders, recordings, the virtual table."""

import itertools
import json
import threading

import cv2
import numpy as np
import pytest
import scenes

from mirrormount.cli.main import main
from mirrormount.errors import BadAddress, CannotWrite, remedy_of
from mirrormount_beam import cameras
from mirrormount_beam.camera import OF_DRIVER, Controls, Image, Limits, Picture, Size, checked
from mirrormount_beam.cameras import Webcam, open_camera, open_folder, record
from mirrormount_beam.cli import camera as camera_module
from mirrormount_beam.cli.camera import line
from mirrormount_beam.errors import (
    CameraAbsent,
    CameraBlack,
    CameraError,
    CameraGone,
    CameraRepeats,
    CameraSizeChanged,
    CameraSlow,
)
from mirrormount_beam.spot.find import Spot, find_spot


def picture(number, rows=48, columns=64):
    return np.random.default_rng(number).integers(0, 200, (rows, columns)).astype(np.uint8)


class FakeCapture:
    """A VideoCapture that returns what it is fed; next() lets it return one more."""

    def __init__(self, pictures, *, properties=None, opened=True):
        self.pictures = iter(pictures)
        self.properties = {cv2.CAP_PROP_FRAME_WIDTH: 64, cv2.CAP_PROP_FRAME_HEIGHT: 48, **(properties or {})}
        self.opened = opened
        self.released = 0
        self.allowed = threading.Semaphore(0)

    def isOpened(self):
        return self.opened

    def read(self):
        self.allowed.acquire()
        image = next(self.pictures, None)
        return image is not None, image

    def get(self, what):
        return self.properties.get(what, -1)

    def set(self, what, value):
        if what in self.properties:
            self.properties[what] = value
            return True
        return False

    def release(self):
        self.released += 1


def frames_of(pictures, interval_s=0.03):
    shown = (Picture(image, at * interval_s) for at, image in enumerate(pictures))
    return checked(shown, "cam", None, Limits())


def test_a_frame_is_fresh_and_its_number_counts_those_that_were_passed_over():
    capture = FakeCapture([picture(number) for number in range(5)])
    camera = Webcam(capture, "cam")
    frames = camera.frames()
    capture.allowed.release(1)
    first = next(frames)
    capture.allowed.release(4 + 1)
    camera._thread.join()
    second = next(frames)
    assert (first.number, second.number) == (0, 4)
    assert np.array_equal(second.image, picture(4))
    assert first.time_s <= second.time_s <= camera.monotonic()
    with pytest.raises(CameraGone, match="it has ended or was unplugged, after 5 frames"):
        next(frames)
    camera.close()
    assert capture.released == 1


def test_a_camera_that_is_silent_is_gone():
    capture = FakeCapture([])
    camera = Webcam(capture, "cam", silent_s=0.01)
    with pytest.raises(CameraGone, match=r"no frame for 0\.01 s"):
        next(camera.frames())
    capture.allowed.release()
    camera.close()


def test_a_camera_that_does_not_open_is_absent_and_released():
    capture = FakeCapture([], opened=False)
    with pytest.raises(CameraAbsent, match="cannot be opened: `mirrormount camera list`"):
        Webcam(capture, "cam")
    assert capture.released == 1


@pytest.mark.parametrize(
    ("properties", "controls"),
    [
        (
            {cv2.CAP_PROP_AUTO_EXPOSURE: 3, cv2.CAP_PROP_EXPOSURE: 157, cv2.CAP_PROP_GAIN: 10},
            Controls(True, True, 157, OF_DRIVER, 10),
        ),
        ({cv2.CAP_PROP_EXPOSURE: -6, cv2.CAP_PROP_GAIN: -1}, Controls(None, None, -6, OF_DRIVER, None)),
        ({cv2.CAP_PROP_EXPOSURE: 0}, Controls(None, None)),
        ({}, Controls(None, None)),
    ],
)
def test_controls_that_cannot_be_fixed_or_are_not_known_are_told(properties, controls):
    capture = FakeCapture([], properties=properties)
    camera = Webcam(capture, "cam")
    assert camera.controls == controls
    capture.allowed.release()
    camera.close()


@pytest.mark.parametrize(
    ("kind", "pictures", "interval_s"),
    [
        (CameraBlack, [np.zeros((48, 64), np.uint8)] * 20, 0.03),
        (CameraRepeats, [picture(1)] * 60, 0.03),
        (CameraSizeChanged, [picture(1), picture(2), picture(3, 40, 60)], 0.03),
        (CameraSlow, [picture(number) for number in range(20)], 5.0),
    ],
)
def test_a_fault_ends_the_frames_with_one_line_and_has_a_remedy(kind, pictures, interval_s):
    with pytest.raises(kind) as caught:
        list(frames_of(pictures, interval_s))
    assert str(caught.value).startswith("cam: ") and "\n" not in str(caught.value)
    assert remedy_of(kind.__name__).remedy


def test_a_repeated_and_a_late_frame_are_told():
    images = [picture(number) for number in range(12)]
    images[4] = images[3]
    times = [0.03 * at + (0.1 if at >= 9 else 0) for at in range(12)]
    frames = list(checked(map(Picture, images, times), "cam", None, Limits()))
    assert [frame.number for frame in frames if frame.repeated] == [4]
    assert [frame.number for frame in frames if frame.late] == [9]
    assert not frames[0].image.flags.writeable


def test_a_beam_that_is_blocked_later_is_no_black_camera():
    images = [picture(number) for number in range(12)] + [np.zeros((48, 64), np.uint8)] * 50
    assert len(list(frames_of(images))) == 62


def test_opencv_reads_a_video_file_until_it_ends(tmp_path):
    path = tmp_path / "beam.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (640, 480))
    assert writer.isOpened()
    image = scenes.expose(8 + 150 * scenes.gaussian(300.3, 200.7, 12, 12), np.random.default_rng(1))
    for _ in range(5):
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    camera = open_camera(str(path))
    seen = []
    with pytest.raises(CameraGone, match="after 5 frames"):
        seen.extend(camera.frames())
    camera.close()
    assert camera.size == Size(640, 480)
    spots = [find_spot(frame) for frame in seen]
    assert spots and all(abs(spot.x - 300.3) < 0.2 and abs(spot.y - 200.7) < 0.2 for spot in spots)


def test_a_recording_gives_back_frames_times_and_marks(tmp_path):
    table = open_camera("virtual-table://?mounts=1&cameras=1")
    kept = list(itertools.islice(table.frames(), 3))
    assert record(table, tmp_path / "run", iter(kept)) == 3
    table.close()
    again = open_camera(str(tmp_path / "run"))
    read = list(again.frames())
    assert (again.name, again.size, again.controls) == (table.name, table.size, table.controls)
    assert [(f.time_s, f.number, f.repeated, f.late) for f in read] == [
        (f.time_s, f.number, f.repeated, f.late) for f in kept
    ]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(read, kept, strict=True))


def test_a_recording_never_goes_into_a_folder_that_exists(tmp_path):
    table = open_camera("virtual-table://?mounts=1&cameras=1")
    with pytest.raises(CannotWrite, match="exists"):
        record(table, tmp_path, table.frames())
    table.close()


def test_what_was_recorded_before_a_fault_is_kept(tmp_path):
    def failing():
        yield from frames_of([picture(1), picture(2)])
        raise CameraGone("cam: unplugged")

    camera = open_camera("virtual-table://?mounts=1&cameras=1")
    camera.close()
    with pytest.raises(CameraGone):
        record(camera, tmp_path / "run", failing())
    assert len((tmp_path / "run" / "frames.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize(
    "line",
    [
        b"{",
        b'{"file": "../x.png", "time_s": 0, "number": 0, "repeated": 0, "late": 0}',
        b'{"file": "x.png"}',
        b'{"file": "x.png", "time_s": 0, "number": 1e400, "repeated": 0, "late": 0}',
        b'{"file": "\xff.png", "time_s": 0, "number": 0, "repeated": 0, "late": 0}',
    ],
)
def test_a_damaged_recording_is_one_line(tmp_path, line):
    (tmp_path / "camera.json").write_text(json.dumps({"name": "cam", "width": 64, "height": 48}))
    (tmp_path / "frames.jsonl").write_bytes(line + b"\n")
    with pytest.raises(CameraError, match="line 1"):
        list(open_camera(str(tmp_path)).frames())


def test_a_recording_of_pictures_without_end_is_refused(tmp_path):
    (tmp_path / "camera.json").write_text('{"name": "cam", "width": 1e400, "height": 48}')
    (tmp_path / "frames.jsonl").touch()
    with pytest.raises(CameraError, match=r"camera\.json: not the head of a recording"):
        open_camera(str(tmp_path))


def test_a_folder_of_pictures_is_a_camera(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture(number))
    camera = open_camera(str(tmp_path))
    assert [frame.number for frame in camera.frames()] == [0, 1, 2]
    assert camera.size == Size(64, 48)


@pytest.mark.parametrize(
    ("address", "kind"),
    [
        ("", BadAddress),
        ("no such camera", CameraAbsent),
        ("99999999999", CameraAbsent),
        ("9" * 5000, CameraAbsent),
        ("virtual-table://?mounts=1&cameras=1#2", CameraAbsent),
        ("virtual-table://#x", BadAddress),
        ("virtual-table://#" + "9" * 5000, BadAddress),
    ],
)
def test_a_camera_that_is_not_there_is_refused(address, kind):
    with pytest.raises(kind):
        open_camera(address)


def test_show_prints_a_line_for_each_frame(capsys):
    assert main(["camera", "show", "--camera", "virtual-table://?mounts=1&cameras=1", "--frames", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert all(" ± " in line and "threshold" in line for line in lines)


def test_a_weak_ghost_is_not_told_as_one_of_0_percent():
    spot = Spot(320.0, 240.0, 0.1, 0.1, 12.0, 12.0, 178.0, 8.0, 0, 600.0, ghost=0.004)
    assert "ghost 0.4%" in line(Image(np.zeros((480, 640), np.uint8), 0.0, 0), spot)


def test_the_virtual_camera_is_that_of_measure_and_scan_with_the_same_profile_and_seed(capsys):
    lines = []
    for camera in (
        ["--camera", "virtual-table://?profile=rough&seed=5&mounts=1&cameras=2#2"],
        ["--virtual", "--profile", "rough", "--seed", "5", "--camera", "2"],
    ):
        assert main(["camera", "show", *camera, "--frames", "2"]) == 0
        lines.append(capsys.readouterr().out)
    assert lines[0] == lines[1]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["show", "--virtual", "--camera", "3"], "the virtual table has the cameras 1 and 2, not 3"),
        (["record", "run", "--virtual", "--camera", "far"], "--camera with --virtual is a whole number"),
        (["show", "--seed", "4"], "add --virtual"),
    ],
)
def test_a_virtual_camera_that_is_not_there_is_refused_in_one_line(words, says, capsys):
    assert main(["camera", *words]) == 1
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


def test_record_writes_a_recording(tmp_path, capsys):
    folder = tmp_path / "run"
    address = "virtual-table://?mounts=1&cameras=1"
    assert main(["camera", "record", str(folder), "--camera", address, "--frames", "2"]) == 0
    assert capsys.readouterr().out == f"2 frames in {folder}\n"


def test_record_says_at_ctrl_c_how_many_frames_there_are(tmp_path, capsys, monkeypatch):
    camera = open_camera("virtual-table://?mounts=1&cameras=1")
    pictures = camera.frames()

    def interrupted():
        yield next(pictures)
        yield next(pictures)
        raise KeyboardInterrupt

    monkeypatch.setattr(camera, "frames", interrupted)
    monkeypatch.setattr(camera_module, "open_camera", lambda _address: camera)
    assert main(["camera", "record", str(tmp_path / "run")]) == 130
    assert capsys.readouterr().out == f"2 frames in {tmp_path / 'run'}\n"
    assert len([*open_folder(str(tmp_path / "run")).frames()]) == 2


def test_list_names_each_camera_that_linux_knows(tmp_path, capsys, monkeypatch):
    for number, index, name in ((0, "0", "Good Cam"), (1, "1", "Good Cam"), (2, "0", "Other Cam")):
        folder = tmp_path / f"video{number}"
        folder.mkdir()
        (folder / "index").write_text(index + "\n")
        (folder / "name").write_text(name + "\n")
    monkeypatch.setattr(cameras, "SYSFS", tmp_path)
    monkeypatch.setattr(cameras.sys, "platform", "linux")
    assert main(["camera", "list"]) == 0
    assert capsys.readouterr().out.splitlines() == ["0  Good Cam", "2  Other Cam"]
    with pytest.raises(CameraAbsent, match="several cameras of the name 'cam'; there is: 0 Good Cam, 2 Other Cam"):
        open_camera("cam")


def test_a_number_of_frames_below_one_is_refused(capsys):
    assert main(["camera", "show", "--camera", "virtual-table://", "--frames", "0"]) == 1
    assert "--frames is at least 1" in capsys.readouterr().err
