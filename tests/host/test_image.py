"""Where the rp2040 machine's MicroPython image comes from."""

import os
import struct
from pathlib import Path

import pytest
from served import run_cli

from mirrormount import errors
from mirrormount_sim import emulator

NAME = "RPI_PICO-1.uf2"


@pytest.fixture(autouse=True)
def images(monkeypatch, tmp_path) -> Path:
    """The folder where images are kept: empty, on a machine where none can be built."""
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path))
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: None)
    return tmp_path / "images"


def test_an_image_that_is_named_goes_before_all(images, tmp_path):
    images.mkdir()
    (images / NAME).write_bytes(b"kept")
    named = tmp_path / "mine.bin"
    named.write_bytes(bytes(256) + struct.pack("<II", 0x20042000, 0x100001F7))
    assert emulator.find_image(named) == named


def test_an_image_that_is_named_and_not_there_is_told(tmp_path):
    with pytest.raises(errors.EmulatorMissing, match="no such image"):
        emulator.find_image(tmp_path / "RPI_PICO.uf2")


@pytest.mark.parametrize(
    "content",
    [
        b"root:x:0:0:root:/root:/bin/bash\n" * 100,
        b"",
        bytes(512),
        b"UF2\n" + bytes(24) + struct.pack("<I", 0xE48BFF59) + bytes(256) + struct.pack("<II", 0x20042000, 0x100001F7),
    ],
    ids=["a text", "nothing", "zeros", "of an RP2350"],
)
def test_a_file_that_no_rp2040_starts_from_is_refused(tmp_path, content):
    named = tmp_path / "passwd"
    named.write_bytes(content)
    with pytest.raises(errors.EmulatorMissing, match="passwd: that is no image for an RP2040"):
        emulator.find_image(named)


def test_an_image_in_the_cache_is_taken(images):
    images.mkdir()
    image = images / "RPI_PICO-1.25.0.bin"
    image.write_bytes(b"")
    assert emulator.find_image(None) == image


def test_without_image_and_toolchain_it_says_where_to_put_one(images):
    with pytest.raises(errors.EmulatorMissing, match=f"no MicroPython image: .*into {images}.*--image FILE"):
        emulator.find_image(None)


@pytest.mark.skipif(os.name != "posix", reason="the lock needs POSIX")
def test_two_processes_do_not_make_the_same_part_of_the_cache_at_once(tmp_path):
    import fcntl

    at_once = fcntl.LOCK_EX | fcntl.LOCK_NB
    with (tmp_path / "emulator.lock").open("a") as other:
        with emulator.held("emulator"), emulator.held("flash"), pytest.raises(BlockingIOError):
            fcntl.flock(other, at_once)
        fcntl.flock(other, at_once)  # free again


@pytest.mark.skipif(os.name != "posix", reason="the lock needs POSIX")
def test_two_processes_do_not_build_an_image_at_once_and_the_second_takes_the_firsts(monkeypatch, tmp_path):
    import fcntl

    def build(folder: Path) -> Path:
        with (tmp_path / "image.lock").open("a") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        folder.mkdir()
        (folder / NAME).write_bytes(b"")
        return folder / NAME

    monkeypatch.setattr(emulator, "build", build)
    first = emulator.find_image(None)
    looks = iter([None, first])  # the second looks while the first builds, and again when that is over
    monkeypatch.setattr(emulator, "_kept", lambda _folder: next(looks))
    assert emulator.find_image(None) == first


def test_a_cache_that_cannot_be_written_to_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path / "file"))
    with pytest.raises(errors.EmulatorMissing, match="MIRRORMOUNT_CACHE"), emulator.held("emulator"):
        pass


def test_an_image_that_is_no_file_is_not_read():
    run = run_cli("virtual", "--machine", "rp2040", "--image", "/dev/zero")
    assert (run.returncode, run.stdout, run.stderr) == (1, "", "mirrormount: /dev/zero: there is no such image\n")
