"""The file of `--truth`: one line for each motion of a screw, written when it has come to rest."""

import json

import pytest
from closed_loop import ClosedLoop

from mirrormount.device.mount import Mount
from mirrormount.errors import BadAddress, MountError
from mirrormount_sim.bench import Bench
from mirrormount_sim.board import open_virtual
from mirrormount_sim.profiles import SWITCH_REV
from mirrormount_sim.truth import Orders


@pytest.fixture
def truth(tmp_path):
    """A file, and what its lines say."""
    return Lines(tmp_path / "truth.jsonl")


class Lines:
    def __init__(self, path):
        self.path = path

    def __call__(self):
        return [json.loads(line) for line in self.path.read_text().splitlines()]

    def fresh(self, mount):
        """The lines that have come since this was asked last, once everything is at rest."""
        mount.sleep(0.3)
        lines = self()
        seen, self._seen = getattr(self, "_seen", 0), len(lines)
        return lines[seen:]


def opened(truth, options="") -> Mount:
    return Mount.open(f"virtual://?speed=max&truth={truth.path}{options}")


def opened_port(truth, options=""):
    port = open_virtual(f"virtual://?speed=max&truth={truth.path}{options}")
    port.sleep(1)
    return port


def test_a_move_of_twenty_steps_is_one_line_and_twenty_moves_are_twenty(truth):
    with opened(truth) as mount:
        mount.x.step(20)
        (line,) = truth.fresh(mount)
        assert sorted(line) == ["m1_screw_rev", "m2_screw_rev", "t_us"]
        assert line["m1_screw_rev"] == 0
        for _ in range(20):
            mount.x.step(1)
        assert len(truth.fresh(mount)) == 20


def test_the_line_tells_where_the_screw_stays(truth):
    loop = ClosedLoop("rough", truth=truth.path)
    for n in (3, -5):
        loop.mount.x.step(n)
        (line,) = truth.fresh(loop.mount)
        assert line["m2_screw_rev"] == loop.bench.trains["m2"].screw_rev
        assert line["t_us"] > loop.off_us() - loop.simulation.now_us + loop.simulation.us
    loop.simulation.close()


def test_a_slow_move_is_one_line_while_the_other_axis_makes_many(truth):
    with opened(truth) as mount:
        mount.apply({"x": {"velocity": 0.2}})
        mount.send("2PR4")
        for _ in range(8):
            mount.y.step(1)
        mount.x.wait()
        lines = truth.fresh(mount)
        assert len(lines) == 9
        assert [line["t_us"] for line in lines] == sorted(line["t_us"] for line in lines)


@pytest.mark.parametrize("encoder", ["motor", "shaft"])
def test_corrections_and_the_play_belong_to_their_move(truth, encoder):
    loop = ClosedLoop("rough", truth=truth.path, encoder=encoder, closed=False)
    loop.mount.apply({"x": loop.mount.x.measure_counts().settings})
    truth.fresh(loop.mount)
    for n in (1, -1, 2):
        loop.mount.x.step(n)
        assert len(truth.fresh(loop.mount)) == 1
    loop.simulation.close()


@pytest.mark.parametrize("stop", ["!", "00000000", "ST", "1ST;2AB"])
@pytest.mark.parametrize(
    "order", ["0000+255", "2MV+", "2XU-30000", "2PR2", "1>2pr 1;2PA?", "2PR30", "2MT-"], ids=lambda order: order
)
def test_each_motion_that_is_stopped_is_one_line(truth, order, stop):
    board = opened_port(truth, "&bench=switches")
    board.write(b"2XL3\n")
    for motions in (1, 2):
        for words in (order, stop):
            board.write(words.encode() + b"\n")
            board.sleep(0.9)
        assert len(truth()) == motions
    board.close()


def test_questions_while_a_move_rests_do_not_end_it(truth):
    with opened(truth) as mount:
        mount.send("2PR4")
        for _ in range(40):
            mount.send("2MD?;1TP?")
            mount.send("XK900;2VA1")
            mount.sleep(0.04)
        mount.x.wait()
        assert len(truth.fresh(mount)) == 1


def test_homing_is_one_line(truth):
    loop = ClosedLoop(truth=truth.path, bench="switches", closed=False)
    train = loop.bench.trains["m2"]
    train.shaft_rev = train.output_rev = train.screw_rev = 0.1 - SWITCH_REV
    loop.mount.apply({"x": {"switches": 3}})
    loop.mount.x.home()
    assert len(truth.fresh(loop.mount)) == 1
    loop.simulation.close()


def test_a_stall_is_one_line(truth):
    loop = ClosedLoop(truth=truth.path)
    loop.bench.disturb("m2", "jammed")
    with pytest.raises(MountError, match="stalled"):
        loop.mount.x.step(9)
    assert len(truth.fresh(loop.mount)) == 1
    loop.simulation.close()


def test_a_motion_that_follows_without_a_rest_has_its_own_line(truth):
    board = opened_port(truth)
    for seconds in (0.01, 0.3):  # it coasts for 0.04 s
        board.write(b"0000+255")
        board.sleep(0.3)
        board.write(b"00000000")
        board.sleep(seconds)
    assert len(truth()) == 2
    board.close()


def test_what_turns_when_the_power_goes_has_its_line(truth):
    with opened(truth) as mount:
        mount.send("1MV+")
        mount.sleep(0.3)
    assert len(truth()) == 1


def test_a_dimmed_motor_has_one_line_a_motion():
    ends = []
    bench = Bench()
    bench.on_rest = lambda us, motor, screws: ends.append((us, motor, screws))
    bench.edge(0, "m1_pos", 65535)
    for period in range(400):  # 4 kHz at a tenth of full duty, as pin edges of the emulated RP2040 show it
        bench.edge(period * 250, "m1_en", 65535)
        bench.edge(period * 250 + 25, "m1_en", 0)
    bench.advance(1_000_000)
    assert len(ends) == 1


def test_orders_are_found_however_the_bytes_are_split():
    data = b"1XE?;2PR3\n\r\n0255-100!1ST;hostname 8742;3>1mv+\r255-\r2XP300\n"
    for size in (1, 2, 3, 7, len(data)):
        orders, found = Orders(), []
        for at in range(0, len(data), size):
            found += orders.read(data[at : at + size])
        assert found == ["2", "", "1", ""], size
    assert orders.read(b"0255-100") == []
    assert orders.pending() == [""]
    orders.read(b"1PR")
    assert orders.pending() == []


def test_a_file_that_cannot_be_written_is_told_in_one_line(tmp_path):
    with pytest.raises(BadAddress, match=r"^cannot write the truth to [^\n]*$"):
        open_virtual(f"virtual://?truth={tmp_path}/none/f")
