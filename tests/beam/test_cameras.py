"""Cameras: a fake VideoCapture with faults and settings, a server of pictures, addresses, the virtual table."""

import base64
import contextlib
import http.server
import itertools
import threading

import cv2
import numpy as np
import pytest
import scenes

from mirrormount.cli.main import main
from mirrormount.device.table_file import CameraSettings
from mirrormount.errors import BadAddress, remedy_of
from mirrormount_beam import webcams
from mirrormount_beam.camera import OF_DRIVER, Controls, Limits, Picture, Size, checked
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.cli import camera as camera_module
from mirrormount_beam.errors import (
    CameraAbsent,
    CameraBlack,
    CameraGone,
    CameraRepeats,
    CameraSettingRefused,
    CameraSizeChanged,
    CameraSlow,
)
from mirrormount_beam.recordings import open_folder
from mirrormount_beam.spot.find import find_spot
from mirrormount_beam.webcams import Webcam


def picture(number, rows=48, columns=64):
    return np.random.default_rng(number).integers(0, 200, (rows, columns)).astype(np.uint8)


class FakeCapture:
    """A VideoCapture that returns what it is fed; next() lets it return one more."""

    def __init__(self, pictures, *, properties=None, opened=True, backend="V4L2"):
        self.pictures = iter(pictures)
        self.properties = {cv2.CAP_PROP_FRAME_WIDTH: 64, cv2.CAP_PROP_FRAME_HEIGHT: 48, **(properties or {})}
        self.opened = opened
        self.backend = backend
        self.asked = []
        self.released = 0
        self.allowed = threading.Semaphore(0)

    def isOpened(self):
        return self.opened

    def getBackendName(self):
        return self.backend

    def read(self):
        self.allowed.acquire()
        image = next(self.pictures, None)
        return image is not None, image

    def get(self, what):
        return self.properties.get(what, -1)

    def set(self, what, value):
        self.asked.append((what, value))
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
    camera = Webcam(capture, "cam", first_s=0.01)
    with pytest.raises(CameraGone, match=r"no frame for 0\.01 s, after 0 frames"):
        next(camera.frames())
    capture.allowed.release()
    camera.close()


def test_a_first_frame_may_take_20_s_and_each_further_one_5(monkeypatch):
    waits = []
    capture = FakeCapture([picture(1), picture(2)])

    class Condition(threading.Condition):
        def wait_for(self, predicate, timeout=None):
            waits.append(timeout)
            capture.allowed.release()
            return super().wait_for(predicate, timeout)

    monkeypatch.setattr(webcams.threading, "Condition", Condition)
    camera = Webcam(capture, "cam")
    monkeypatch.undo()
    assert len(list(itertools.islice(camera.frames(), 2))) == 2
    assert waits == [20, 5]
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


def opened(capture, **settings):
    """The camera of a capture, closed at once; what it was asked for is in the capture."""
    camera = Webcam(capture, "cam", settings=CameraSettings(**settings))
    capture.allowed.release()
    camera.close()
    return camera


EXPOSED = {cv2.CAP_PROP_EXPOSURE: -6, cv2.CAP_PROP_GAIN: 0}


@pytest.mark.parametrize(
    ("backend", "properties"),
    [
        ("MSMF", {**EXPOSED, cv2.CAP_PROP_AUTO_EXPOSURE: 0}),
        ("DSHOW", EXPOSED),
        ("AVFOUNDATION", {**EXPOSED, cv2.CAP_PROP_AUTO_EXPOSURE: 0}),
        ("V4L2", {**EXPOSED, cv2.CAP_PROP_AUTO_EXPOSURE: 1}),
    ],
)
def test_a_fixed_exposure_is_not_touched_when_a_camera_is_opened(backend, properties):
    capture = FakeCapture([], properties=properties, backend=backend)
    camera = opened(capture)
    assert cv2.CAP_PROP_AUTO_EXPOSURE not in dict(capture.asked)
    assert camera.controls.exposure_fixed is (True if backend == "V4L2" else None)


@pytest.mark.parametrize(("backend", "manual"), [("MSMF", 0), ("DSHOW", 0), ("V4L2", 1)])
def test_an_exposure_that_is_asked_for_is_manual_in_the_words_of_each_backend(backend, manual):
    capture = FakeCapture([], properties={**EXPOSED, cv2.CAP_PROP_AUTO_EXPOSURE: 3}, backend=backend)
    camera = opened(capture, exposure=-4.0)
    asked = [each for each in capture.asked if each[0] in (cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_EXPOSURE)]
    assert asked == [(cv2.CAP_PROP_AUTO_EXPOSURE, manual), (cv2.CAP_PROP_EXPOSURE, -4)]
    assert camera.controls[:4] == (True, True, -4, OF_DRIVER)


