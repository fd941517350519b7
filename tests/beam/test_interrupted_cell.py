"""A cell that scans, measures, calibrates, aligns, holds or maximises is interrupted while a motor has drive.

At the pins the motors are off when the interrupt arrives at the cell, none begins by itself later, and the next cell
goes on with the same mount and camera.
"""

import contextlib

import pytest

from mirrormount.transport.ports import open_table
from mirrormount_beam.control.calibrate import Calibration
from mirrormount_beam.control.hold import Hold, align
from mirrormount_beam.control.maximise import maximise
from mirrormount_beam.estimates import Result
from mirrormount_beam.experiments import steps
from mirrormount_beam.experiments.rig import MountRig
from mirrormount_beam.observe import SpotObserver
from mirrormount_beam.scan import raster, scan, spot_signal
from mirrormount_beam.table import LocalTable

pytestmark = pytest.mark.slow


class Bench:
    """A virtual table with one mount and one camera, and the loop's calibration of it, measured once."""

    def __init__(self, table) -> None:
        self.table, self.mount, self.camera = table, table.mount(), table.cameras[0]
        self.loop = LocalTable.of_virtual(table, {"first": self.mount})
        self._calibrated = None

    @property
    def calibrated(self):
        if not self._calibrated:
            measuring = Calibration(self.loop)
            self._calibrated = measuring.run(), measuring.gaps
        return self._calibrated

    @property
    def driven(self):
        return any(self.table.simulations[0].bench.duties().values())


@pytest.fixture(scope="module")
def bench():
    with contextlib.closing(open_table("virtual-table://?mounts=1&cameras=1&off=2")) as table:
        yield Bench(table)


def do_scan(bench):
    list(scan(bench.mount, raster(3, 3), spot_signal(bench.camera)))


def do_measure(bench):
    steps.run(MountRig(bench.mount, SpotObserver(bench.camera)), Result("steps"), lambda *_: None)


def do_calibrate(bench):
    Calibration(bench.loop).run()


def do_align(bench):
    bench.mount.x.step(20)  # so that there is something to align
    align(bench.loop, bench.calibrated[0])


def do_hold(bench):
    bench.mount.x.step(3)
    Hold(bench.loop, bench.calibrated[0]).run(600)


def do_maximise(bench):
    maximise(bench.loop, bench.table.power)


@pytest.mark.parametrize("cell", [do_scan, do_measure, do_calibrate, do_align, do_hold, do_maximise])
def test_the_motors_are_off_and_the_next_cell_goes_on(bench, cell, monkeypatch):
    if cell in (do_align, do_hold):
        assert bench.calibrated
    clock, passed = bench.table.clock, []
    run = clock.run

    def interrupted(*how):
        came = run(*how)
        if bench.driven and len(passed) < 9:
            passed.append(clock.now_s())
            if len(passed) == 9:  # in the midst of it
                raise KeyboardInterrupt
        return came

    monkeypatch.setattr(clock, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        cell(bench)
    assert not bench.driven
    edges = len(bench.table.simulations[0].edges)
    bench.table.sleep(3)
    assert len(bench.table.simulations[0].edges) == edges, "a motor began to run by itself"
    bench.mount.x.step(1)
    assert bench.mount.x.last_move().steps == 1
    assert SpotObserver(bench.camera).observe().frames
