"""The log of a run: what is kept, what a power cut costs, how large it may grow, and what the report makes of it."""

import errno
import json
import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from loop_rig import Rig

from mirrormount.beam import run_log
from mirrormount.beam.control.events import (
    HOLDING,
    WAITING,
    Corrected,
    Estimated,
    GateClosed,
    Looked,
    Pulsed,
    ResponseChanged,
    SpotMissed,
    SpotSeen,
    StateChanged,
)
from mirrormount.beam.control.hold import Hold
from mirrormount.beam.over_time import Sums, joined
from mirrormount.beam.run_log import RunLog
from mirrormount.beam.run_reader import read_run, spectrum
from mirrormount.beam.run_report import write_report
from mirrormount.common.errors import BadFile, CannotWrite

ABOUT = {"began": "2026-11-22T10:00:00+00:00", "table": "<two> mounts"}


def spot(camera: str, x_um: float, y_um: float = 0.0) -> SpotSeen:
    return SpotSeen(camera, (320.0, 240.0), (0.01, 0.01), (x_um, y_um), 0.0)


def look(time_s: float, near_um: float, far_um: float, free_um: float = 50.0) -> Looked:
    spots = spot("near", near_um), spot("far", far_um, -far_um)
    return Looked(time_s, spots, (far_um - near_um, 0.0), ((free_um, 0.0), (2 * free_um, 0.0)))


def estimate(look: Looked) -> Estimated:
    """Of a loop that takes each look for the truth."""
    return Estimated(look.time_s, {spot.camera: spot.error_um for spot in look.spots}, look.angle_urad)


