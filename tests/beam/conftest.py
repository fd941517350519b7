"""Fixtures: the table of the tests of scans; what the tests of `mirrormount measure` measure on."""

import contextlib

import pytest

from mirrormount.transport.ports import open_table
from mirrormount_beam.cli import measure
from mirrormount_beam.estimates import Estimate
from mirrormount_sim import table as table_module


@pytest.fixture
def table():
    with contextlib.closing(open_table("virtual-table://?mounts=1&cameras=2")) as opened:
        yield opened


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    """Settings and reports go into the folder of the test."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "settings"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def tables(monkeypatch):
    """The tables that `mirrormount measure` opens."""
    opened = []

    def open_table(address):
        opened.append(table_module.open_table(address))
        return opened[-1]

    monkeypatch.setattr(measure, "open_table", open_table)
    return opened


@pytest.fixture
def found(monkeypatch):
    """An experiment that has found a take-up at once."""

    def at_once(rig, result, _tell):
        rig.observe()
        result.estimates["x.take_up"] = Estimate(251_000.0, 900.0, "us")

    monkeypatch.setattr(measure.backlash, "run", at_once)
