"""Files of the moment are gone, whenever a signal ends the program."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from mirrormount.files import scratch_folder
from mirrormount.terminal import Terminated


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_the_folder_is_of_this_user_alone_and_gone_at_the_end(temporary):
    with scratch_folder() as folder:
        assert Path(folder).stat().st_mode & 0o777 == 0o700
        Path(folder, "file").write_text("text")
    assert list(temporary.iterdir()) == []


def test_a_signal_in_the_middle_of_the_removal_leaves_nothing(temporary, monkeypatch):
    remove = shutil.rmtree
    signals = [Terminated(15)]

    def interrupted(folder: Path, **options: bool) -> None:
        if signals:
            raise signals.pop()
        remove(folder, **options)

    monkeypatch.setattr(shutil, "rmtree", interrupted)
    with pytest.raises(Terminated), scratch_folder() as folder:
        Path(folder, "file").write_text("text")
    assert list(temporary.iterdir()) == []


def test_a_signal_right_behind_the_making_leaves_nothing(temporary, monkeypatch):
    make = Path.mkdir

    def interrupted(folder: Path, **options: int) -> None:
        make(folder, **options)
        raise Terminated(15)

    monkeypatch.setattr(Path, "mkdir", interrupted)
    with pytest.raises(Terminated), scratch_folder():
        pytest.fail("it was not made")
    assert list(temporary.iterdir()) == []


def test_the_place_was_tried_before_a_signal_may_come():
    names = "import mirrormount.deploy.micropython, tempfile; print(tempfile.tempdir)"
    run = subprocess.run([sys.executable, "-c", names], capture_output=True, text=True, check=True)
    assert Path(run.stdout.strip()).is_dir()
