"""XU: one pulse of its own length. Runs under CPython and MicroPython."""

from rig import Rig

COUNTED = 1
ESTIMATED = 3


def ready(setup=b""):
    rig = Rig()
    rig.ask(b"1VA4;1DH0;2DH0\n" + setup)
    rig.port.edges.clear()
    return rig


def test_a_pulse_has_its_own_length_and_duty_and_counts_by_its_time():
    for us, steps in ((200, 1), (3_000, 15), (100_000, 500), (250_000, 1250), (2_000_000, 10_000)):
        for sign, way in ((b"", 1), (b"-", -1)):
            rig = ready(b"1XD102\n")
            rig.send(b"1XU" + sign + b"%d\n" % us)
            rig.run(us + 200_000)
            times = rig.on_times(2)
            assert len(times) == 1 and abs(times[0] - us) < 60, (us, times)
            assert {duty for _, pin, duty in rig.port.edges if pin == 2} == {0, 102 * 257}
            assert rig.axis1.position.millisteps == way * steps, us
            assert rig.axis1.position.certainty == ESTIMATED
            reason, made, on_us = rig.ask(b"1XE?\n").split(b",")
            assert (reason, int(made)) == (b"1", way * (steps // 1000))
            assert abs(int(on_us) - us) < 60


def test_a_pulse_as_long_as_a_step_is_a_step():
    rig = ready()
    rig.ask(b"1XU-200000\n")
    rig.run(300_000)
    assert rig.ask(b"1TP?;1PA?\n") == b"-1; -1\r\n"
    assert rig.axis1.position.certainty == COUNTED
    rig.ask(b"1PR1\n")
    rig.run(600_000)
    assert rig.ask(b"1TP?\n") == b"0\r\n"


def test_what_is_unknown_stays_unknown():
    rig = Rig()
    rig.ask(b"1XU50000\n")
    rig.run(300_000)
    assert rig.axis1.position.certainty == 0
    assert rig.axis1.position.millisteps == 250


def test_the_backlash_is_taken_up_first():
    rig = Rig()
    rig.ask(b"1VA4;1XB120000;1DH0;1PR1\n")
    rig.run(400_000)
    rig.port.edges.clear()
    rig.ask(b"1XU-5000\n")
    rig.run(500_000)
    assert [(t + 500) // 1000 for t in rig.on_times(2)] == [120, 5]
    assert rig.axis1.position.millisteps == 975
    rig.port.edges.clear()
    rig.ask(b"1XU-5000\n")
    rig.run(500_000)
    assert [(t + 500) // 1000 for t in rig.on_times(2)] == [5]


def test_it_rests_as_long_as_after_a_step():
    rig = ready()  # 4 steps a second of 200 ms: 50 ms of rest
    for line in (b"1XU10000\n", b"1PR1\n", b"1XU-10000\n", b"1XU400000\n", b"1PR2\n"):
        rig.send(line)
        rig.ask(b"")
        while rig.axis1.moving():
            rig.run(1_000)
    edges = [(us, duty > 0) for us, pin, duty in rig.port.edges if pin == 2]
    rests = [after[0] - before[0] for before, after in zip(edges[1::2], edges[2::2])]
    assert len(rests) == 5 and all(49_900 <= us < 52_000 for us in rests), rests


def test_it_is_refused_as_a_step_is():
    rig = ready()
    for value in (b"0", b"199", b"-199", b"2000001", b"-2000001", b"1000.5", b"+"):
        rig.ask(b"1XU" + value + b"\n")
        assert rig.errors() == [7], value
    rig.ask(b"1XU\n3XU500\nXU500\n1XU?\n")
    assert rig.errors() == [38, 308, 37, 6]
    assert rig.drives() == (0, 0)
    rig.ask(b"1MV+\n")
    rig.ask(b"1XU5000\n")
    assert rig.errors() == [114]
    rig.ask(b"!\n1QM0\n1XU5000\n")
    assert rig.errors() == [108]


def test_it_stays_within_the_soft_limits_to_a_thousandth_of_a_step():
    rig = ready(b"1SR1;1SL-1;1ZH8\n")
    rig.ask(b"1XU200200\n")
    assert rig.errors() == [106]
    rig.ask(b"1XU-200200\n")
    assert rig.errors() == [107]
    assert rig.port.edges == []
    rig.ask(b"1XU199000\n")
    rig.run(400_000)
    assert rig.errors() == []
    rig.ask(b"1XU1000\n")
    assert rig.errors() == []
    rig.run(400_000)
    assert rig.axis1.position.millisteps == 1000
    rig.ask(b"1ZH0;1DH999999;1XU5000\n")
    assert rig.errors() == [101]


def test_a_stop_ends_it_and_what_drove_is_counted():
    for stop, reason in ((b"!", 3), (b"00000000", 2), (b"AB\n", 3)):
        rig = ready()
        rig.send(b"1XU1000000\n")
        rig.send(stop, after_us=400_000)
        rig.run(500_000)
        assert rig.drives() == (0, 0)
        on_us = sum(rig.on_times(2))
        assert abs(on_us - 400_000) < 1_000
        assert abs(rig.axis1.position.millisteps - on_us / 200) < 1, stop
        assert rig.axis1.reason == reason
    rig = ready()
    rig.send(b"1XU300000\n")
    rig.send(b"ST\n", after_us=100_000)  # a pulse that is nearly over is finished
    rig.run(500_000)
    assert rig.axis1.position.millisteps == 1500


def test_an_end_stop_ends_it():
    rig = ready(b"1XL3\n")
    rig.port.switches = {10: 0, 11: 0}
    rig.send(b"1XU500000\n")
    rig.run(200_000)
    rig.port.switches[10] = 1
    rig.run(50_000)
    assert rig.drives() == (0, 0)
    assert rig.errors() == [104]


def test_it_allocates_nothing():
    rig = ready()
    rig.port.locked = True
    rig.send(b"1XU3000;2XU-70000\n")
    rig.run(700_000)
    rig.port.locked = False
    assert (rig.axis1.position.millisteps, rig.axis2.position.millisteps) == (15, -350)
