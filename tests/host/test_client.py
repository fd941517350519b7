"""Mount and Axis on a virtual board in lockstep: what a program asks for is what the pins do."""

from itertools import pairwise

import pytest

from mirrormount import errors
from mirrormount.device.mount import Mount
from mirrormount.device.status import Ended
from mirrormount.transport.link import Link


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


def pulses(mount: Mount, pin: str) -> list[int]:
    """On-times of a pin so far, in microseconds."""
    edges = [(t, duty) for t, p, duty in mount.link.port.simulation.edges if p == pin]
    return [off - on for (on, duty), (off, _) in pairwise(edges) if duty]


def test_steps_are_pulses_on_the_axis_own_pins(mount):
    mount.x.step(3)
    mount.y.step(-2)
    assert [round(us, -3) for us in pulses(mount, "m2_en")] == [200_000] * 3
    assert [round(us, -3) for us in pulses(mount, "m2_pos")] == [200_000] * 3
    assert [round(us, -3) for us in pulses(mount, "m1_neg")] == [200_000] * 2
    assert (mount.x.position, mount.y.position) == (3, -2)


def test_right_and_up_are_positive(mount):
    mount.x.step(5)
    mount.y.step(5)
    right, up = mount.link.port.simulation.bench.spot_mm()
    assert right > 5 and up > 5


def test_the_axes_can_be_wired_the_other_way_round():
    with Mount.open("virtual://?speed=max") as mount:
        assert (mount.x.number, mount.y.number) == (2, 1)
    with Mount(Link(_port()), x_axis=1) as mount:
        mount.x.step(1)
        assert pulses(mount, "m1_en") and not pulses(mount, "m2_en")


def _port():
    from mirrormount.transport.ports import open_port

    return open_port("virtual://?speed=max")


def test_move_to_goes_to_a_position_and_back(mount):
    mount.x.move_to(4)
    mount.x.move_to(-1)
    assert mount.x.position == -1
    assert len(pulses(mount, "m2_pos")) == 4
    assert len(pulses(mount, "m2_neg")) == 5


def test_a_position_between_steps_is_reached_by_a_pulse_of_its_own_length(mount):
    mount.x.zero()
    mount.x.step(1)
    assert mount.x.move_to(3.25) == 3.25
    assert mount.x.status().certainty == "estimated"
    assert mount.x.move_to(3.25) == 3.25
    assert len(pulses(mount, "m2_pos")) == 4  # nothing for nothing
    assert mount.x.move_to(-0.5) == pytest.approx(-0.5)
    assert mount.x.move_to(0) == pytest.approx(0)
    assert mount.ask("2XP?;2TP?") == "200000; 0"


def test_a_jogs_end_can_be_returned_to(mount):
    mount.x.jog(-0.7)
    mount.sleep(0.333)
    mount.stop()
    mount.x.wait()
    here = mount.x.position
    assert here != round(here)
    assert mount.x.move_to(here) == here
    mount.x.move_to(2)
    assert mount.x.move_to(here) == pytest.approx(here, abs=0.0011)


def test_less_than_the_shortest_pulse_is_left_over_and_returned(mount):
    mount.send("2XP1000")
    assert mount.x.move_to(2.15) == 2
    assert mount.x.move_to(2.2) == pytest.approx(2.2)
    assert mount.x.status().position == pytest.approx(2.2)


def test_without_waiting_a_position_is_whole(mount):
    with pytest.raises(errors.BadValue, match="without waiting"):
        mount.x.move_to(1.5, wait=False)
    assert mount.x.move_to(1.0, wait=False) == 1
    mount.x.wait()
    assert mount.x.position == 1


def test_a_stop_between_the_steps_and_the_last_pulse_keeps_that_from_starting(mount, monkeypatch):
    wait = type(mount.x)._wait_until_done

    def wait_and_stop(*arguments):
        wait(*arguments)
        mount.stop()

    monkeypatch.setattr(type(mount.x), "_wait_until_done", wait_and_stop)
    with pytest.raises(errors.MoveEnded):
        mount.x.move_to(1.5)
    assert len(pulses(mount, "m2_pos")) == 1


def test_a_mount_that_was_closed_says_so_and_not_that_the_board_has_gone():
    mount = Mount.open("virtual://?speed=max")
    mount.close()
    for call in (mount.stop, mount.status, lambda: mount.x.step(1), lambda: mount.drive(1, 1)):
        with pytest.raises(errors.ConnectionLost, match="this Mount was closed"):
            call()


def test_a_setting_that_an_axis_has_not_is_no_place_to_keep_a_number(mount):
    with pytest.raises(AttributeError, match="speed"):
        mount.x.speed = 1


def test_soft_limits_that_are_no_limits_are_one_line(mount):
    for wrong in ((-4, 4), None, 5):
        with pytest.raises(errors.BadValue, match=r"Limits\(minimum, maximum\)"):
            mount.x.limits = wrong