YUYV, MJPG, Y16 = (cv2.VideoWriter.fourcc(*code) for code in ("YUYV", "MJPG", "Y16 "))


def test_settings_are_asked_for_in_the_order_form_size_exposure_gain():
    capture = FakeCapture([], properties={**EXPOSED, cv2.CAP_PROP_FOURCC: YUYV})
    camera = opened(capture, gain=3.0, exposure=-4.0, width_px=1280, height_px=720, fourcc="MJPG")
    form, size = cv2.CAP_PROP_FOURCC, [cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT]
    order = [form, *size, cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_GAIN]
    assert [what for what, _ in capture.asked if what in order] == order
    assert capture.properties[form] == MJPG
    assert camera.size == Size(1280, 720)
    assert camera.controls == Controls(True, True, -4, OF_DRIVER, 3)


class Stubborn(FakeCapture):
    """Says yes to everything, and keeps what it has."""

    def set(self, what, value):
        return True


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"exposure": 5000.0}, "cam: it does not take --exposure 5000: it has -6"),
        ({"gain": 7.0}, "cam: it does not take --gain 7: it has 0"),
        ({"width_px": 1280, "height_px": 720}, "cam: it does not take --size 1280x720: it has 64x48"),
        ({"fourcc": "MJPG"}, "cam: it does not take --fourcc MJPG: it has YUYV"),
    ],
)
def test_what_a_camera_does_not_take_is_told_with_what_it_has_and_it_is_released(settings, says):
    capture = Stubborn([], properties={**EXPOSED, cv2.CAP_PROP_FOURCC: YUYV})
    with pytest.raises(CameraSettingRefused) as caught:
        Webcam(capture, "cam", settings=CameraSettings(**settings))
    assert str(caught.value) == says
    assert capture.released == 1


def test_an_exposure_beside_an_automatic_one_that_stays_on_is_refused():
    capture = Stubborn([], properties={**EXPOSED, cv2.CAP_PROP_AUTO_EXPOSURE: 3})
    with pytest.raises(CameraSettingRefused, match="an automatic one that stays on"):
        Webcam(capture, "cam", settings=CameraSettings(exposure=-6.0))


def test_16_bits_of_a_webcam_are_kept():
    pictures = [picture(1).astype(np.uint16) * 16]
    properties = {cv2.CAP_PROP_FOURCC: YUYV, cv2.CAP_PROP_CONVERT_RGB: 1}
    capture = FakeCapture(pictures, properties=properties)
    camera = Webcam(capture, "cam", settings=CameraSettings(fourcc="Y16 "))
    capture.allowed.release(2)
    (frame,) = itertools.islice(camera.frames(), 1)
    camera.close()
    assert capture.properties[cv2.CAP_PROP_CONVERT_RGB] == 0 and capture.properties[cv2.CAP_PROP_FOURCC] == Y16
    assert frame.image.dtype == np.uint16 and np.array_equal(frame.image, pictures[0])


@pytest.mark.parametrize(
    ("platform", "words", "backend"),
    [
        ("win32", [], cv2.CAP_DSHOW),
        ("linux", [], cv2.CAP_V4L2),
        ("darwin", [], cv2.CAP_ANY),
        ("win32", ["--backend", "msmf"], cv2.CAP_MSMF),
        ("linux", ["--backend", "any"], cv2.CAP_ANY),
    ],
)
def test_a_webcam_is_opened_by_the_systems_backend_or_by_one_that_is_named(monkeypatch, platform, words, backend):
    taken = []

    def video_capture(source, number):
        taken.append((source, number))
        return FakeCapture([], opened=False)

    monkeypatch.setattr(webcams.sys, "platform", platform)
    monkeypatch.setattr(webcams.cv2, "VideoCapture", video_capture)
    assert main(["camera", "show", "--camera", "1", *words]) == 1
    assert taken == [(1, backend)]


@pytest.fixture
def captures(monkeypatch):
    """The webcams that a command opens: what each was opened by, and its capture."""
    taken = {}

    def capture(source, backend=None):
        size = {cv2.CAP_PROP_FRAME_WIDTH: 640, cv2.CAP_PROP_FRAME_HEIGHT: 480}
        taken[source] = FakeCapture([picture(1)] * 2, properties={**EXPOSED, **size, cv2.CAP_PROP_FOURCC: YUYV})
        taken[source].allowed.release(9)
        return taken[source]

    monkeypatch.setattr(webcams, "_capture", capture)
    return taken


