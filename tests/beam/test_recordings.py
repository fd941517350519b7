"""Files as cameras: folders of pictures, stacks, videos and recordings, of 8 and of 16 bits."""

import base64
import itertools
import json
import re
from datetime import UTC, datetime

import cv2
import numpy as np
import pytest

import mirrormount_beam
from mirrormount.cli.main import main
from mirrormount.device.table_file import CameraSettings
from mirrormount.errors import BadValue, CannotWrite
from mirrormount_beam.camera import Image, Size
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.errors import CameraAbsent, CameraError, CameraGone
from mirrormount_beam.estimates import Result
from mirrormount_beam.live import LiveView
from mirrormount_beam.recordings import record
from mirrormount_beam.report import Origin, write_page
from mirrormount_beam.scale import Optics
from mirrormount_beam.spot.find import find_spot


def picture(number, rows=48, columns=64):
    return np.random.default_rng(number).integers(0, 200, (rows, columns)).astype(np.uint8)


def spot_at(x, *, peak=180.0, kind=np.uint8):
    """A spot in a picture of 320 x 240 pixels, with a little noise."""
    down, along = np.mgrid[:240, :320].astype(float)
    light = peak * (0.05 + np.exp(-((along - x) ** 2 + (down - 120) ** 2) / 128))
    return np.rint(light + np.random.default_rng(round(x)).normal(0, peak / 200, light.shape)).astype(kind)


def write_video(path, pictures, rate_hz=25, code="MJPG"):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), rate_hz, pictures[0].shape[::-1])
    assert writer.isOpened()
    for image in pictures:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()


# ---- recordings


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
        yield from (Image(picture(number), number / 30, number) for number in (0, 1))
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


def test_a_camera_of_files_is_asked_for_the_spot_of_each_picture_until_their_end(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), spot_at(100 + number))
    with mirrormount_beam.SpotCamera.open(str(tmp_path)) as camera:
        spots = [camera.spot() for _ in range(3)]
        assert [spot.x for spot in spots] == pytest.approx([100, 101, 102], abs=0.5)
        with pytest.raises(CameraGone, match="no more frames"):
            camera.spot()


def test_the_packages_names_are_listed_and_there():
    assert {"find_spot", "SpotCamera", "open_camera", "Table"} <= set(dir(mirrormount_beam))
    assert all(getattr(mirrormount_beam, name).__name__ == name for name in mirrormount_beam.__all__)


# ---- videos


@pytest.mark.parametrize(("name", "code"), [("beam.avi", "MJPG"), ("beam.mkv", "MJPG"), ("beam.mp4", "mp4v")])
def test_a_video_shows_every_frame_once_with_its_own_time(tmp_path, name, code):
    write_video(tmp_path / name, [spot_at(100 + number) for number in range(60)], code=code)
    camera = open_camera(str(tmp_path / name))
    seen = []
    for frame in camera.frames():
        assert camera.monotonic() == frame.time_s
        seen.append((frame.number, frame.time_s - seen[0][1] if seen else frame.time_s, find_spot(frame)))
    assert (camera.name, camera.size) == (name, Size(320, 240))
    assert [number for number, _, _ in seen] == list(range(60))
    assert [time_s for _, time_s, _ in seen[1:]] == pytest.approx([number / 25 for number in range(1, 60)])
    assert [spot.x for _, _, spot in seen] == pytest.approx([100 + number for number in range(60)], abs=0.5)


@pytest.mark.parametrize("name", ["beam.avi", "beam.mkv"])
def test_a_video_that_was_cut_off_says_how_much_is_left(tmp_path, name, caplog):
    write_video(tmp_path / name, [spot_at(100 + number) for number in range(20)])
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    count = len(list(open_camera(str(tmp_path / name)).frames()))
    assert 0 < count < 20
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / name}: damaged: it ends after {count} of 20 frames"
    ]


def test_a_video_can_be_seen_again(tmp_path):
    write_video(tmp_path / "beam.avi", [picture(number) for number in range(5)])
    camera = open_camera(str(tmp_path / "beam.avi"))
    assert [len(list(camera.frames())) for _ in range(2)] == [5, 5]


@pytest.mark.parametrize("content", [b"hello", b"\0\0\0\x20ftypisom\0\0\2\0isomiso2avc1mp41\0\0\0\x08free"])
def test_a_file_that_is_no_video_is_told_in_one_line(tmp_path, capfd, content):
    (tmp_path / "beam.mp4").write_bytes(content)
    assert main(["camera", "show", "--camera", str(tmp_path / "beam.mp4")]) == 1
    err = capfd.readouterr().err
    assert "beam.mp4: no video, and no picture, that OpenCV can read" in err and err.count("\n") == 1


# ---- folders and stacks


