"""The fast lane: a frame drives when its last byte is read, and is booked after. The lane is lane_rig.py's."""

from lane_rig import LaneRig
from rig import Rig
from test_memory import SESSION

from mountfw import codes
from mountfw.wire.receiver import STOP
from mountfw.wire.ticks import diff

ENABLES = (2, 5)


def on_times(rig, pin):
    return [us for us, number, duty in rig.port.edges if number == pin and duty]


def on_at(rig, pin):
    return on_times(rig, pin)[-1]


def reasons(rig):
    return [axis.reason for axis in rig.axes]


def test_a_frame_drives_both_motors_before_it_is_booked():
    rig = LaneRig()
    rig.ask(b"0100-1000000-100!\n")  # what comes first takes the record of the position off
    rig.run(200_000)
    book, seen = rig.looks.book, []

    def noted():
        if rig.looks.log[0]:
            seen.append((rig.drives(), [axis.state for axis in rig.axes]))
        return book()

    rig.looks.book = noted
    rig.send(b"0255-100")
    rig.settle()
    assert seen == [((255, -100), [0, 0])]
    assert rig.drives() == (255, -100)


def driven(rig, data, us):
    """Positions, reasons and the on-time of the last move after data and a stop us later."""
    rig.send(data)
    rig.run(us)
    rig.ask(b"!\n")
    return [(axis.position.millisteps, axis.reason, axis.ended_steps) for axis in rig.axes]


def test_a_frame_is_counted_as_without_the_lane():
    for data in (b"02550255", b"-255-100", b"+1000000", b"0000-077"):
        found = []
        for make in (LaneRig, Rig):
            rig = make()
            rig.ask(b"1XP1000;2XP1000;1DH0;2DH0;0100-100!\n")
            found.append(driven(rig, data, 500_000))
        for (lane, *rest), (core, *same) in zip(found[0], found[1]):
            assert rest == same and abs(lane - core) < 500, (data, found)