@pytest.fixture
def own_table(tmp_path, monkeypatch):
    """A table.toml of the test."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    monkeypatch.delenv("MIRRORMOUNT_TABLE", raising=False)
    return tmp_path / "table.toml"


def test_settings_of_the_table_are_those_of_its_camera_and_a_command_may_change_them(own_table, captures, capsys):
    words = ["--size", "64x48", "--fourcc", "MJPG", "--exposure", "-5"]
    assert main(["table", "camera", "near", "3", *words]) == 0
    assert main(["table", "camera", "near", "--gain", "2", "--distance", "400"]) == 0
    assert "MJPG, 64 x 48 px, exposure -5, gain 2" in capsys.readouterr().out
    assert main(["camera", "show", "--camera", "near", "--frames", "1", "--exposure", "-4"]) == 0
    has = captures[3].properties
    assert [has[what] for what in (cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_GAIN)] == [-4, 2]
    assert [has[what] for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FOURCC)] == [64, MJPG]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("width_px = 640", "the size of a picture is its width and height"),
        ("width_px = 640.5\nheight_px = 480", "width_px is a whole number"),
        ('fourcc = "JPEGS"', "the fourcc has four characters, such as MJPG"),
        ('backend = "direct"', "the backend is v4l2, dshow, msmf, any, not 'direct'"),
        ('exposure = "long"', "exposure is a number"),
        ("settings = 1", "settings is not known: camera, distance_mm"),
    ],
)
def test_a_table_with_settings_that_no_camera_has_is_one_line(own_table, capsys, line, says):
    own_table.write_text(f'[cameras.near]\ncamera = "0"\n{line}\n')
    assert main(["table"]) == 1
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--size", "640"], "--size is width x height in pixels, such as 1280x720, not '640'"),
        (["--size", "640xhigh"], "the height of --size is a whole number"),
        (["--size", "0x0"], "the size of a picture is its width and height"),
        (["--exposure", "long"], "--exposure"),
        (["--gain", "1e9"], "--gain is out of range"),
        (["--backend", "direct"], "the backend is v4l2, dshow, msmf, any"),
        (["--gain", "2", "--virtual"], "--gain: of a webcam; leave --virtual out"),
        (["--gain", "2", "--camera", "virtual-table://"], "is no webcam: it has no gain to set"),
    ],
)
def test_settings_that_no_camera_has_are_refused_in_one_line(own_table, capsys, words, says):
    assert main(["camera", "show", *words]) == 1
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


@pytest.mark.parametrize(
    "command",
    [["camera", "scale", "show"], ["camera", "record", "run"], ["measure", "drift"], ["scan", "find"], ["panel"]],
    ids=" ".join,
)
def test_every_command_that_opens_a_camera_takes_its_settings(own_table, capsys, command):
    assert main([*command, "--camera", "1", "--gain", "2", "--virtual"]) == 1
    assert "--gain: of a webcam; leave --virtual out" in capsys.readouterr().err


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
    monkeypatch.setattr(camera_module, "open_camera", lambda _address, **_settings: camera)
    assert main(["camera", "record", str(tmp_path / "run")]) == 130
    assert capsys.readouterr().out == f"2 frames in {tmp_path / 'run'}\n"
    assert len([*open_folder(str(tmp_path / "run")).frames()]) == 2


@pytest.fixture
def plugged(tmp_path, monkeypatch):
    """plugged(index, names, places): cameras that Linux lists."""
    monkeypatch.setattr(webcams, "SYSFS", tmp_path / "sys")
    monkeypatch.setattr(webcams, "PLACES", tmp_path / "v4l")
    monkeypatch.setattr(webcams.sys, "platform", "linux")

    def plug(number, index, name, *paths):
        folder = tmp_path / "sys" / f"video{number}"
        folder.mkdir(parents=True)
        (folder / "index").write_text(f"{index}\n")
        (folder / "name").write_text(f"{name}\n")
        for path in paths:
            link = tmp_path / "v4l" / path
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(f"../../video{number}")

    return plug


def test_list_names_each_camera_that_linux_knows(plugged, capsys):
    for camera in ((0, 0, "Good Cam"), (1, 1, "Good Cam"), (2, 0, "Other Cam")):
        plugged(*camera)
    assert main(["camera", "list"]) == 0
    assert capsys.readouterr().out.splitlines() == ["0  Good Cam", "2  Other Cam"]
    with pytest.raises(CameraAbsent, match="several cameras of the name 'cam'; there is: 0 Good Cam, 2 Other Cam"):
        open_camera("cam")


def test_two_cameras_of_one_name_are_told_apart_by_where_they_are_plugged_in(plugged, tmp_path, captures, capsys):
    places = [f"by-path/pci-0000:00:14.0-usb-0:{port}:1.0-video-index0" for port in (2, 3)]
    plugged(0, 0, "Good Cam", places[0], "by-id/usb-Good_Cam_A17-video-index0")
    plugged(1, 1, "Good Cam", places[0].replace("index0", "index1"))
    plugged(2, 0, "Good Cam", places[1])
    paths = [str(tmp_path / "v4l" / place) for place in places]
    assert main(["camera", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    by_id = tmp_path / "v4l" / "by-id" / "usb-Good_Cam_A17-video-index0"
    assert lines == [f"0  Good Cam  {paths[0]}  {by_id}", f"2  Good Cam  {paths[1]}"]
    with pytest.raises(CameraAbsent) as caught:
        open_camera("Good Cam")
    assert f"these tell them apart: {paths[0]}, {paths[1]}" in str(caught.value)
    names = set()
    for address, number in ((paths[0], 0), (paths[1], 2), ("usb-0:3", 2), ("A17", 0)):
        captures.clear()
        camera = open_camera(address)
        camera.close()
        assert list(captures) == [number]
        names.add(camera.name)
    assert len(names) == 3 and all(name.startswith("Good Cam (") for name in names)  # so each has a scale of its own


def test_the_table_finds_a_camera_by_its_place(plugged, own_table, capsys):
    plugged(0, 0, "Good Cam", "by-path/pci-0000:00:14.0-usb-0:2:1.0-video-index0")
    assert main(["table", "camera", "near", "usb-0:2:1.0"]) == 0
    assert main(["table", "camera", "far", "usb-0:3:1.0"]) == 0
    out = capsys.readouterr().out
    assert "near: camera usb-0:2:1.0; " in out and "far: camera usb-0:3:1.0: NOT PLUGGED IN" in out


# ---- cameras of the network


class PictureServer(http.server.ThreadingHTTPServer):
    """Sends one JPEG after the other, as cameras of the network do, to a reader with the password."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Pictures)
        self.address = f"http://{{}}127.0.0.1:{self.server_port}/video"

    def __enter__(self):
        threading.Thread(target=self.serve_forever, args=(0.01,), daemon=True).start()
        return super().__enter__()

    def __exit__(self, *error):
        self.shutdown()
        super().__exit__(*error)