def test_pictures_are_in_the_order_in_which_a_person_counts(tmp_path):
    for number in range(1, 13):
        cv2.imwrite(str(tmp_path / f"frame{number}.png"), picture(number))
    frames = list(open_camera(str(tmp_path)).frames())
    assert all(np.array_equal(frame.image, picture(number)) for number, frame in enumerate(frames, 1))
    assert len(frames) == 12


@pytest.mark.parametrize("name", ["stack.tif", "stack.npy"])
def test_each_page_of_a_stack_is_a_frame_whether_its_file_or_its_folder_is_named(tmp_path, name):
    pages = [spot_at(100 + number, peak=3000, kind=np.uint16) for number in range(12)]
    if name.endswith(".tif"):
        assert cv2.imwritemulti(str(tmp_path / name), pages)
    else:
        np.save(tmp_path / name, pages)
    for address in (tmp_path, tmp_path / name):
        frames = list(open_camera(str(address)).frames())
        assert [frame.number for frame in frames] == list(range(12))
        assert [frame.time_s for frame in frames] == pytest.approx([number / 30 for number in range(12)])
        assert all(np.array_equal(frame.image, page) for frame, page in zip(frames, pages, strict=True))


@pytest.mark.parametrize("name", ["one.png", "one.tif", "one.npy", "one.csv", "one.PNG"])
def test_a_file_with_one_picture_is_a_camera_of_one_frame(tmp_path, name):
    path = tmp_path / name
    if name.endswith("npy"):
        np.save(path, picture(1))
    elif name.endswith("csv"):
        np.savetxt(path, picture(1), fmt="%d", delimiter=",")
    else:
        cv2.imwrite(str(path), picture(1))
    camera = open_camera(str(path))
    (frame,) = camera.frames()
    assert camera.name == name and np.array_equal(frame.image, picture(1))


@pytest.mark.parametrize("kind", [np.int16, np.int32, np.float32, np.float64])
def test_a_tiff_of_other_numbers_is_read_as_16_bits(tmp_path, kind):
    cv2.imwrite(str(tmp_path / "one.tif"), spot_at(150, peak=3000, kind=kind))
    (frame,) = open_camera(str(tmp_path)).frames()
    assert frame.image.dtype == np.uint16 and np.array_equal(frame.image, spot_at(150, peak=3000, kind=np.uint16))


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        (np.linspace(0.05, 0.95, 48 * 64).reshape(48, 64), "float64, 0.05 … 0.95"),
        (spot_at(150, kind=np.float64) - 50, "float64, -"),
        (spot_at(150, peak=100_000, kind=np.int64), "int64, "),
        (np.full((48, 64), np.nan), "nan"),
        (np.zeros((48, 64), bool), "bool of shape"),
        (np.zeros((48, 64), complex), "complex128 of shape"),
    ],
)
def test_numbers_that_are_no_grey_values_are_told_with_their_range(tmp_path, numbers, says):
    np.save(tmp_path / "one.npy", numbers)
    with pytest.raises(CameraError, match=r"one\.npy: ") as caught:
        open_camera(str(tmp_path / "one.npy"))
    assert says in str(caught.value) and "remove" not in str(caught.value)


def test_a_tiff_that_opencv_cannot_read_is_told_with_what_to_do(tmp_path, capfd):
    cv2.imwrite(str(tmp_path / "one.tif"), picture(1).astype(np.int32), [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    data = (tmp_path / "one.tif").read_bytes()
    at = data.index(b"\x53\x01\x03\x00\x01\x00\x00\x00\x02\x00")  # the tag SampleFormat: with sign
    (tmp_path / "one.tif").write_bytes(data[: at + 8] + b"\x01" + data[at + 9 :])  # without
    with pytest.raises(CameraError, match=r"32 bits without sign.*Save it with 16 bits, or as \.npy"):
        open_camera(str(tmp_path))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("one.npy", b"no array", "no array of NumPy"),
        ("one.npy", b"", "no array of NumPy"),
        ("one.csv", b"x,y\n1,2\n", "no table of numbers"),
        ("one.csv", b"", "it is empty"),
        ("one.csv", b"\xff\xfe\x00", "no table of numbers"),
        ("one.png", b"no picture", "it is no picture, or damaged"),
    ],
)
def test_a_damaged_file_is_told_in_one_line(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CameraError) as caught:
        open_camera(str(tmp_path / name))
    assert says in str(caught.value) and name in str(caught.value) and "\n" not in str(caught.value)


