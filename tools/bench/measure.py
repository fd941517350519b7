"""What is measured: one function for each kind of measurement.

Each function makes its own board and returns a list of numbers, in the unit of its row (rows.py), LOST where nothing
happened. Everything is read off pin edges, but for the answer after a reset.
"""

from lab import ENABLES, LOST, Board, Edge, Lab, first_low_us, last_fall_us, on_times_us, start_hanging

from mirrormount.device.mount import encode_frame

IDLE_US = 512_000  # the longest sleep of an idle loop: moments are chosen from as long a stretch
STREAM_US = 1_000  # a frame each millisecond
EXECUTED_US = 64_000  # thirty lines `XS?` take three times as long
RECORDED_US = 10_800_000  # the position is recorded after 10 s of rest
LATE_US = 10_000  # a frame that shows later than this did not keep up
FRAMES = 500
QUIET_US = 700_000  # after an answer; by then the board knows that the port does not echo
KEEP_ALIVE_US = 500_000
WATCHDOG_US = 1_000_000
DRIVE_US = 200_000  # of a run whose end comes while the loop hangs
REST_OVER_US = 510_000  # the period of VA's default, and the next pulse starts at once

# us of a pulse, and how many of 200 pulses are that long
PULSES = {1_000: 40, 2_000: 40, 5_000: 40, 10_000: 30, 50_000: 25, 200_000: 15, 1_000_000: 6, 2_000_000: 4}
SHORTEST_US = 200


# ---- frames


def frame_to_level(lab: Lab, *, together: bool, full: bool) -> list[float]:
    """ms from the last byte of a frame to both enables high, by turns from rest and reversing.

    together: the frame comes in one burst; else its 8th byte comes alone and later. At partial duty "high" is the
    first rise of the PWM in the new direction.
    """
    board, random = lab.board(), lab.random
    times = []
    for trial in lab.trials():
        speeds = [random.choice((-1, 1)) * (255 if full else random.randrange(26, 230)) for _ in ENABLES]
        board.clear()
        if trial % 2:
            board.do(encode_frame(-speeds[0], -speeds[1]))
        board.run(random.randrange(IDLE_US))
        frame = encode_frame(*speeds)
        if not together:
            board.give(frame[:7])
            board.run(random.randrange(1_000, 40_000))
            frame = frame[7:]
        landed_us = board.give(frame)
        board.run(20_000)
        rises = [
            _level_us(board.edges, landed_us, motor, speed > 0) for motor, speed in zip((1, 2), speeds, strict=True)
        ]
        times.append((max(rises) - landed_us) / 1000)
    return times


def first_after_record(lab: Lab) -> list[float]:
    """ms from the last byte of a run to the first enable high, where the position is recorded on the flash."""
    board = lab.board()
    times = []
    for _ in lab.trials():
        board.do(b"1MV+\n")
        board.clear()
        board.run(RECORDED_US + lab.random.randrange(IDLE_US))
        landed_us = board.give(b"1MV+\n")
        board.run(400_000)
        rises = [us for us, pin, duty in board.edges if us >= landed_us and pin in ENABLES and duty]
        times.append((min(rises, default=LOST) - landed_us) / 1000)
    return times


def _level_us(edges: list[Edge], since_us: int, motor: int, forward: bool) -> float:
    """When a motor's enable first rises after its leg for that direction did; LOST if it does not."""
    leg = f"m{motor}_pos" if forward else f"m{motor}_neg"
    turned_us = next((us for us, pin, duty in edges if us >= since_us and pin == leg and duty), LOST)
    return next((us for us, pin, duty in edges if us >= turned_us and pin == f"m{motor}_en" and duty), LOST)


def frame_rate(lab: Lab) -> list[float]:
    """The highest rate, to 2 %, at which FRAMES paced frames all show on the pins in order, none LATE_US late."""
    board = lab.board()
    low, high = 10.0, 4000.0
    for _ in lab.trials(9):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if _keeps_up(board, lab, middle) else (low, middle)
    return [low]


