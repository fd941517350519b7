"""ports/rp2_listed.py: the folder of the firmware, listed once for imports. The files are a folder of this computer."""

import os
import stat
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import mountfw

SOURCE = Path(mountfw.__file__).parent / "ports" / "rp2_listed.py"


class Flash:
    """What rp2_listed takes of os and sys, with the current folder as the flash."""

    def __init__(self, platform="rp2"):
        self.mounted = {}
        self.os = SimpleNamespace(ilistdir=self.ilistdir, mount=self.mount, umount=self.umount)
        self.sys = SimpleNamespace(platform=platform, path=["", "/lib"], modules={})

    def ilistdir(self, folder):
        for entry in os.scandir(folder):
            yield entry.name, 0x4000 if entry.is_dir() else 0x8000, 0, entry.stat().st_size

    def mount(self, what, place):
        what.mount(False, False)
        self.mounted[place] = what

    def umount(self, place):
        if place not in self.mounted:
            raise OSError(22)
        self.mounted.pop(place).umount()

    def module(self, monkeypatch):
        module = ModuleType("rp2_listed")
        with monkeypatch.context() as patch:
            for name in ("array", "machine"):
                patch.setitem(sys.modules, name, ModuleType(name))
            exec(compile(SOURCE.read_text(), str(SOURCE), "exec"), vars(module))
            vars(module).update(os=self.os, sys=self.sys)
            module.enter()
        return module


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in {
        "__init__.mpy": "short, but not only a docstring",
        "encoder/axis.mpy": "imported later, if at all",
        "app.mpy": "the app",
        "wire/__init__.mpy": "short",
        "wire/frame.mpy": "the frame",
    }.items():
        (tmp_path / "mountfw" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mountfw" / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_answers_what_is_there_and_opens_the_files_of_the_flash(folder, monkeypatch):
    flash = Flash()
    flash.module(monkeypatch)
    (files,) = flash.mounted.values()
    assert stat.S_ISDIR(files.stat("/")[0]) and stat.S_ISDIR(files.stat("/wire")[0])
    assert stat.S_ISREG(files.stat("/wire/frame.mpy")[0]) and stat.S_ISREG(files.stat("/__init__.mpy")[0])
    for absent in ("/wire/frame", "/wire/frame.py", "/wire/__init__.mpy"):  # the last has a docstring alone
        with pytest.raises(KeyError, match=absent):  # an import takes any error for "it is not there"
            files.stat(absent)
    assert sorted(files.ilistdir("/wire")) == [("frame.mpy", 0x8000, 0)]
    with files.open("/wire/frame.mpy", "r") as f:
        assert f.read() == "the frame"


def test_it_leaves_nothing_mounted_however_often_it_leaves(folder, monkeypatch):
    flash = Flash()
    listed = flash.module(monkeypatch)
    assert list(flash.mounted) == ["/mountfw"]
    listed.leave()
    listed.leave()
    assert flash.mounted == {}
    assert flash.sys.path == ["", "/lib"]


def test_without_the_folder_imports_stay_as_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flash = Flash()
    flash.module(monkeypatch)
    assert flash.mounted == {}
    assert flash.sys.path == ["", "/lib"]


def test_another_platform_keeps_its_own_way(folder, monkeypatch):
    flash = Flash("linux")
    flash.module(monkeypatch)
    assert flash.mounted == {} and flash.sys.modules == {}