def test_an_array_that_holds_python_objects_is_not_unpickled(tmp_path):
    np.save(tmp_path / "one.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(CameraError, match=r"it is no array of NumPy: .*Python objects"):
        open_camera(str(tmp_path))


@pytest.mark.parametrize("comma", [",", ";", "\t", " "])
def test_numbers_of_a_spreadsheet_are_a_picture(tmp_path, comma):
    rows = [comma.join(map(str, row)) + comma for row in spot_at(150, peak=3000, kind=np.uint16)]
    (tmp_path / "one.csv").write_text("\n".join(rows))
    (frame,) = open_camera(str(tmp_path)).frames()
    assert np.array_equal(frame.image, spot_at(150, peak=3000, kind=np.uint16))


def test_what_is_left_out_of_a_folder_is_named_once(tmp_path, caplog):
    cv2.imwrite(str(tmp_path / "one.png"), picture(1))
    for name in ("notes.txt", "log.csv", "Thumbs.db", ".hidden"):
        (tmp_path / name).touch()
    for _ in range(2):
        assert len(list(open_camera(str(tmp_path)).frames())) == 1
    (told,) = [record.getMessage() for record in caplog.records]
    assert told.endswith("left out, for they are no pictures of this folder: log.csv, notes.txt")


def test_a_folder_without_pictures_says_which_there_may_be(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(CameraAbsent, match=r"no pictures in it .*\.npy.*\.png.*\.tif"):
        open_camera(str(tmp_path))


def test_a_stack_may_be_the_picture_without_the_beam(tmp_path, capsys):
    dark = np.random.default_rng(1).normal(8, 1, (4, 240, 320)).clip(0).astype(np.uint8)
    dark[:, 100, 150] = 250
    np.save(tmp_path / "dark.npy", dark)
    cv2.imwrite(str(tmp_path / "one.png"), spot_at(150))
    words = ["--camera", str(tmp_path / "one.png"), "--dark", str(tmp_path / "dark.npy")]
    assert main(["camera", "show", *words]) == 0
    assert float(capsys.readouterr().out.split()[2]) == pytest.approx(150, abs=0.2)


def test_a_file_has_no_exposure_to_set(tmp_path):
    cv2.imwrite(str(tmp_path / "one.png"), picture(1))
    with pytest.raises(BadValue, match=r"is no webcam: it has no exposure to set"):
        open_camera(str(tmp_path), settings=CameraSettings(exposure=5.0))


# ---- 16 bits


@pytest.mark.parametrize("peak", [700, 3000, 60_000])
def test_10_12_and_16_bits_are_kept_in_a_folder_and_in_a_recording(tmp_path, peak):
    pages = [spot_at(100 + number, peak=peak, kind=np.uint16) for number in range(3)]
    (tmp_path / "in").mkdir()
    for number, page in enumerate(pages):
        cv2.imwrite(str(tmp_path / "in" / f"{number}.png"), page)
    camera = open_camera(str(tmp_path / "in"))
    frames = list(camera.frames())
    assert record(camera, tmp_path / "out", iter(frames)) == 3
    again = list(open_camera(str(tmp_path / "out")).frames())
    for page, frame, recorded in zip(pages, frames, again, strict=True):
        assert frame.image.dtype == recorded.image.dtype == np.uint16
        assert np.array_equal(frame.image, page) and np.array_equal(recorded.image, page)
        assert find_spot(recorded).peak == pytest.approx(peak, rel=0.05)


def test_a_page_shows_12_bits_bright_and_does_not_flicker_when_the_light_becomes_less():
    view = LiveView("cam")

    def shown(peak):
        view.show(Image(spot_at(150, peak=peak, kind=np.uint16), 0.0, 0), find_spot(spot_at(150)), 0.0)
        return int(cv2.imdecode(np.frombuffer(view.jpeg(view.last), np.uint8), cv2.IMREAD_UNCHANGED).max())

    assert shown(3000) == pytest.approx(3000 * 1.05 / 4095 * 255, abs=12)
    assert shown(900) == pytest.approx(900 * 1.05 / 4095 * 255, abs=12)


def test_a_spreadsheet_of_8_bits_tells_what_is_saturated(tmp_path):
    np.savetxt(tmp_path / "one.csv", np.minimum(spot_at(150, peak=260, kind=int), 255), fmt="%d", delimiter=",")
    (frame,) = open_camera(str(tmp_path)).frames()
    assert find_spot(frame).saturated


def test_a_report_shows_the_last_picture_of_12_bits_bright(tmp_path):
    image = spot_at(150, peak=3000, kind=np.uint16)
    origin = Origin(datetime(2026, 11, 23, tzinfo=UTC), "0.3", "a board", "a camera", {}, Optics())
    write_page(tmp_path / "report.html", Result("backlash"), origin, (image, find_spot(image)))
    data = re.search('data:image/png;base64,([^"]+)', (tmp_path / "report.html").read_text())[1]
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.dtype == np.uint8 and shown[123, 153, 0] > 150