def an_hour() -> list:
    """Two looks a second for 65 minutes: ±3 um near, ±8 um far; a gate in between."""
    events: list = [StateChanged(0.0, HOLDING)]
    for at in range(2 * 65 * 60):
        sign = 1 if at % 2 else -1
        seen = look(at / 2, 3.0 * sign, 8.0 * sign, at / 100)
        events += [seen, estimate(seen)]
        if at % 100 == 0:
            events.append(Pulsed(at / 2, "first.x", -12_000, "correct"))
            events.append(Corrected(at / 2, at, {"first.x": -0.1}, (3.0,), (0.0,), (1.0,), ("first.x",)))
        if at == 4000:
            events.append(GateClosed(at / 2, 2, "no spot", "near: too dark", "remove <what> is in the way", True))
            events.append(StateChanged(at / 2, WAITING, "near: too dark"))
            events.append(Looked(at / 2, (SpotMissed("near", "dark"), spot("far", 900.0))))
            events.append(StateChanged(at / 2 + 0.4, HOLDING))
    events.append(ResponseChanged(3899.0, ((1.0,),), 0.03))
    return events


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The log of that hour."""
    folder = tmp_path_factory.mktemp("run") / "log"
    with RunLog(folder, ABOUT, patient=True) as log:
        for event in an_hour():
            log(event)
    return folder


def test_what_is_read_is_what_happened(written):
    run = read_run(written)
    assert run.about == ABOUT and run.damaged == 0
    assert [minute.begin_s for minute in run.minutes] == [60.0 * at for at in range(65)]
    first = run.minutes[0]
    assert first.errors_um["near"].rms == pytest.approx((3.0, 0.0)) and first.errors_um["far"].most == 8.0
    assert first.errors_um["near"].looks == 120 and first.corrections == 2 and first.reversals == 2
    assert first.drive_us == {"first.x": [0, 24_000]}
    assert sum(minute.held_s for minute in run.minutes) == pytest.approx(65 * 60 - 0.4, abs=0.6)
    assert [(number, name) for minute in run.minutes for _, number, name, _ in minute.gates] == [(2, "no spot")]
    assert max(minute.errors_um["far"].most for minute in run.minutes) == 8.0, "a look at a closed gate is no held one"
    assert len(run.times_s) == len(run.errors_um["far"]) == 2 * 65 * 60


def test_a_report_has_the_figures_that_the_run_ended_with(tmp_path):
    rig = Rig("rough", 2)
    with RunLog(tmp_path / "log", ABOUT, patient=True) as log:
        hold = Hold(rig.table, rig.response, rig.gaps, log)
        begin_s = rig.table.now_s()
        rig.table.at(begin_s + 50, lambda: setattr(rig.table.truth.laser, "blocked", True))
        rig.table.at(begin_s + 65, lambda: setattr(rig.table.truth.laser, "blocked", False))
        summary = hold.run(150)
    run = read_run(tmp_path / "log")
    angle = Sums()
    for minute in run.minutes:
        angle.join(minute.angle_urad)
    errors = joined([minute.errors_um for minute in run.minutes])
    assert len(summary.gates) == 1 and len(run.minutes) >= 3
    assert max(angle.rms) == pytest.approx(summary.rms_urad)
    assert [um for sums in errors.values() for um in sums.rms] == pytest.approx(list(summary.rms_um))
    assert max(sums.most for sums in errors.values()) == summary.max_um


def test_a_cut_costs_the_last_line_and_no_minute(written, tmp_path):
    (cut := tmp_path / "cut").mkdir()
    for path in written.iterdir():
        content = path.read_bytes()
        if path.name == "minutes.jsonl":
            content = b"".join(content.splitlines(keepends=True)[:60]) + b'{"begin_s": 36'
        elif path.name.startswith("events"):
            content = content[:-20]
        (cut / path.name).write_bytes(content)
    run = read_run(cut)
    assert run.damaged == 2 and len(run.minutes) == 65
    whole = read_run(written)
    assert run.minutes[62].errors_um == whole.minutes[62].errors_um
    write_report(page := tmp_path / "cut.html", run)
    assert "2 lines of the log are damaged" in page.read_text()


def test_minutes_that_are_made_of_events_miss_nothing_between_two_files(written, tmp_path, monkeypatch):
    monkeypatch.setattr(run_log, "SEGMENT_BYTES", 400_000)
    with RunLog(tmp_path / "log", ABOUT, patient=True) as log:
        for event in an_hour():
            log(event)
    (tmp_path / "log" / "minutes.jsonl").write_bytes(b"")
    assert len(list((tmp_path / "log").glob("events-*"))) > 5
    found, whole = read_run(tmp_path / "log").minutes, read_run(written).minutes
    assert [minute.errors_um for minute in found] == [minute.errors_um for minute in whole]
    assert [minute.corrections for minute in found] == [minute.corrections for minute in whole]


def test_the_log_is_bounded_and_the_minutes_outlive_the_events(tmp_path, monkeypatch):
    monkeypatch.setattr(run_log, "SEGMENT_BYTES", 20_000)
    monkeypatch.setattr(run_log, "SEGMENTS", 3)
    with RunLog(tmp_path / "log", ABOUT, patient=True) as log:
        for event in an_hour():
            log(event)
    kept = sorted(path.name for path in (tmp_path / "log").glob("events-*"))
    assert len(kept) == 3 and all((tmp_path / "log" / name).stat().st_size <= 20_000 for name in kept)
    run = read_run(tmp_path / "log")
    assert len(run.minutes) == 65 and 0 < len(run.times_s) < 1000


def test_a_disk_that_fails_stops_the_log_and_no_caller(tmp_path, monkeypatch):
    log = RunLog(tmp_path / "log", ABOUT)
    log(StateChanged(0.0, HOLDING))

    def full(_data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(log, "_write", full)
    log(look(1.0, 0.0, 0.0))
    with pytest.raises(CannotWrite, match=r"not whole.*No space left on device"):
        log.close()


def test_a_disk_that_hangs_costs_events_and_no_time(tmp_path, monkeypatch):
    monkeypatch.setattr(run_log, "_WAITING_MOST", 5)
    log = RunLog(tmp_path / "log", ABOUT)
    hangs, goes_on = threading.Event(), threading.Event()

    def hang(_event: object) -> None:
        hangs.set()
        goes_on.wait()

    monkeypatch.setattr(log, "_write", hang)
    log(look(0.0, 0.0, 0.0))
    hangs.wait()
    for at in range(8):
        log(look(float(at), 0.0, 0.0))
    assert log.lost == 3
    goes_on.set()
    with pytest.raises(CannotWrite, match="3 events are missing: the disk was too slow"):
        log.close()


def test_a_log_never_goes_into_a_folder_that_exists(written):
    with pytest.raises(CannotWrite, match="it exists"):
        RunLog(written, ABOUT)


def test_each_event_is_on_the_disk_while_the_run_goes_on(tmp_path):
    log = RunLog(tmp_path / "log", ABOUT)
    synced = threading.Event()
    sync = log._sync
    log._sync = lambda: (sync(), synced.set())
    log(look(0.0, 1.0, 2.0))
    assert synced.wait(60), "the log was not written while it was open"
    assert len(read_run(tmp_path / "log").times_s) == 1
    log.close()


@pytest.mark.parametrize("line", ["", "3", '{"event":"look"}', '{"event":"nothing"}', "[" * 500, '{"event": 7}'])
def test_a_damaged_line_is_counted_and_left_out(written, tmp_path, line):
    (folder := tmp_path / "log").mkdir()
    (folder / "about.json").write_text("{}")
    (folder / "minutes.jsonl").write_text(f"{line}\n")
    (folder / "events-000001.jsonl").write_text(f"{line}\n{json.dumps({'event': 'state', 'time_s': math.inf})}\n")
    run = read_run(folder)
    assert run.damaged == 3 and not run.minutes


def test_a_folder_without_a_log_is_one_line(tmp_path):
    with pytest.raises(BadFile, match=r"no log of a run \(about.json: No such file or directory\)"):
        read_run(tmp_path)


def test_the_page_tells_it_in_words_and_curves_and_holds_nothing_of_others(written, tmp_path):
    write_report(page := tmp_path / "page.html", read_run(written))
    text = page.read_text()
    assert text.count("<svg") == 5 and 'src="http' not in text and 'href="http' not in text
    assert "&lt;two&gt; mounts" in text and "<two>" not in text
    for words in ("near, µm", "far, µm", "angle of the beam, µrad", "hour 2", "no spot", "near: too dark", "78"):
        assert words in text


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
