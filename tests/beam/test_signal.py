"""`align --signal`: a signal is brought to its maximum, within bounds; its sources; what is refused and told."""

import contextlib
import math
import os
import pty
import sqlite3
import threading
import tty
from collections.abc import Iterator

import numpy as np
import pytest
from fast_table import FastTable

from mirrormount.cli.main import main as command
from mirrormount.device.table_file import CameraSettings
from mirrormount.errors import BadValue, ConnectionLost, MoveEnded
from mirrormount_beam.camera import Image
from mirrormount_beam.control.events import Pulsed, SignalRead
from mirrormount_beam.control.maximise import Maximum, maximise
from mirrormount_beam.errors import SignalDark, SignalError, SignalNotANumber, SignalSaturated
from mirrormount_beam.signals import light_of, open_signal

SLOW_S, MOST_S = 0.01, 600.0  # of a reading; of a run


class Coupled(FastTable):
    """The fast table with a power meter at its fibre, and no cameras."""

    def __init__(self, profile: str, seed: int, mounts: int = 1) -> None:
        super().__init__(profile, seed, mounts=mounts)
        self.cameras = []
        self.events: list = []
        self.readings = 0

    def read(self) -> float:
        self.sleep(SLOW_S)
        self.readings += 1
        return self.truth.fibre_reading(self.now_s())

    def coupled(self) -> float:
        light, most = self.truth.fibre_light(self.now_s())
        return light / most

    def at_rest(self) -> bool:
        return not any(actuator.is_moving() for actuator in self.actuators)


# ---- the maximum


@pytest.mark.parametrize(
    ("profile", "seed", "mounts"),
    [("hardware", 1, 1), ("hardware", 2, 1), ("rough", 1, 1), ("smooth", 1, 1), ("hardware", 1, 2), ("hardware", 6, 2)],
)
def test_a_fibre_with_1_percent_of_the_light_is_coupled_within_ten_minutes(profile, seed, mounts):
    table = Coupled(profile, seed, mounts)
    assert table.coupled() == pytest.approx(0.01, rel=0.5)
    found = maximise(table, table.read)
    assert found.reached and table.coupled() > 0.95
    assert table.now_s() < MOST_S and found.seconds == pytest.approx(table.now_s())
    assert found.begin < 0.02 and found.end > 0.9 and set(found.ways) == {each.name for each in table.actuators}
    assert table.at_rest()


def test_light_that_is_lost_on_the_way_is_found_again():
    table = Coupled("hardware", 1)
    table.at(60.0, lambda: table.truth.bump(0, 120.0, 0.0))  # of the mirror: leaves a third of the light
    found = maximise(table, table.read)
    assert table.coupled() > 0.95 and found.reached


def test_no_axis_goes_beyond_its_limit_and_that_is_told():
    table = Coupled("hardware", 1, mounts=2)
    ways = dict.fromkeys((each.name for each in table.actuators), 0.0)
    farthest = 0.0

    def listen(event) -> None:
        nonlocal farthest
        if isinstance(event, Pulsed):
            ways[event.actuator] += event.us / 200_000
            farthest = max(farthest, abs(ways[event.actuator]))

    found = maximise(table, table.read, listen, limit_steps=1.0)
    assert farthest <= 1.0 + 1e-9
    assert found.bounded and not found.reached
    assert {name: pytest.approx(way) for name, way in ways.items() if way} == found.ways


def test_only_the_axes_that_were_named_are_driven():
    table = Coupled("hardware", 1, mounts=2)
    maximise(table, table.read, table.events.append, axes=["second.x"])
    assert {event.actuator for event in table.events if isinstance(event, Pulsed)} == {"second.x"}


def test_every_mean_is_told_with_its_error_and_best_is_one_of_them():
    table = Coupled("hardware", 1)
    found = maximise(table, table.read, table.events.append)
    told = [event for event in table.events if isinstance(event, SignalRead)]
    assert told[0].value == found.begin and told[-1].value == found.end
    assert max(event.value for event in told) == found.best
    assert all(0 < event.error < 0.05 for event in told)


