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
