"""`check --timing` on the emulated RP2040: what the board has timed is what the pin log shows."""

import json

import pytest
from lab import ENABLES, on_times_us

from mirrormount.cli import main, timing
from mirrormount.deploy.prompt import SENT, StopAnswer
from mirrormount.errors import CheckFailed
from mirrormount.transport.link import Link
from mirrormount_sim.board import LockstepPort

WITHIN_US = 2
ANSWER_US = 20_000_000
UID = "e6616408432f5a21"  # of the emulated board


def test_the_board_times_its_own_pins_as_the_pin_log_does_and_is_left_as_it_was(make_board, tmp_path):
    board = make_board("rp2040")
    firmware = board.ask(b"XF?\n", ANSWER_US)
    began_us = board.simulation.us
    told, seen = timing.timed(Link(LockstepPort(board.simulation, board)), StopAnswer(), 2)
    edges = [edge for edge in board.edges_after(began_us) if edge[1] in ENABLES]

    rises = [us for us, _, duty in edges if duty]
    offset_us = rises[0] - seen.changes[0].us  # of the log's clock, which begins at power-up
    timed = [change.us + offset_us for change in seen.changes]
    logged = [us for us, _, _ in edges if us <= timed[-1] + WITHIN_US]
    assert len(timed) > 50
    assert all(min(abs(us - other) for other in logged) <= WITHIN_US for us in timed)
    assert all(min(abs(us - other) for other in timed) <= WITHIN_US for us in logged)
    rows = {row["name"]: row["board"]["values"] for row in told["rows"] if row["board"]}
    first, shortest, second, again = on_times_us(edges, "m1_en")[:4]
    long, longer = timing.LENGTHS_US[:2]
    assert rows["pulse"][::2] == pytest.approx([first - long, second - longer], abs=WITHIN_US)
    assert rows["pulse-shortest"] == pytest.approx([us - timing.SHORTEST_US for us in (shortest, again)], abs=WITHIN_US)

    board.simulation.lit = False
    board.boot()
    assert board.ask(b"XF?\n", ANSWER_US) == firmware.replace(b"\0", b"")
    assert b"sha256-" in firmware
    assert board.off()
    data, page = timing.write(told, tmp_path / "report")
    assert json.loads(data.read_text(encoding="utf-8"))["rows"][0]["name"] == "frame-burst"
    assert UID not in data.read_text(encoding="utf-8") + page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "why"),
    [((), "switch the motors' supply off"), (("--supply-off",), "only MicroPython on an RP2040")],
)
def test_nothing_is_timed_on_another_board_or_unless_the_supply_is_said_to_be_off(words, why, capsys, tmp_path):
    address = "virtual://?speed=max"
    assert main.main(["check", "--timing", *words, "--port", address, "--report", str(tmp_path / "report")]) == 1
    assert why in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_what_is_code_in_a_row_is_code_on_the_page(tmp_path):
    told = timing.report({"board": "a <board>"}, {"pulse": [-3.0, 1.0]}, [2.0])
    page = timing.write(told, tmp_path / "report")[1].read_text(encoding="utf-8")
    assert "a &lt;board&gt;" in page and "<code>!</code> to both enables low" in page and "`" not in page


def test_after_a_stop_nothing_more_is_driven():
    class Wire:
        def __init__(self):
            self.port, self.sent = self, []

        def write(self, data):
            self.sent.append(data)

        def sleep(self, _seconds):
            pass

    wire, stops = Wire(), StopAnswer()
    stops.asking(wire)
    assert stops.stop() == SENT
    with pytest.raises(CheckFailed, match="somebody stopped the board"):
        timing.Trials(wire, stops).frame(0)
    assert set(wire.sent) == {b"!\n"}