def test_a_jog_runs_at_its_duty_until_stopped_and_leaves_the_stored_duty_alone(mount):
    mount.y.jog(-0.4)
    mount.sleep(0.7)
    mount.stop()
    assert mount.y.wait().reason == 3
    duties = [duty for _, pin, duty in mount.link.port.simulation.edges if pin == "m1_en" and duty]
    assert duties == [102 * 257]
    assert mount.ask("1XV?") == "255"


def test_a_jog_may_follow_a_jog(mount):
    mount.x.jog(0.5)
    mount.sleep(0.2)
    mount.x.jog(-1)
    mount.sleep(0.2)
    assert mount.x.status().direction == -1


def test_drive_takes_the_wires_order_and_both_motors(mount):
    mount.drive(255, -100)
    mount.sleep(0.1)
    edges = {(pin, duty) for _, pin, duty in mount.link.port.simulation.edges}
    assert {("m1_en", 65535), ("m1_pos", 65535), ("m2_en", 100 * 257), ("m2_neg", 65535)} <= edges
    mount.drive(0, 0)
    assert not mount.status().moving


def test_leaving_the_block_stops():
    with Mount.open("virtual://?speed=max") as mount:
        simulation = mount.link.port.simulation
        mount.x.jog(1)
    assert simulation.edges[-2][1:] == ("m2_en", 0)


def test_an_exception_in_the_block_stops_and_comes_through():
    with pytest.raises(ZeroDivisionError), Mount.open("virtual://?speed=max") as mount:  # noqa: PT012
        simulation = mount.link.port.simulation
        mount.x.jog(1)
        _ = 1 / 0
    assert simulation.edges[-2][1:] == ("m2_en", 0)


def test_a_soft_stop_of_one_axis_leaves_the_other(mount):
    mount.x.jog(1)
    mount.y.jog(1)
    mount.sleep(0.1)
    mount.x.stop()
    assert not mount.status().x.moving
    assert mount.status().y.moving


def test_wait_tells_how_the_move_ended(mount):
    mount.x.step(2, wait=False)
    assert mount.status().x.moving
    ended = mount.x.wait()
    assert isinstance(ended, Ended)
    assert (ended.reason, ended.steps) == (1, 2)
    assert ended.on_time_s == pytest.approx(0.4, abs=1e-3)


@pytest.mark.parametrize("steps", ["5", 1.5, True, None, 1_000_001])
def test_a_step_count_that_is_none_is_refused_before_anything_is_sent(mount, steps):
    before = len(mount.link.port.simulation.edges)
    with pytest.raises(errors.BadValue):
        mount.x.step(steps)
    assert len(mount.link.port.simulation.edges) == before


@pytest.mark.parametrize("address", [5, b"virtual://"])
def test_an_address_that_is_no_text_is_refused(address):
    with pytest.raises(errors.BadValue):
        Mount.open(address)


def test_a_closed_mount_says_so():
    with Mount.open("virtual://?speed=max") as mount:
        pass
    with pytest.raises(errors.ConnectionLost):
        mount.x.step(1)


@pytest.mark.parametrize("seconds", ["a", -1, float("nan")])
def test_a_time_that_is_none_is_refused(mount, seconds):
    with pytest.raises(errors.BadValue):
        mount.sleep(seconds)


def test_zero_makes_a_position_certain(mount):
    mount.x.step(2)
    assert mount.x.status().certainty == "unknown"
    mount.x.zero()
    mount.x.step(2)
    assert (mount.x.position, mount.x.status().certainty) == (2, "counted")


@pytest.mark.parametrize("speed", [0, 1.01, -2, "fast", True, float("nan")])
def test_a_jog_speed_that_is_none_is_refused(mount, speed):
    with pytest.raises(errors.BadValue):
        mount.x.jog(speed)
    assert not mount.status().moving


@pytest.mark.parametrize("speeds", [(256, 0), (0, -256), (0.5, 0), ("255", 0)])
def test_a_drive_outside_its_range_is_refused(mount, speeds):
    with pytest.raises(errors.BadValue):
        mount.drive(*speeds)
    assert not mount.status().moving


def test_a_drive_is_not_refused_for_an_old_error_and_not_left_running_for_a_new_one(mount):
    mount.send("2XM300")
    mount.drive(0, 255)
    mount.link.sleep(0.4)
    mount.drive(100, 0)  # the run limit that waits to be told is not this drive's
    assert mount.status().y.moving
    mount.stop()
    mount.link.port.simulation.bench.has_switches = True
    mount.send("2XL3")
    mount.link.port.simulation.bench.horizontal.screw_rev = 2.0
    mount.link.port.simulation.bench.horizontal.shaft_rev = 2.0
    with pytest.raises(errors.BoardError) as refusal:
        mount.drive(100, 255)
    assert refusal.value.code == 204
    assert not mount.status().moving


