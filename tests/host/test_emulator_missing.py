"""The rp2040 machine says in one line what it lacks."""

import subprocess

import pytest

from mirrormount import errors
from mirrormount.virtual import emulator


def test_without_node_it_says_so(monkeypatch):
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: None)
    with pytest.raises(errors.EmulatorMissing, match=r"Node\.js"):
        emulator.command(None, None, 0)


def test_an_old_node_is_told_from_none(monkeypatch):
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: "/usr/bin/node")
    answer = subprocess.CompletedProcess([], 0, stdout="v12.22.9\n")
    monkeypatch.setattr(emulator.subprocess, "run", lambda *_args, **_kw: answer)
    with pytest.raises(errors.EmulatorMissing, match=r"v12\.22\.9"):
        emulator.command(None, None, 0)


def test_an_image_that_is_not_there_is_told(tmp_path):
    with pytest.raises(errors.EmulatorMissing, match="no such image"):
        emulator.find_image(tmp_path / "RPI_PICO.uf2")


def test_without_image_and_toolchain_it_says_where_to_put_one(monkeypatch, tmp_path):
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path))
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: None)
    with pytest.raises(errors.EmulatorMissing, match="--image"):
        emulator.find_image(None)


def test_an_image_in_the_cache_is_taken(monkeypatch, tmp_path):
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path))
    (tmp_path / "images").mkdir()
    image = tmp_path / "images" / "RPI_PICO-1.25.0.bin"
    image.write_bytes(b"")
    assert emulator.find_image(None) == image
