"""Cameras of GenICam: the simulated ones of Viky, a GenTL producer that comes with the package genicam."""

import contextlib
import importlib.util
import itertools
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mirrormount.cli.main import main
from mirrormount.device.table_file import CameraSettings
from mirrormount.errors import ExtraMissing
from mirrormount_beam import genicam
from mirrormount_beam.camera import Controls, Size
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.errors import CameraAbsent, CameraError, CameraSettingRefused
from mirrormount_beam.webcams import Webcam

needs_viky = pytest.mark.skipif(
    importlib.util.find_spec("harvesters") is None, reason="Harvesters is not installed (extra genicam)"
)


@pytest.fixture
def viky(monkeypatch):
    """The producer; it has the cameras red, green and blue, with serial numbers 0, 1 and 2."""
    folder = Path(importlib.util.find_spec("genicam").origin).parent
    monkeypatch.setenv(genicam.PRODUCERS, str(folder))


@needs_viky
def test_list_shows_cameras_of_genicam_with_their_addresses(viky, capsys):
    assert main(["camera", "list"]) == 0
    assert "genicam://VikyTL_DEV_red  Viky 0\n" in capsys.readouterr().out


@pytest.fixture
def grey(viky, monkeypatch):
    """The maker's program has set grey pictures: in colours the red background is as bright as the white ball."""

    def set_mono(self, _name):
        self._nodes.PixelFormat.value = "Mono8"

    monkeypatch.setattr(genicam.GenicamCapture, "check_format", set_mono)


@needs_viky
def test_an_open_camera_of_genicam_leaves_ctrl_c_to_the_program(grey):
    before = signal.getsignal(signal.SIGINT)
    with contextlib.closing(open_camera("genicam://red")):
        assert signal.getsignal(signal.SIGINT) is before
    assert signal.getsignal(signal.SIGINT) is before


@needs_viky
def test_a_camera_of_genicam_gives_fresh_images_of_the_size_that_was_asked_for(grey):
    camera = open_camera("genicam://red", settings=CameraSettings(width_px=320, height_px=200))
    with contextlib.closing(camera):
        frames = list(itertools.islice(camera.frames(), 5))
    assert (camera.name, camera.size) == ("Viky 0", Size(320, 200))
    assert all(frame.image.shape == (200, 320) and frame.image.dtype == np.uint8 for frame in frames)
    assert len({frame.number for frame in frames}) == 5
    assert not np.array_equal(frames[0].image, frames[-1].image)  # a ball moves


@needs_viky
def test_a_camera_of_genicam_can_be_opened_again(viky):
    for _ in range(2):
        with contextlib.closing(open_camera("genicam://Viky 1")) as camera:
            assert next(camera.frames()).image.shape == (400, 400)


@needs_viky
@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"width_px": 50, "height_px": 50}, "Viky 0: it does not take --size 50x50: it has 400x400"),
        ({"exposure": 100.0}, "Viky 0: it does not take --exposure 100: it has none to set"),
    ],
)
def test_what_a_camera_of_genicam_does_not_take_is_told(viky, settings, says):
    with pytest.raises(CameraSettingRefused) as caught:
        open_camera("genicam://red", settings=CameraSettings(**settings))
    assert str(caught.value) == says


@needs_viky
@pytest.mark.parametrize(("part", "says"), [("", "several cameras"), ("yellow", "no camera")])
def test_a_name_that_is_not_one_camera_says_which_there_are(viky, part, says):
    with pytest.raises(CameraAbsent, match=f"{says} of GenICam .*there is: VikyTL_DEV_red Viky 0, "):
        open_camera(f"genicam://{part}")


@needs_viky
def test_without_a_producer_the_makers_driver_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv(genicam.PRODUCERS, str(tmp_path))
    with pytest.raises(CameraAbsent, match="install the camera maker's driver"):
        open_camera("genicam://")


def test_without_harvesters_the_extra_is_named_and_the_list_goes_on(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    monkeypatch.setitem(sys.modules, "harvesters", None)
    with pytest.raises(ExtraMissing, match=r"harvesters.*\[genicam\]"):
        open_camera("genicam://red")
    assert list(genicam.listed()) == []


def camera_with(**nodes):
    """A capture of a camera with these nodes: what Viky does not have."""
    nodes = {name: SimpleNamespace(value=value) for name, value in nodes.items()}
    acquirer = SimpleNamespace(remote_device=SimpleNamespace(node_map=SimpleNamespace(**nodes)), destroy=lambda: None)
    return genicam.GenicamCapture(acquirer, contextlib.ExitStack()), nodes


def test_an_exposure_and_a_gain_are_those_of_the_standard():
    capture, nodes = camera_with(Width=640, Height=480, ExposureAuto="Continuous", ExposureTime=5000.0, Gain=3.0)
    camera = Webcam(capture, "cam", settings=CameraSettings(exposure=250.0, gain=1.5))
    camera.close()
    assert (nodes["ExposureAuto"].value, nodes["ExposureTime"].value, nodes["Gain"].value) == ("Off", 250, 1.5)
    assert camera.controls == Controls(True, True, 250, "number of the driver", 1.5)
    assert (capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FOCUS)) == (640, -1)


def test_pictures_of_a_colour_filter_are_refused_with_what_the_camera_has():
    capture, nodes = camera_with(PixelFormat="BayerRG8")
    nodes["PixelFormat"].symbolics = ("BayerRG8", "Mono8", "RGB8")
    with pytest.raises(CameraError, match="cam: pictures in the form BayerRG8 are not read; set Mono8, RGB8 in"):
        capture.check_format("cam")