def test_frames_of_a_stream_all_reach_the_pins_in_their_order():
    rig = LaneRig()
    rig.ask(b"0100-100!\n")
    rig.run(3_000_000)
    rig.port.reading = False
    rig.port.edges.clear()
    speeds = [10 + i for i in range(200)]
    for i, n in enumerate(speeds):
        rig.send(b"0%03d-%03d" % (n, n), after_us=1000 * i)
    rig.take_in()
    rig.settle()
    shown = [duty // 257 for _, pin, duty in rig.port.edges if pin == 2 and duty]
    assert shown == speeds


def test_frames_of_a_fast_stream_are_counted_many_at_once_so_that_each_drives_at_once():
    rig = LaneRig()
    rig.ask(b"0100-100!\n")
    rig.run(3_000_000)
    rig.port.edges.clear()
    lane, sizes = rig.app._input, []
    book = lane.book
    lane.book = lambda: (sizes.append(lane.log[0]) if lane.log[0] else None, book())[1]
    sent_at = rig.now()
    for i in range(200):
        rig.send(b"0%03d-%03d" % (10 + i, 10 + i), after_us=400 * max(1, i))  # two at once: that is a stream
    rig.take_in()
    rig.settle()
    late_us = sorted(us - sent_at - 400 * i for i, us in enumerate(on_times(rig, ENABLES[0])))
    assert max(sizes) > 8 and len(sizes) < 100
    assert len(late_us) == 200 and late_us[100] < 500


def test_frames_wait_to_be_counted_only_where_no_deadline_can_come_meanwhile():
    rig = LaneRig()
    lane = rig.app._input
    assert lane.linger() > 10_000
    rig.ask(b"2XM50\n")
    assert lane.linger() == 1, "a run that ends so soon is not waited with"
    rig.ask(b"2XM10000\n")
    assert lane.linger() > 10_000
    rig.ask(b"1PR1\n")
    assert lane.linger() == 1, "a gate ends that pulse when it is over, whatever drives then"


def test_a_stop_that_comes_between_two_readings_of_a_line_is_told():
    rig = LaneRig()
    rig.send(b"1XP?;2XP?\n")
    assert rig.app._input.read(16, -1) == 0 and rig.app._receiver.unparsed == 10
    rig.send(b"!", after_us=7)  # a reading takes 5 us here: it comes after the first, and before the second
    assert rig.app._input.read(16, 0) == STOP and rig.app._receiver.stops_ahead == 1


def test_no_stream_keeps_the_loop_from_feeding_the_watchdog():
    for spacing_us in range(400, 2000, 100):
        rig = LaneRig()
        rig.ask(b"0100-100!\n")
        lane, fed = rig.app._input, []
        book = lane.book

        def slow(rig=rig, book=book):
            booked = book()
            rig.port.us += 2_000 * booked
            return booked

        lane.book = slow
        rig.app._feed = lambda rig=rig, fed=fed: fed.append(rig.now())
        for i in range(1_000_000 // spacing_us):
            rig.send(b"0255-255", after_us=spacing_us * i)
        rig.run(1_000_000)
        assert len(fed) > 10 and max([b - a for a, b in zip(fed, fed[1:])]) < 100_000, spacing_us


def test_more_frames_at_once_than_the_log_holds_are_all_obeyed():
    rig = LaneRig()
    rig.ask(b"0100-100!\n")
    rig.run(100_000)
    rig.port.edges.clear()
    speeds = [1 + i for i in range(60)]
    rig.send(b"".join([b"0%03d0000" % n for n in speeds]))
    rig.settle()
    assert [duty // 257 for _, pin, duty in rig.port.edges if pin == 2 and duty] == speeds


def test_a_stop_behind_frames_ends_them_and_nothing_drives_after_it():
    for stop in (b"!", b"00000000"):
        rig = LaneRig()
        rig.ask(b"0100-100!\n")
        rig.run(100_000)
        rig.send(b"02550255-255-255" + stop)
        rig.settle()
        assert rig.drives() == (0, 0) and not rig.controller.moving()
        assert reasons(rig) == [codes.ABORTED if stop == b"!" else codes.STOPPED] * 2


def test_a_stop_that_comes_while_frames_are_booked_ends_them():
    for after_us in range(0, 3000, 20):
        rig = LaneRig()
        rig.ask(b"0100-100!\n")
        rig.run(100_000)
        rig.send(b"02550255-255-255")
        rig.send(b"!", after_us=500 + after_us)
        rig.settle()
        assert rig.drives() == (0, 0) and not rig.controller.moving(), after_us
        assert reasons(rig) == [codes.ABORTED] * 2, after_us


def refused(rig, data, drives):
    """These bytes are obeyed, and the lane takes no frame of them."""
    taken = rig.looks.taken
    rig.send(data)
    rig.settle()
    rig.run(100_000)
    assert rig.looks.taken == taken and rig.drives() == drives, data


def test_a_stop_that_comes_right_before_a_pulse_ends_does_not_wait_for_its_end():
    # the native bridge looks for a byte while it waits for a pulse's end, and the drive then reads it
    rig = LaneRig()
    rig.ask(b"1XP5000\n")
    port, bridge = rig.port, rig.axis1.drive.bridge
    cut_at = bridge.cut_at

    def cut_at_or_byte(us):
        while diff(us, port.ticks_us()) > 32:
            if port.next_us() <= port.us:
                return -1
        return cut_at(us)

    bridge.cut_at = cut_at_or_byte
    rig.send(b"1PR1\n")
    rig.run(1_000)
    port.edges.clear()
    ends_at = rig.axis1.drive.ends_at
    rig.send(b"!", after_us=diff(ends_at, port.ticks_us()) - 150)
    rig.run(6_000)
    assert -150 < diff(rig.axis1.drive.cut_at, ends_at) < -30
    assert reasons(rig)[0] == codes.ABORTED and rig.drives() == (0, 0)


def test_what_has_something_before_it_waits_for_its_turn():
    rig = LaneRig()
    rig.ask(b"1DH7\n")
    rig.run(10_800_000)
    assert "mountfw.position" in rig.port.files
    refused(rig, b"02550255", (255, 255))  # the record of the position comes off the flash first
    assert "mountfw.position" not in rig.port.files
    rig.run(3_000_000)
    rig.ask(b"!\n")
    refused(rig, b"+000-000", (0, 0))  # a stop for all axes
    rig.ask(b"1XL3\n")
    rig.port.switches.update({10: 0, 11: 0})
    refused(rig, b"02550100", (255, 100))  # an end-stop is to be looked at
    assert rig.looks.taken == 0


def test_the_first_frame_is_taken_where_no_position_is_recorded():
    rig = LaneRig()
    rig.run(11_000_000)
    assert "mountfw.position" not in rig.port.files  # nothing has moved since the start
    rig.ask(b"02550255")
    assert rig.looks.taken == 1 and rig.drives() == (255, 255)


def test_a_frame_behind_a_line_waits_until_the_line_is_done():
    rig = LaneRig()
    rig.ask(b"0100-100!\n")
    rig.run(100_000)
    rig.send(b"1XP5000;2XP5000;1XP?;2XP?\n0100-100")
    rig.settle()
    assert rig.axis1.pulse_us == 5000 and rig.drives() == (100, -100)


def test_an_inverted_axis_turns_the_other_way():
    for make in (LaneRig, Rig):
        rig = make()
        rig.ask(b"1XI1\n0100-100!\n")
        rig.run(100_000)
        rig.ask(b"0255-100")
        assert rig.drives() == (-255, -100)


def test_ctrl_c_before_frames_are_booked_leaves_the_positions_unknown():
    rig = LaneRig()
    rig.ask(b"1DH0;2DH0\n0100-100!\n")
    rig.run(100_000)

    def interrupted():
        if rig.app._input.log[0]:
            raise KeyboardInterrupt

    rig.app._input.book = interrupted
    rig.send(b"02550255")
    try:
        rig.run(50_000)
    except KeyboardInterrupt:
        rig.app._leave(codes.ABORTED)
    assert rig.drives() == (0, 0)
    assert [axis.position.certainty for axis in rig.axes] == [codes.UNKNOWN] * 2


def test_with_a_gate_a_drive_ends_at_its_limit_and_the_stop_is_where_the_gate_has_cut():
    rig = LaneRig(gated=True)
    rig.ask(b"1XM70;2XM90\n0100-100!\n")
    rig.run(100_000)
    rig.send(b"02550100")
    rig.take_in()
    rig.run(200_000)
    assert reasons(rig) == [codes.RUN_LIMIT] * 2
    assert [round(axis.ended_on_us, -2) for axis in rig.axes] == [70_000, 90_000]


def test_the_lane_allocates_nothing():
    rig = LaneRig()
    rig.port.locked = True
    for data in SESSION + (b"0255-100" * 20, b"0100-100-2000200", b"0100", b"-100", b"01000000" * 3, b"0100-100!"):
        rig.send(data)
        rig.settle()
        rig.run(300_000)
    assert rig.looks.taken > 20


def test_the_silence_of_a_keep_alive_begins_with_the_last_byte_not_when_its_frame_is_taken():
    """The frame waits in the ring until the line before it is executed."""
    late_us = []
    for make in (LaneRig, Rig):
        rig = make()
        rig.ask(b"0100-100!\n")
        rig.run(200_000)
        sent_at = rig.now()
        rig.send(b"XK500" + 20 * b";XS?" + b"\n0255-255")
        rig.run(600_000)
        assert rig.drives() == (0, 0) and reasons(rig) == [codes.KEEP_ALIVE] * 2
        late_us.append(max([us for us, pin, duty in rig.port.edges if pin in ENABLES and not duty]) - sent_at - 500_000)
    assert late_us[0] <= late_us[1] + 1000, late_us