# ---- what ends it


@pytest.mark.parametrize(
    ("reads", "error"),
    [
        (lambda n: math.nan if n > 100 else 0.5, SignalNotANumber),
        (lambda n: math.inf, SignalNotANumber),
        (lambda n: 65_535.0, SignalSaturated),
        (lambda n: 0.5 + 0.01 * math.sin(n * n), SignalDark),
        (lambda n: -20.0 + 0.01 * math.sin(n * n), SignalDark),
    ],
)
def test_a_signal_that_tells_nothing_ends_it_with_motors_off(reads, error):
    table = Coupled("hardware", 1)
    stopped = []
    table.stop = lambda: stopped.append(table.now_s())
    count = iter(range(1_000_000))

    def read() -> float:
        table.sleep(SLOW_S)
        return reads(next(count))

    with pytest.raises(error):
        maximise(table, read, full_scale=65_520)
    assert stopped == [table.now_s()]


@pytest.mark.parametrize("mounts", [1, 2])
def test_a_beam_that_somebody_blocks_ends_it_and_no_axis_has_gone_far(mounts):
    table = Coupled("hardware", 1, mounts)
    table.at(40.0, lambda: setattr(table.truth.laser, "blocked", True))
    found = Maximum()
    with pytest.raises(SignalDark, match="not above 0"):
        maximise(table, table.read, found=found)
    assert table.now_s() < 300 and max(map(abs, found.ways.values())) < 15


def test_a_board_that_goes_ends_it_with_that_error():
    table = Coupled("hardware", 1)
    gone = ConnectionLost("first: the board is gone")
    table.at(30.0, lambda: setattr(table.actuators[1], "refuses", gone))
    table.at(30.0, lambda: setattr(table.actuators[0], "refuses", gone))
    table.stop = lambda: (_ for _ in ()).throw(gone)
    with pytest.raises(ConnectionLost, match="the board is gone"):
        maximise(table, table.read)


def test_a_move_that_somebody_stops_ends_it_and_what_was_found_is_kept():
    table = Coupled("hardware", 1)
    table.at(30.0, lambda: setattr(table.actuators[0], "ended", "a stop"))
    table.at(30.0, lambda: setattr(table.actuators[1], "ended", "a stop"))
    found = Maximum()
    with pytest.raises(MoveEnded):
        maximise(table, table.read, found=found)
    assert found.pulses > 10 and not found.reached and 30 <= found.seconds < 35


# ---- sources


