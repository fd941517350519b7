"""A board that answers what no mount answers: one clear line, nothing that controls a terminal, and the motors off."""

import io
import random

import pytest

from mirrormount.cli import main
from mirrormount.device import mount, session
from mirrormount_sim.board import LockstepPort, open_virtual

ODD = (
    b"",
    b"\x1b]0;title\x07\x1b[2J",
    b"9" * 5000,
    b"9" * 30,
    b"nan",
    b"1e999",
    b"-",
    b"0",
    b"0; 0",
    b"; ; ; ;",
    b"0,0,0|0|0",
    b"7,1,0|0,0,0,0,99,9|0,0,0,0,1,1",
    b"\xff\xfe\x00",
    b"x" * 200_000,  # without an end
    None,  # nothing
)
COMMANDS = (
    ("status",),
    ("step", "x", "2"),
    ("move", "y", "-1"),
    ("jog", "x", "0.5", "--seconds", "0.3"),
    ("drive", "99", "0", "--seconds", "0.2"),
    ("home", "x"),
    ("send", "2PR1;2TP?"),
    ("config", "get"),
    ("config", "set", "x.pulse_us", "1000"),
    ("check", "--move"),
    ("stop",),
)


class OddPort:
    """A virtual board whose answer number `odd_at` is another one; from there on all are, if it stays so."""

    lockstep = True

    def __init__(self, odd: bytes | None, odd_at: int, *, stays: bool) -> None:
        port = open_virtual("virtual://?speed=max")
        assert isinstance(port, LockstepPort)
        self._port, self._odd, self._odd_at, self._stays = port, odd, odd_at, stays
        self.simulation, self.monotonic, self.sleep = port.simulation, port.monotonic, port.sleep
        self._part = b""
        self._answers = 0
        self.sent = b""
        self.left_on: list[str] = []

    def write(self, data: bytes) -> None:
        self.sent += data
        self._port.write(data)

    def read(self, timeout_s: float) -> bytes:
        *lines, self._part = (self._part + self._port.read(timeout_s)).split(b"\n")
        return b"".join(map(self._answer, lines))

    def _answer(self, line: bytes) -> bytes:
        self._answers += 1
        if not (self._answers == self._odd_at or (self._stays and self._answers > self._odd_at)):
            return line + b"\n"
        if self._odd is None or len(self._odd) > 100_000:
            return self._odd or b""
        return self._odd + b"\r\n"

    def close(self) -> None:
        self.left_on = [pin for pin, duty in self.simulation.bench.duties().items() if pin.endswith("_en") and duty]
        self._port.close()


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_an_odd_answer_is_one_line_and_nothing_is_left_running(monkeypatch, capsys, words):
    chance = random.Random(" ".join(words))
    for odd in chance.sample(ODD, 6):  # another six for each command
        port = OddPort(odd, chance.randint(2, 20), stays=chance.random() < 0.5)
        for module in (mount, session):
            monkeypatch.setattr(module, "open_port", lambda _address, port=port: port)
        monkeypatch.setattr("sys.stdin", io.StringIO())
        status = main.main([*words, "--port", "virtual://?speed=max"])
        said = capsys.readouterr()
        assert status in (0, 1)
        assert "\x1b" not in said.out + said.err and "\x07" not in said.out + said.err
        assert said.err.count("mirrormount: ") == (status == 1), said.err
        assert port.left_on == []
        assert b"!" in port.sent


def test_what_an_instrument_answers_to_who_it_is_cannot_control_a_terminal(monkeypatch, capsys):
    port = OddPort(b"mirrormount,\x1b]0;evil\x07,e661,0.1.0", 1, stays=False)
    monkeypatch.setattr(mount, "open_port", lambda _address: port)
    assert main.main(["status", "--port", "virtual://?speed=max"]) == 0
    out = capsys.readouterr().out
    assert r"mirrormount,\x1b]0;evil\x07,e661,0.1.0" in out and "\x1b" not in out