def _keeps_up(board: Board, lab: Lab, rate: float) -> bool:
    """Motor 1 reverses with each frame, motor 2 does one of three things: on its enables, was every frame there?"""
    speeds = [(255 if i % 2 else -255, lab.random.choice((-255, 0, 255))) for i in range(FRAMES)]
    board.fresh()
    board.give(b"XS?\n")
    board.run(QUIET_US)
    start_us, landed = board.us + 1_000, []
    for i, (m1, m2) in enumerate(speeds):
        board.until_us(start_us + round(i * 1e6 / rate))
        landed.append(board.give(encode_frame(m1, m2)))
        if i % 25 == 24 and len(shown(board.edges, 1)) < i - LATE_US * 1e-6 * rate - 2:
            return False  # it has fallen behind already
    board.run(LATE_US + 5_000)
    first, second = shown(board.edges, 1), shown(board.edges, 2)
    wanted = [
        m2 for before, (_, m2) in zip([0, *(m2 for _, m2 in speeds)], speeds, strict=False) if m2 not in (0, before)
    ]
    return (
        [255 if forward else -255 for _, forward in first] == [m1 for m1, _ in speeds]
        and [255 if forward else -255 for _, forward in second] == wanted
        and all(us - came <= LATE_US for (us, _), came in zip(first, landed, strict=True))
    )


def shown(edges: list[Edge], motor: int) -> list[tuple[int, bool]]:
    """Each time the enable of a motor rises: when, and whether forward."""
    rises, forward = [], True
    for us, pin, duty in edges:
        if duty and pin in (f"m{motor}_pos", f"m{motor}_neg"):
            forward = pin.endswith("pos")
        elif duty and pin == f"m{motor}_en":
            rises.append((us, forward))
    return rises


# ---- stops: from `!` to both enables low


def stop_in_a_run(lab: Lab, *, reading: bool = True) -> list[float]:
    """ms; runs and frames by turns, the loop otherwise idle. Not reading: with replies that nobody takes."""
    board, random = lab.board(), lab.random
    if not reading:
        board.hear(False)
        for _ in range(60):
            board.do(b"*IDN?\n")
    times = []
    for trial in lab.trials():
        board.do(b"1MV+;2MV-\n" if trial % 2 else b"0255-255")
        board.run(random.randrange(IDLE_US))
        times.append(board.stopped_after_us(board.give(b"!")) / 1000)
        board.forget()
    return times


def stop_in_a_pulse(lab: Lab) -> list[float]:
    """ms; both axes pulse. By turns at any moment, and about the end of axis 1's pulse, when the loop spins.

    In the closed loop a step ends at its counts, whenever that is, so the stop comes at any moment of it.
    """
    board, random = lab.board(), lab.random
    board.do(b"2XP200000;2VA4.9\n")
    times = []
    for trial in lab.trials():
        pulse_us = random.choice((5_000, 20_000, 100_000))
        if not lab.closed:
            board.do(b"1XP%d\n" % pulse_us)
        board.give(b"1PR1;2PR-1\n")
        board.run(1_000_000, lambda: all(board.simulation.bench.duties()[pin] for pin in ENABLES))
        began_us = min(us for us, pin, duty in board.edges if pin in ENABLES and duty)
        any_moment = lab.closed or trial % 2
        after_us = random.randrange(190_000) if any_moment else pulse_us + random.randrange(-400, 400)
        board.until_us(began_us + after_us)
        times.append(board.stopped_after_us(board.give(b"!")) / 1000)
        board.run(REST_OVER_US)
        board.forget()
    return times


