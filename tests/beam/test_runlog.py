"""The log of a run: what is kept, what a power cut costs, how large it may grow, and what the report makes of it."""

import contextlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from loop_rig import Rig

from mirrormount.cli.main import main
from mirrormount.errors import BadFile, CannotWrite
from mirrormount.terminal import printable
from mirrormount_beam import runlog
from mirrormount_beam.control.events import (
    HOLDING,
    WAITING,
    Corrected,
    Estimated,
    InterlockTripped,
    Observed,
    Pulsed,
    ResponseChanged,
    SpotMissed,
    SpotSeen,
    StateChanged,
)
from mirrormount_beam.control.hold import Hold
from mirrormount_beam.report import write_report
from mirrormount_beam.runlog import ErrorSums, RunLog, joined, read_run, spectrum

ABOUT = {"began": "2026-11-22T10:00:00+00:00", "table": "<two> mounts"}


def spot(camera: str, x_um: float, y_um: float = 0.0) -> SpotSeen:
    return SpotSeen(camera, (320.0, 240.0), (0.01, 0.01), (x_um, y_um), 0.0)


def observed(time_s: float, near_um: float, far_um: float, free_um: float = 50.0) -> Observed:
    spots = spot("near", near_um), spot("far", far_um, -far_um)
    return Observed(time_s, spots, (far_um - near_um, 0.0), ((free_um, 0.0), (2 * free_um, 0.0)))


def estimate(seen: Observed) -> Estimated:
    """Of a loop that takes each observation for the truth."""
    return Estimated(seen.time_s, {spot.camera: spot.error_um for spot in seen.spots}, seen.angle_urad)


def an_hour() -> list:
    """Two observations a second for 65 minutes: ±3 um near, ±8 um far; an interlock in between."""
    events: list = [StateChanged(0.0, HOLDING)]
    for at in range(2 * 65 * 60):
        sign = 1 if at % 2 else -1
        seen = observed(at / 2, 3.0 * sign, 8.0 * sign, at / 100)
        events += [seen, estimate(seen)]
        if at % 100 == 0:
            events.append(Pulsed(at / 2, "first.x", -12_000, "correct"))
            events.append(Corrected(at / 2, at, {"first.x": -0.1}, (3.0,), (0.0,), (1.0,), ("first.x",)))
        if at == 4000:
            events.append(InterlockTripped(at / 2, 2, "no spot", "near: too dark", "remove <what> is in the way", True))
            events.append(StateChanged(at / 2, WAITING, "near: too dark"))
            events.append(Observed(at / 2, (SpotMissed("near", "dark"), spot("far", 900.0))))
            events.append(StateChanged(at / 2 + 0.4, HOLDING))
    events.append(ResponseChanged(3899.0, ((1.0,),), 0.03))
    return events


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The log of that hour."""
    path = tmp_path_factory.mktemp("run") / "run.sqlite"
    with RunLog(path, ABOUT, patient=True) as log:
        for event in an_hour():
            log(event)
    assert [file.name for file in path.parent.iterdir()] == ["run.sqlite"]
    return path


def test_what_is_read_is_what_happened(written):
    run = read_run(written)
    assert run.about == ABOUT
    assert [minute.begin_s for minute in run.minutes] == [60.0 * at for at in range(65)]
    first = run.minutes[0]
    assert first.held.errors_um["near"].rms == pytest.approx((3.0, 0.0)) and first.held.errors_um["far"].most == 8.0
    assert first.held.errors_um["near"].observations == 120 and first.corrections == 2 and first.reversals == 2
    assert first.drive_us == {"first.x": [0, 24_000]}
    assert sum(minute.held_s for minute in run.minutes) == pytest.approx(65 * 60 - 0.4, abs=0.6)
    assert [(number, name) for _, number, name, _ in run.interlocks] == [(2, "no spot")]
    assert max(minute.held.errors_um["far"].most for minute in run.minutes) == 8.0, "what is seen then is not held"
    assert len(run.times_s) == len(run.errors_um["far"]) == 2 * 65 * 60


def test_a_report_has_the_figures_that_the_run_ended_with(tmp_path):
    rig = Rig("rough", 2)
    with RunLog(tmp_path / "run.sqlite", ABOUT, patient=True) as log:
        hold = Hold(rig.table, rig.response, rig.gaps, log)
        begin_s = rig.table.now_s()
        rig.table.at(begin_s + 50, lambda: setattr(rig.table.truth.laser, "blocked", True))
        rig.table.at(begin_s + 65, lambda: setattr(rig.table.truth.laser, "blocked", False))
        summary = hold.run(150)
    run = read_run(tmp_path / "run.sqlite")
    angle = ErrorSums.joined(minute.held.angle_urad for minute in run.minutes)
    errors = joined(minute.held.errors_um for minute in run.minutes)
    assert len(summary.interlocks) == 1 and len(run.minutes) >= 3
    assert max(angle.rms) == pytest.approx(summary.rms_urad)
    assert [um for sums in errors.values() for um in sums.rms] == pytest.approx(list(summary.rms_um))
    assert max(sums.most for sums in errors.values()) == summary.max_um


KILLED = """
import os, signal, sys
from pathlib import Path
from mirrormount_beam.runlog import RunLog
from test_runlog import ABOUT, an_hour

