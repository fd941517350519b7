"""`mirrormount measure` that is ended by a signal: motors off, one line, and a report of what was measured by then."""

import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress

import pytest

from mirrormount.cli import main
from mirrormount_beam.cli import measure
from mirrormount_beam.experiments.rig import MountRig
from mirrormount_sim import table

WORDS = ("measure", "drift", "--virtual", "--seed", "5", "--minutes", "10000")
SIGNALS = ("SIGTERM", "SIGHUP")
PATIENCE_S = 120  # a limit, not a measurement


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "settings"))
    monkeypatch.chdir(tmp_path)


class Terminal:
    """A terminal that is read all the time. measured: set when a line of progress has come after three readings."""

    def __init__(self):
        self._ours, self.its = os.openpty()
        self.measured = threading.Event()
        self._thread = threading.Thread(target=self._read)

    def _read(self):
        told = b""
        with suppress(OSError):  # nobody writes any more
            while got := os.read(self._ours, 4096):
                told += got
                if told.count(b" s of ") > 3:
                    self.measured.set()
        self.measured.set()  # it has ended too early: the test says so

    def __enter__(self):
        return self

    def begun(self):
        """The child has the terminal: it alone, so that its end is seen."""
        os.close(self.its)
        self._thread.start()

    def __exit__(self, *_):
        self._thread.join()
        os.close(self._ours)


@pytest.mark.parametrize("name", SIGNALS)
def test_a_process_that_is_told_to_end_leaves_a_partial_report(name, tmp_path):
    program = [sys.executable, "-m", "mirrormount", *WORDS]
    with Terminal() as terminal, subprocess.Popen(program, stdout=subprocess.PIPE, stderr=terminal.its) as child:
        terminal.begun()
        try:
            assert terminal.measured.wait(PATIENCE_S)
            child.send_signal(getattr(signal, name))
            out = child.communicate(timeout=PATIENCE_S)[0].decode()
        finally:
            child.kill()  # no effect on one that has ended
    assert child.returncode == 128 + getattr(signal, name)
    assert out == "partial report: measure-drift.html, numbers: measure-drift.json\nopen measure-drift.html\n"
    numbers = json.loads((tmp_path / "measure-drift.json").read_text())
    assert numbers["partial"] == f"ended by {name}" and len(numbers["readings"]) >= 3
    assert f"Ended early:</b> ended by {name}" in (tmp_path / "measure-drift.html").read_text()


@pytest.mark.parametrize("name", SIGNALS)
def test_a_motor_that_runs_when_the_signal_comes_is_off_at_the_pins(name, capsys, monkeypatch):
    tables = []

    def open_table(address):
        tables.append(table.open_table(address))
        return tables[-1]

    def driven():
        (simulation,) = tables[0].simulations
        return {pin: duty for _, pin, duty in simulation.edges if pin.endswith("_en")}

    class Ended(measure.MountRig):
        def observe(self):
            if driven():
                self.mount.x.jog(0.5)
                assert any(driven().values())
                signal.raise_signal(getattr(signal, name))
            return super().observe()

    monkeypatch.setattr(measure, "open_table", open_table)
    monkeypatch.setattr(measure, "MountRig", Ended)
    assert main.main(["measure", "steps", "--virtual", "--seed", "5"]) == 128 + getattr(signal, name)
    out, err = capsys.readouterr()
    assert "partial report" in out and err == f"mirrormount: ended by {name}\n"
    assert driven() and not any(driven().values())


def test_a_stop_between_two_moves_ends_the_measurement_before_the_next_one(monkeypatch, capsys):
    moved = MountRig.step
    steps = []

    def stopped_after(rig, axis, n):
        steps.append(n)
        moved(rig, axis, n)
        rig.mount.session.stop_for_another_program()

    monkeypatch.setattr(MountRig, "step", stopped_after)
    assert main.main(["measure", "steps", "--virtual"]) == 1
    assert "stopped before it began" in capsys.readouterr().err
    assert len(steps) == 2