class _Pictures(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        if self.headers["Authorization"] != "Basic " + base64.b64encode(b"me:secret").decode():
            self.send_response(401)
            self.send_header("WWW-Authenticate", 'Basic realm="camera"')
            self.end_headers()
            return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
        self.end_headers()
        light = scenes.gaussian(300.3, 200.7, 12, 12)
        with contextlib.suppress(OSError):  # the reader has gone
            for seed in itertools.count():
                image = scenes.expose(8 + 150 * light, np.random.default_rng(seed))
                data = cv2.imencode(".jpg", image)[1].tobytes()
                head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                self.wfile.write(head.encode() + data + b"\r\n")

    def log_message(self, *_words):
        pass


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    with PictureServer() as opened:
        yield opened


def test_a_camera_of_the_network_is_a_camera_and_its_password_is_in_no_name(server):
    camera = open_camera(server.address.format("me:secret@") + "?user=me&pwd=secret")
    with contextlib.closing(camera):
        frames = list(itertools.islice(camera.frames(), 3))
    assert (camera.name, camera.size) == (server.address.format(""), Size(640, 480))
    assert all(abs(find_spot(frame).x - 300.3) < 0.5 for frame in frames)


def test_a_camera_of_the_network_that_refuses_is_one_line_without_the_password(server, capfd):
    assert main(["camera", "show", "--camera", server.address.format("me:wrong@")]) == 1
    err = capfd.readouterr().err
    assert "cannot be opened: a browser shows whether" in err and "wrong" not in err and err.count("\n") == 1


def test_a_mistyped_scheme_does_not_show_the_password():
    with pytest.raises(CameraAbsent, match=r"no camera, file or folder of the name 'htp://host/video'"):
        open_camera("htp://me:secret@host/video")


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("http://me:secret@host:81/video", "http://host:81/video"),
        ("rtsp://host/stream?user=me&pwd=secret", "rtsp://host/stream"),
        ("rtsp://host/user=me_password=secret_channel=1", "rtsp://host/…"),
        ("http://me:sec/ret@host/video", "http://…"),
        ("HTTP://me:sec?ret@host/video", "HTTP://…"),
        ("http://me:s@cret@host", "http://…"),
        ("http://host/?mail=a@b&pwd=secret", "http://…"),
    ],
)
def test_no_password_of_an_address_is_shown(own_table, capsys, address, shown):
    assert main(["table", "camera", "near", address]) == 0
    assert f"near: camera {shown}; no target yet\n" in capsys.readouterr().out


def test_a_number_of_frames_below_one_is_refused(capsys):
    assert main(["camera", "show", "--camera", "virtual-table://", "--frames", "0"]) == 1
    assert "--frames is at least 1" in capsys.readouterr().err