log, events = RunLog(Path(sys.argv[1]), ABOUT), an_hour()
for at in range(0, 8000, 200):
    log._commit(events[at : at + 200])
log._file.execute("BEGIN")
log._write(events[8000])
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_process_that_is_killed_costs_the_last_second_and_no_minute(written, tmp_path):
    paths = [path for path in sys.path if path]
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, tmp_path / "run.sqlite"], env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    )
    assert killed.returncode == -signal.SIGKILL
    run, whole = read_run(tmp_path / "run.sqlite"), read_run(written)
    assert len(run.minutes) == 33
    assert [minute.held.errors_um for minute in run.minutes[:-1]] == [
        minute.held.errors_um for minute in whole.minutes[:32]
    ]
    assert run.times_s == [event.time_s for event in an_hour()[:8000] if isinstance(event, Observed)]


def test_a_power_cut_within_a_commit_leaves_the_log_as_it_was_before(written, tmp_path):
    """What is on the disk then is the file and a part of the last write-ahead log."""
    log = RunLog(tmp_path / "run.sqlite", ABOUT)
    log._commit([StateChanged(0.0, HOLDING), observed(1.0, 0.0, 0.0)])
    log._commit([observed(2.0, 0.0, 0.0)])
    (cut := tmp_path / "cut").mkdir()
    for name in ("run.sqlite", "run.sqlite-wal"):
        shutil.copy(tmp_path / name, cut / name)
    os.truncate(cut / "run.sqlite-wal", (cut / "run.sqlite-wal").stat().st_size - 20)
    assert read_run(cut / "run.sqlite").times_s == [1.0]
    log.close()
    assert read_run(tmp_path / "run.sqlite").times_s == [1.0, 2.0]


@pytest.mark.full
def test_the_log_is_bounded_and_the_minutes_outlive_the_events(tmp_path, monkeypatch):
    monkeypatch.setitem(runlog.MOST_ROWS, "events", 1000)
    monkeypatch.setattr(runlog, "MOST_MINUTES", 60)
    log = RunLog(tmp_path / "run.sqlite", ABOUT)
    for event in an_hour():
        log._commit([event])
    log.close()
    run = read_run(tmp_path / "run.sqlite")
    assert len(run.minutes) == 61 and 400 < len(run.times_s) <= 500
    assert (tmp_path / "run.sqlite").stat().st_size < 1_000_000


def test_a_disk_that_is_full_costs_events_and_stops_neither_the_caller_nor_the_log(tmp_path):
    log = RunLog(tmp_path / "run.sqlite", ABOUT)
    log._commit([StateChanged(0.0, HOLDING)])
    (pages,) = log._file.execute("PRAGMA page_count").fetchone()
    log._file.execute(f"PRAGMA max_page_count = {pages}")
    log._commit([observed(float(at), 0.0, 0.0) for at in range(1000)])
    assert log.lost == 1000 and "full" in log.trouble
    log._file.execute("PRAGMA max_page_count = 1000000")  # somebody has made room
    log(observed(1000.0, 0.0, 0.0))
    with pytest.raises(CannotWrite, match=r"not whole, 1000 events are missing: .*full"):
        log.close()
    assert read_run(tmp_path / "run.sqlite").times_s == [1000.0]


def test_a_disk_that_hangs_costs_events_and_no_time(tmp_path, monkeypatch):
    monkeypatch.setattr(runlog, "_WAITING_MOST", 5)
    monkeypatch.setattr(runlog, "COMMIT_S", 0.01)
    hangs, goes_on = threading.Event(), threading.Event()

    def hang(_log: RunLog, _events: list) -> None:
        hangs.set()
        goes_on.wait()

    monkeypatch.setattr(RunLog, "_commit", hang)
    log = RunLog(tmp_path / "run.sqlite", ABOUT)
    log(observed(0.0, 0.0, 0.0))
    hangs.wait()
    for at in range(8):
        log(observed(float(at), 0.0, 0.0))
    assert log.lost == 3
    goes_on.set()
    with pytest.raises(CannotWrite, match="3 events are missing: the disk was too slow"):
        log.close()


def test_a_log_never_goes_into_a_file_that_exists(written):
    with pytest.raises(CannotWrite, match="it exists"):
        RunLog(written, ABOUT)


def test_each_event_is_on_the_disk_while_the_run_goes_on(tmp_path):
    log = RunLog(tmp_path / "run.sqlite", ABOUT)
    committed = threading.Event()
    commit = log._commit
    log._commit = lambda events: (commit(events), committed.set())
    log(StateChanged(0.0, HOLDING))
    log(observed(0.0, 1.0, 2.0))
    assert committed.wait(60), "the log was not written while it was open"
    assert len(read_run(tmp_path / "run.sqlite").times_s) == 1
    log.close()


