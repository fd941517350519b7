"""The analog input that tells a power: `XW?`. Runs under CPython and MicroPython."""

from rig import Board, Rig

POWER = 28


def fitted():
    board = Board()
    board.POWER = POWER
    return Rig(board=board)


def test_the_voltage_is_told_as_the_port_reads_it():
    rig = fitted()
    for value in (0, 1, 32_768, 65_535):
        rig.port.analogs[POWER] = value
        assert rig.ask(b"XW?\n") == b"%d\r\n" % value
    assert rig.errors() == []


def test_a_board_without_the_input_refuses_and_answers():
    rig = Rig()
    assert rig.ask(b"XW?;1TP?\n") == b"ERROR 70; 0\r\n"
    assert rig.errors() == [70]


def test_the_input_cannot_be_set():
    rig = fitted()
    rig.send(b"XW5\n")
    rig.settle()
    assert rig.errors() == [6]


def test_reading_it_allocates_nothing():
    rig = fitted()
    rig.port.analogs[POWER] = 65_535
    rig.port.locked = True
    for _ in range(20):
        rig.send(b"XW?;XW?;XW?\n")
        rig.settle()
    assert rig.port.sent


def test_a_stop_behind_many_readings_is_as_quick_as_behind_one_query():
    late = []
    for line in (b"1TP?", b"XW?;" * 8):
        rig = fitted()
        rig.send(b"1MV+\n")
        rig.run(50_000)
        assert rig.drives() != (0, 0)
        begin = rig.port.us
        rig.send(line + b"\n!")
        while rig.drives() != (0, 0):
            rig.step()
        late.append(rig.port.us - begin)
    assert late[1] < late[0] + 1_000, late