@contextlib.contextmanager
def meter(answer) -> Iterator[str]:
    """A serial power meter at a pty: answers each line; answer(None): what it sends by itself, or None."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    ending = threading.Event()

    def work() -> None:
        line = b""
        while not ending.is_set():
            try:
                if (told := answer(None)) is not None:
                    os.write(ours, told)
                    ending.wait(0.01)
                    continue
                c = os.read(ours, 1)
            except OSError:
                return
            line += c
            if c == b"\n":
                if (said := answer(line)) is not None:
                    os.write(ours, said)
                line = b""

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        ending.set()
        os.write(theirs, b"\n")
        thread.join(5)
        os.close(ours)
        os.close(theirs)


def of(text: str, **options):
    return open_signal(text, lambda name, question: 1, CameraSettings(), **options)


def test_a_scpi_meter_is_asked_and_answers():
    asked = []

    def answer(line):
        if line:
            asked.append(line)
            return b"1.25E-3\r\n"
        return None

    with meter(answer) as port:
        with of(f"scpi:{port}") as source:
            assert [source.read(), source.read()] == [1.25e-3, 1.25e-3]
        with of(f"scpi:{port}", query="READ?") as source:
            assert source.read() == 1.25e-3
    assert asked[:3] == [b"MEAS:POW?\n", b"MEAS:POW?\n", b"READ?\n"]


def test_a_serial_meter_that_sends_lines_is_read_from_a_whole_line_on():
    count = iter(range(1, 1_000_000))
    with meter(lambda line: b"" if line else b"%d.5 mW\r\n" % next(count)) as port, of(f"serial:{port}") as source:
        first, second = source.read(), source.read()
    assert second > first > 1 and first % 1 == 0.5


@pytest.mark.parametrize(
    ("said", "words"),
    [(b"ERR -113\n", "no number"), (b"1.25", "no answer to MEAS:POW?"), (None, "no answer to MEAS:POW?")],
)
def test_a_meter_that_does_not_answer_with_a_number_is_told_in_a_line(said, words, monkeypatch):
    monkeypatch.setattr("mirrormount_beam.signals._ANSWER_S", 0.2)
    answer = lambda line: said if line else None  # noqa: E731
    with meter(answer) as port, of(f"scpi:{port}") as source, pytest.raises(SignalError, match=words):
        source.read()


@pytest.mark.parametrize("said", [b"9.91E37\n", b"NAN\n", b"-9.9E+37\n"])
def test_a_meter_out_of_its_range_gives_no_number(said):
    with meter(lambda line: said if line else None) as port, of(f"scpi:{port}") as source:
        assert math.isnan(source.read())


def test_a_persons_own_function_is_read_and_its_failure_is_a_line(tmp_path, monkeypatch):
    (tmp_path / "my_meter.py").write_text(
        "def power():\n    return 0.25\n\ndef broken():\n    raise OSError('cable')\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [str(tmp_path)])
    with of("python:my_meter:power") as source:
        assert source.read() == 0.25
    with of("python:my_meter:broken") as source, pytest.raises(SignalError, match=r"my_meter.broken\(\) failed.*cable"):
        source.read()
    with pytest.raises(BadValue, match="nowhere"), of("python:my_meter:nowhere"):
        pass


def test_a_cameras_light_is_the_sum_above_the_dark_of_its_region_and_a_saturated_one_is_refused():
    image = np.full((120, 160), 10, np.uint8)
    image[40:44, 50:54] = 110
    assert light_of(Image(image, 0.0, 0)) == 16 * 100
    image[40:50, 50:60] = 255
    with pytest.raises(SignalSaturated):
        light_of(Image(image, 0.0, 0))


@pytest.mark.parametrize("text", ["power", "scpi:", "serial", "camera:", "python:module", "python:a:b:c", "eval:1+1"])
def test_what_is_no_source_is_refused_with_the_list_of_those_that_are(text):
    with pytest.raises(BadValue, match="--signal is one of board, camera:NAME, scpi:PORT"), of(text):
        pass


# ---- the command


def test_the_command_couples_the_virtual_fibre_and_tells_and_logs_it(tmp_path, capsys):
    log, numbers = tmp_path / "run.log", tmp_path / "run.json"
    words = ["align", "--signal", "fibre", "--virtual", "--mounts", "1", "--log", str(log), "--json", str(numbers)]
    assert command(words) == 0
    told = capsys.readouterr().out
    assert "maximising fibre by first.x, first.y, each at most 40 steps from where it is" in told
    assert "at its maximum: the signal was 0.0" in told and "ways by the motors' drive: first.x" in told
    assert '"reached": true' in numbers.read_text()
    with contextlib.closing(sqlite3.connect(log)) as file:
        kinds = dict(file.execute("SELECT event, count(*) FROM events GROUP BY event"))
    assert kinds["signal"] > 50 and kinds["pulse"] > 50


def test_the_boards_input_sees_the_same_fibre(capsys):
    assert command(["align", "--signal", "board", "--virtual", "--mounts", "1", "--axes", "first.x"]) in (0, 1)
    assert "maximising board by first.x" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--signal", "fibre"], "add --virtual"),
        (["--signal", "scpi:/dev/none", "--virtual"], "of the virtual table is fibre, or board"),
        (["--signal", "fibre", "--virtual", "--axes", "first.z"], "there is no 'first.z'; there are first.x"),
        (["--signal", "fibre", "--virtual", "--limit", "0"], "--limit is more than 0"),
        (["--signal", "board", "--virtual", "--query", "P?"], "--query is a meter's"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(words, told, capsys):
    assert command(["align", *words]) != 0
    error = capsys.readouterr().err
    assert told in error and "Traceback" not in error