def stop_in_a_stream(lab: Lab, *, zeros: bool) -> list[float]:
    """ms, from the stop's landing: a packet that comes soon after another waits in the host before that.

    A frame comes each millisecond, a tenth of a second of them before the stop, and on after it.
    `!` comes at any moment, half of the time inside a frame; eight zeros between two frames.
    """
    board, random, frame = lab.board(), lab.random, encode_frame(255, 255)
    times = []
    for _ in lab.trials():
        board.fresh()
        board.do(frame)
        start_us = board.us + random.randrange(IDLE_US)
        stop_at = random.randrange(60, 100)
        cut = 0 if zeros else random.choice((0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7))
        rest, landed_us = b"", 0
        for i in range(stop_at + 20):
            board.until_us(start_us + i * STREAM_US)
            if i == stop_at:
                board.give(frame[:cut] or frame)
                board.until_us(start_us + i * STREAM_US + random.randrange(STREAM_US - 50))
                landed_us = board.land(b"00000000" if zeros else b"!")
                rest = frame[cut:] if cut else b""
            else:
                board.give(rest + frame)
                rest = b""
        board.run(2_000_000, lambda us=landed_us: first_low_us(board.edges, us) < LOST)
        times.append((first_low_us(board.edges, landed_us) - landed_us) / 1000)
    return times


def stop_behind(lab: Lab, *, size: int) -> list[float]:
    """us for each byte of a burst that the stop is the end of; frames, long lines and newlines by turns."""
    board, random = lab.board(), lab.random
    contents = (encode_frame(255, 255) + b"\n", b"1XP?;" * 24 + b"2XP?\n", b"\n")
    times = []
    for trial in lab.trials():
        content = contents[trial % len(contents)]
        board.fresh()
        board.do(encode_frame(255, 255))
        board.run(random.randrange(IDLE_US))
        landed_us = board.give((content * size)[:size] + b"!")
        board.run(3_000_000, board.off)
        board.run(30_000)  # and it stays so
        times.append((last_fall_us(board.edges, landed_us) - landed_us) / size if board.off() else LOST)
    return times


def stop_in_queries(lab: Lab) -> list[float]:
    """ms; both axes run, and the loop executes thirty lines `XS?` when `!` comes.

    The lines are received by then: how long a stop waits for bytes before it is what stop_behind() measures.
    """
    board, random = lab.board(), lab.random
    times = []
    for _ in lab.trials():
        board.do(b"1MV+;2MV-\n")
        board.give(b"XS?\n" * 30)
        board.run(EXECUTED_US, lambda: b"\n" in board.received)  # the first is answered
        board.run(random.randrange(EXECUTED_US))
        times.append(board.stopped_after_us(board.give(b"!")) / 1000)
        board.forget()
    return times


# ---- a loop that hangs: nothing but interrupts and the watchdog are there then


def stop_in_hang(lab: Lab) -> list[float]:
    """ms from `!` to both enables low, where the loop has hung since the drive began: runs and frames by turns."""
    board, random = lab.board(), lab.random
    times = []
    for trial in lab.trials():
        _hang(board, b"1MV+;2MV-\n" if trial % 2 else b"0255-255")
        board.run(random.randrange(IDLE_US))
        landed_us = board.give(b"!")
        times.append(_off_after_us(board, landed_us) / 1000)
        _recover(board)
    return times