def test_a_drives_end_is_waited_for_with_its_own_time(mount):
    mount.x.step(1)
    mount.sleep(6)
    mount.drive(0, 255)
    assert mount.x.wait().reason == 6


def test_a_jog_takes_over_from_a_step(mount):
    mount.x.step(3, wait=False)
    mount.link.sleep(0.05)
    mount.x.jog(-1)
    assert mount.x.status().direction == -1


def test_what_the_board_refuses_is_one_error_with_its_number(mount):
    mount.x.jog(1)
    with pytest.raises(errors.BoardError) as refusal:
        mount.x.step(1)
    assert refusal.value.code == 214
    mount.stop()
    mount.x.zero(1)
    with pytest.raises(errors.BoardError) as refusal:
        mount.x.step(999_999)
    assert refusal.value.code == 201
    assert "\n" not in str(refusal.value)


def test_an_old_error_is_not_taken_for_a_refusal(mount):
    mount.ask("AT;XK?")
    mount.x.step(1)
    assert mount.x.position == 1


def test_a_move_that_somebody_else_ends_is_not_called_done(mount):
    mount.link.port.simulation.bench.has_switches = True
    mount.ask("2XL3;XK?")
    mount.link.port.simulation.bench.horizontal.screw_rev = 1.47
    mount.link.port.simulation.bench.horizontal.shaft_rev = 1.47
    with pytest.raises(errors.MoveEnded, match=r"end-stop .*of 20 steps .*204") as ended:
        mount.x.step(20)
    assert ended.value.reason == 4
    assert not mount.status().moving
    mount.x.step(-2)  # the way out is open


def test_an_answer_that_ctrl_c_has_cut_is_not_taken_for_the_next_one(mount, monkeypatch):
    port = mount.link.port
    read, cut = port.read, []

    def interrupted(timeout_s: float) -> bytes:
        cut.append(read(timeout_s))
        monkeypatch.setattr(port, "read", late)
        raise KeyboardInterrupt

    def late(timeout_s: float) -> bytes:
        """The rest of the answer comes after some silence."""
        if timeout_s < 0.05:
            return b""
        monkeypatch.setattr(port, "read", read)
        return cut[0][-9:] + read(timeout_s)

    monkeypatch.setattr(port, "read", interrupted)
    with pytest.raises(KeyboardInterrupt):
        mount.status()
    mount.stop()
    assert not mount.status().moving


def test_queued_errors_are_read_with_number_and_text(mount):
    mount.ask("AT;1XP5;XK?")
    assert [(error.code, error.text) for error in mount.errors()] == [
        (6, "COMMAND DOES NOT EXIST"),
        (7, "PARAMETER OUT OF RANGE"),
    ]
    assert mount.errors() == []


def test_an_axis_answers_queries_of_its_own(mount):
    mount.send("2XP1000;2VA1.5")
    assert mount.x.ask("XP?", "VA?") == ["1000", "1.5"]
    assert mount.x.ask_whole("XP?", "XD?") == [1000, 255]
    with pytest.raises(errors.BoardError, match="6"):
        mount.x.ask("AT?")
    with pytest.raises(errors.NotAMount):
        mount.x.ask_whole("VA?")


def test_a_board_that_restarts_is_noticed(mount):
    mount.status()
    mount.session.board._boot_id ^= 1  # as if the next answer came from another boot
    with pytest.raises(errors.ConnectionLost, match="restarted \\(power, or its reset pin\\)"):
        mount.x.step(1)


def test_a_reset_in_place_makes_all_as_at_power_up_and_is_not_taken_for_a_restart(mount):
    mount.x.step(1)
    mount.send("2XP1000;2DH5")
    before = mount.status().boot_id
    mount.reset()
    status = mount.status()
    assert status.boot_id != before
    assert (status.x.position, status.x.certainty) == (0, "unknown")
    assert mount.ask("2XP?") == "200000"


def test_a_drv8833_board_moves_the_spot_too():
    with Mount.open("virtual://?speed=max&board=pico_drv8833") as mount:
        mount.x.step(5)
        assert mount.link.port.simulation.bench.spot_mm()[0] > 5


@pytest.mark.parametrize(
    "address",
    [
        "virtual://?speed=2",
        "virtual://?bench=none",
        "virtual://?board=uno",
        "virtual://?x=1",
        "virtual://?seed=a",
    ],
)
def test_a_virtual_address_with_an_unknown_option_is_refused(address):
    with pytest.raises(errors.BadAddress):
        Mount.open(address)


def test_what_is_no_text_or_starts_a_motion_is_no_query(mount):
    for query in (None, b"XS?", "2MV+;XS?", "XS?\n"):
        with pytest.raises(errors.BadValue):
            mount.ask(query)
    for line in (None, b"1PR1", "", "\u00e9"):
        with pytest.raises(errors.BadValue):
            mount.send(line)
    assert mount.link.port.simulation.edges == []
