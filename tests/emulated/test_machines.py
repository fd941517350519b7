"""One test, three machines: the same firmware does the same to the same pins."""

import pytest


def sequence(edges) -> list[tuple[str, int]]:
    """Pins and levels in their order. A PWM is its first edge up and its last edge down."""
    seen: list[tuple[str, int]] = []
    for i, (_, pin, duty) in enumerate(edges):
        level = 1 if duty else 0
        again = [p for p, _ in seen].count(pin)
        is_pwm = 0 < duty < 65535 or (any(p == pin for _, p, _ in edges[i + 1 : i + 3]) and again > 2)
        if not is_pwm or (pin, level) not in seen:
            seen.append((pin, level))
    return seen


def test_it_says_who_it_is(board):
    assert board.ask(b"*IDN?\n") == b"mirrormount,Raspberry Pi Pico,e6616408432f5a21,0.3.0\r\n"


def test_a_pulse_drives_its_leg_then_its_enable_and_lets_go_in_the_other_order(board):
    start = board.simulation.us
    board.send(b"1PR1;2PR-1\n")
    board.run(400_000)
    edges = board.edges_after(start)
    for motor, leg in (("m1", "pos"), ("m2", "neg")):
        mine = [(pin, duty) for _, pin, duty in edges if pin.startswith(motor)]
        assert mine == [
            (f"{motor}_{leg}", 65535),
            (f"{motor}_en", 65535),
            (f"{motor}_en", 0),
            (f"{motor}_{leg}", 0),
        ]
        (on,) = (us for us, pin, duty in edges if pin == f"{motor}_en" and duty)
        (off,) = (us for us, pin, duty in edges if pin == f"{motor}_en" and not duty)
        assert abs(off - on - 200_000) < 10_000


def test_a_frame_and_a_stop_give_the_same_sequence(board):
    start = board.simulation.us
    board.send(b"0255-255")
    board.run(30_000)
    board.send(b"!")
    board.run(30_000)
    assert [(pin, duty) for _, pin, duty in board.edges_after(start)] == [
        ("m1_pos", 65535),
        ("m1_en", 65535),
        ("m2_neg", 65535),
        ("m2_en", 65535),
        ("m1_en", 0),
        ("m2_en", 0),
        ("m1_pos", 0),
        ("m2_neg", 0),
    ]


@pytest.mark.full
@pytest.mark.parametrize("duty", [64, 200])
def test_a_duty_shows_on_the_enable_as_that_share_of_the_time(board, duty):
    board.send(b"%04d0000" % duty)
    board.run(20_000)
    start = board.simulation.us
    before = board.drives()["m1_en"]
    board.run(50_000)
    end = board.simulation.us
    on, since, level = 0.0, start, before
    for us, pin, value in board.edges_after(start):
        if pin == "m1_en":
            on += (us - since) * level
            since, level = us, value / 65535
    on += (end - since) * level
    assert on / (end - start) == pytest.approx(duty / 255, abs=0.02)


def pulses_ms(edges, pin: str) -> list[int]:
    rises = [us for us, name, duty in edges if name == pin and duty]
    falls = [us for us, name, duty in edges if name == pin and not duty]
    return [round((off - on) / 1000) for on, off in zip(rises, falls, strict=True)]


def restart(board) -> None:
    """To the prompt, and from there into the firmware again."""
    board.send(b"\x03")
    board.until(b">>> ")
    board.send(b"\x04")
    board.until(b"soft reboot")
    board.simulation.lit = False
    board.boot()


@pytest.mark.full
def test_the_backlash_is_taken_up_before_the_first_step_back(board):
    board.send(b"1XP20000;1XB30000;1VA20;1PR2\n")
    board.run(200_000)
    start = board.simulation.us
    board.send(b"1PR-1\n")
    board.run(200_000)
    assert pulses_ms(board.edges_after(start), "m1_en") == [30, 20]
    assert board.ask(b"1TP?\n") == b"1\r\n"


def test_saved_settings_and_a_rested_position_are_there_after_a_restart(board):
    board.send(b"1XP20000;SM\n")
    board.run(500_000)
    board.send(b"1DH0;1PR3\n")
    board.run(12_500_000)
    restart(board)
    assert board.ask(b"1XP?;1TP?;TE?\n", 3_000_000) == b"20000; 3; 0\r\n"
    assert board.ask(b"XS?\n").split(b"|")[1].endswith(b",1")  # certainty: counted


@pytest.mark.full
def test_a_host_that_collects_nothing_does_not_keep_a_stop_from_being_obeyed(board):
    board.simulation.collects(False)
    for _ in range(60):
        board.send(b"02550255*IDN?\n")
    assert board.run(2_000_000, lambda: not board.off())
    board.send(b"!")
    assert board.run(1_000_000, board.off)  # how fast is measured elsewhere; the paper's sketch never does
    board.run(200_000)
    assert board.off()


def test_ctrl_c_turns_the_motors_off_and_gives_the_prompt(board):
    board.send(b"02550255")
    board.run(30_000)
    assert not board.off()
    board.received.clear()
    board.send(b"\x03")
    board.until(b">>> ")
    assert board.off()


@pytest.mark.full
def test_ctrl_d_at_the_prompt_starts_the_firmware_again(board):
    restart(board)
    assert board.ask(b"*IDN?\n", 3_000_000).startswith(b"mirrormount,")