def end_in_hang(lab: Lab) -> list[float]:
    """ms from the limit of a run, DRIVE_US, to its enable low; the loop has hung meanwhile."""
    board = lab.board()
    times = []
    for _ in lab.trials():
        began_us = _hang(board, b"1XM%d\n1MV+\n" % (DRIVE_US // 1000))
        times.append((_off_after_us(board, began_us) - DRIVE_US) / 1000)
        _recover(board)
    return times


def _hang(board: Board, start: bytes) -> int:
    """Start a drive in which the loop hangs. Returns when the last enable rose."""
    start_hanging(board)
    board.forget()
    board.give(start)
    board.run(1_000_000, lambda: not board.off())
    board.run(20_000)
    return max(us for us, pin, duty in board.edges if pin in ENABLES and duty)


def _off_after_us(board: Board, since_us: int) -> float:
    board.run(2 * WATCHDOG_US, board.off)
    return last_fall_us(board.edges, since_us) - since_us if board.off() else LOST


def _recover(board: Board) -> None:
    """Wait for the watchdog's reset and for the start after it."""
    board.run(2 * WATCHDOG_US, lambda: not board.simulation.usb)
    board.simulation.lit = False
    board.boot()
    board.clear()


# ---- pulses


def pulse_error(lab: Lab, *, axes: tuple[int, ...], lengths: dict[int, int]) -> list[float]:
    """us that an enable was high, less what was asked for. lengths: us to how many of so many pulses."""
    board, random = lab.board(), lab.random
    order = [us for us, times in lengths.items() for _ in range(times)]
    random.shuffle(order)
    errors = []
    for trial in lab.trials():
        us = order[trial % len(order)]
        velocity = 100_000_000 // (us + 1_000)
        board.do(b";".join(b"%dXP%d;%dVA%d.%02d" % (a, us, a, *divmod(velocity, 100)) for a in axes) + b"\n")
        board.run(random.randrange(IDLE_US))
        board.give(b";".join(b"%dPR%d" % (axis, (1, -1)[trial % 2]) for axis in axes) + b"\n")
        board.run(us + 60_000)
        for axis in axes:
            times = on_times_us(board.edges, f"m{axis}_en")
            errors.append(times[0] - us if len(times) == 1 else LOST)
    return errors


# ---- what ends a move from outside


def end_stop(lab: Lab) -> list[float]:
    """ms from the edge of the switch ahead to the enable low in a run, with both switches of both axes fitted."""
    board, random = lab.board(switches=True), lab.random
    board.do(b"1XL3;2XL3\n")
    times = []
    for trial in lab.trials():
        axis, forward = 1 + trial % 2, bool(trial & 2)
        way = "+" if forward else "-"
        board.give(f"{axis}MV{way}\n".encode())
        board.run(1_000_000, lambda: not board.off())
        board.run(random.randrange(1_000, 40_000))
        edge_us = board.us
        board.simulation.bench.broken.add(f"m{axis}_sw_{'pos' if forward else 'neg'}")
        board.run(20_000)
        off_us = last_fall_us(board.edges, edge_us, (f"m{axis}_en",)) if board.off() else LOST
        times.append((off_us - edge_us) / 1000)
        board.simulation.bench.broken.clear()
        board.clear()
    return times


def keep_alive(lab: Lab) -> list[float]:
    """ms from the last byte to both enables low, less XK, of runs. By turns the host is cut off, freezes, is killed."""
    board, random = lab.board(), lab.random
    times = []
    for trial in lab.trials():
        board.run(random.randrange(IDLE_US))
        landed_us = board.give(b"XK%d;1MV+;2MV-\n" % (KEEP_ALIVE_US // 1000))
        board.hear(trial % 3 == 2)  # killed: the system goes on reading
        board.simulation.opened(trial % 3 == 1)  # frozen: the port stays open
        board.run(KEEP_ALIVE_US + 100_000)
        off_us = last_fall_us(board.edges, landed_us) if board.off() else LOST
        times.append((off_us - landed_us - KEEP_ALIVE_US) / 1000)
        board.hear(True)
        board.simulation.opened(True)
        board.clear()
    return times


# ---- a start, and memory


def reset_to_answer(lab: Lab) -> list[float]:
    """ms from a pulse of the reset pin to the answer to *IDN?, to 1 ms.

    It is asked as the host does: once USB is up, and again each second.
    """
    board, random = lab.board(), lab.random
    times = []
    for _ in lab.trials():
        board.run(random.randrange(IDLE_US))
        board.forget()
        start_us = board.us
        board.simulation.reset(power=False)
        board.run(2_000)
        board.run(10_000_000, lambda: board.simulation.usb)
        while b"mirrormount," not in board.received and board.us < start_us + 10_000_000:
            board.give(b"\n*IDN?\n")
            board.run(1_000_000, lambda: b"mirrormount," in board.received)
        board.run(20_000, lambda: board.received.endswith(b"\n"))
        times.append((board.us - start_us) / 1000)
        board.run(100_000)
    return times


def free_memory(lab: Lab) -> list[float]:
    """KB that the board tells to be free at rest, once it has moved and answered."""
    board = lab.board()
    board.do(b"1PR1;2PR-1;XS?;TB?\n")
    board.run(1_000_000)
    return [int(board.ask(b"XH?").split(",")[0]) / 1024]