def test_the_tables_are_read_as_the_docstring_says(written):
    """pandas.read_sql() gives the rows of a query and the names of its columns: so does a cursor."""
    with contextlib.closing(sqlite3.connect(written)) as file:
        rows = file.execute("SELECT time_s, camera, x_um, y_um FROM spots LIMIT 2").fetchall()
        assert rows == [(0.0, "near", -3.0, 0.0), (0.0, "far", -8.0, 8.0)]
        for table in ("about", "events", "spots", "minutes", "errors", "drives", "interlocks"):
            columns = [column[0] for column in file.execute(f"SELECT * FROM {table}").description]
            told = runlog.__doc__.split(f"\n{table} ")[1].split("\n\n")[0]
            assert all(column in told for column in columns if column != "id"), table


@pytest.mark.parametrize("content", [b"", b"no database", b"SQLite format 3\0" + bytes(84)])
def test_a_file_that_is_no_log_is_one_line(tmp_path, content):
    (path := tmp_path / "run.sqlite").write_bytes(content)
    with pytest.raises(BadFile, match=r"run\.sqlite: no log of a run \("):
        read_run(path)
    with pytest.raises(BadFile, match="no log of a run"):
        read_run(tmp_path)
    with pytest.raises(BadFile, match=r"nothing\.sqlite: there is no such file"):
        read_run(tmp_path / "nothing.sqlite")
    assert not (tmp_path / "nothing.sqlite").exists()


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE minutes SET begin_s = 9e307 WHERE begin_s = (SELECT max(begin_s) FROM minutes)",
        "UPDATE minutes SET held_s = -1",
        "UPDATE minutes SET change = 9e999",
        "UPDATE minutes SET pulses = 'many'",
        "UPDATE errors SET seconds = -3",
        "UPDATE errors SET observations = NULL",
        "UPDATE errors SET xx = 1e308",
        "UPDATE drives SET actuator = printf('%.*c', 100000, 'n')",
        "UPDATE interlocks SET time_s = -1e300",
        "UPDATE events SET data = replace(data, '-3.0', '1e305')",
        "UPDATE events SET data = replace(data, '-3.0', 'NaN')",
    ],
)
def test_a_log_with_figures_that_no_run_has_is_one_line(written, tmp_path, damage):
    shutil.copy(written, path := tmp_path / "run.sqlite")
    with contextlib.closing(sqlite3.connect(path)) as file:
        assert file.execute(damage).rowcount
        file.commit()
    with pytest.raises(BadFile, match=r"run\.sqlite: no log of a run \("):
        read_run(path)


@pytest.mark.parametrize("name", ["$\\sqrt{", "_left", "\x1b[2J"])
def test_a_name_stands_in_a_report_as_it_is(written, tmp_path, name):
    shutil.copy(written, path := tmp_path / "run.sqlite")
    with contextlib.closing(sqlite3.connect(path)) as file:
        file.execute("UPDATE errors SET name = ? WHERE name = 'near'", (name,))
        file.execute("UPDATE drives SET actuator = ?", (name,))
        file.commit()
    write_report(page := tmp_path / "page.html", read_run(path))
    assert f"{printable(name)}: rms of a minute" in page.read_text()


def test_the_page_tells_it_in_words_and_curves_and_holds_nothing_of_others(written, tmp_path):
    write_report(page := tmp_path / "page.html", read_run(written))
    text = page.read_text()
    assert text.count("<svg") == 5 and 'src="http' not in text and 'href="http' not in text
    assert "&lt;two&gt; mounts" in text and "<two>" not in text
    for words in ("near, µm", "far, µm", "angle of the beam, µrad", "hour 2", "no spot", "near: too dark", "78"):
        assert words in text


@pytest.mark.parametrize("opens", [False, True])
def test_the_command_ends_with_the_page_and_opens_it_only_if_asked(opens, written, tmp_path, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url: not opened.append(url))
    page = tmp_path / "page.html"
    assert main(["report", str(written), "--html", str(page), *["--open"] * opens]) == 0
    assert capsys.readouterr().out == f"open {page}\n"
    assert opened == [page.as_uri()] * opens


def test_a_report_replaces_no_file_but_a_page(written, tmp_path):
    (file := tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(CannotWrite, match="is no report; name another one"):
        write_report(file, read_run(written))
    assert file.read_text() == "mine"


def test_a_short_run_is_told_in_minutes_and_a_long_one_in_hours(written, tmp_path):
    long = read_run(written)
    short = replace(long, minutes=long.minutes[:3])
    pages = []
    for run in (short, long):
        write_report(tmp_path / "page.html", run)
        pages.append((tmp_path / "page.html").read_text())
    assert [">minutes<" in page for page in pages] == [True, False]
    assert [">hours<" in page for page in pages] == [False, True]
    assert "3 min" in pages[0]


def test_the_spectrum_of_a_wave_stands_at_its_frequency_and_holds_its_power():
    times_s = np.arange(4096) / 8.0
    hz, density = spectrum(times_s, 5.0 * np.sin(2 * np.pi * 0.5 * times_s))
    assert hz[density.argmax()] == pytest.approx(0.5, abs=0.01)
    assert np.sum(density**2) * (hz[1] - hz[0]) == pytest.approx(12.5, rel=0.02)
