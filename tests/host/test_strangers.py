"""What else may answer at a port: a prompt, a board without firmware, the paper's sketch, an instrument."""

import contextlib
import math
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from served import PATIENCE_S

from mirrormount.common import errors
from mirrormount.device import arduino_sketch
from mirrormount.device.arduino_sketch import SketchMount
from mirrormount.device.handshake import identify
from mirrormount.device.mount import Mount
from mirrormount.transport.lines import Link
from mirrormount.transport.telnet import GREETING
from mirrormount.virtual import machines
from mirrormount.virtual.clocks import Lockstep
from mirrormount.virtual.simulation import Simulation


@contextmanager
def answering(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    """A TCP server that answers each thing it hears; yields its address."""
    server = socket.create_server(("127.0.0.1", 0))

    def run() -> None:
        client, _ = server.accept()
        with client, contextlib.suppress(ConnectionError):  # the client may go with an answer unread
            while data := client.recv(4096):
                client.sendall(answer(data))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield f"socket://127.0.0.1:{server.getsockname()[1]}"
    finally:
        thread.join(PATIENCE_S)
        server.close()


def test_silence_is_not_a_mount():
    with answering(lambda data: b"") as address, pytest.raises(errors.NotAMount, match="nothing answers"):
        Mount.open(address)


IDENTIFIES = {b"*IDN?\n": b"mirrormount,a board,1234,0.0.0\r\n"}


class LatePort:
    """What a board on a busy computer is like, with a clock of its own: a greeting at once, answers later."""

    lockstep = True

    def __init__(self, greeting: bytes, late_s: float, answers: dict[bytes, bytes] = IDENTIFIES) -> None:
        self._now_s, self._late_s, self._answers = 0.0, late_s, answers
        self._coming = [(0.0, greeting)]  # when, and what

    def monotonic(self) -> float:
        return self._now_s

    def read(self, timeout_s: float) -> bytes:
        at_s, data = self._coming[0] if self._coming else (math.inf, b"")
        if at_s > self._now_s + timeout_s:
            self._now_s += timeout_s
            return b""
        self._now_s = max(self._now_s, at_s)
        del self._coming[0]
        return data

    def write(self, data: bytes) -> None:
        if data in self._answers:
            self._coming.append((self._now_s + self._late_s, self._answers[data]))

    def close(self) -> None:
        pass


def test_a_served_board_that_is_still_brought_to_rest_is_waited_for():
    assert identify(Link(LatePort(GREETING, late_s=4.0))) == "mirrormount,a board,1234,0.0.0"


def test_the_rest_of_an_answer_to_a_client_that_was_killed_is_not_taken_for_the_boards_name():
    late = {b"*IDN?\n": b",1,0,0,0\r\n" + IDENTIFIES[b"*IDN?\n"]}
    assert identify(Link(LatePort(b"", 0.5, late))) == "mirrormount,a board,1234,0.0.0"


def test_a_port_that_does_not_greet_is_given_up_sooner():
    with pytest.raises(errors.NotAMount, match="nothing answers"):
        identify(Link(LatePort(b"", late_s=4.0)))


def test_a_prompt_that_takes_its_time_to_say_that_the_firmware_is_missing_is_waited_for():
    says = b"import mountfw\r\nTraceback (most recent call last):\r\n"
    says += b"  File \"<stdin>\", line 1, in <module>\r\nImportError: no module named 'mountfw'\r\n>>> "
    prompt = {b"*IDN?\n": b"*IDN?\r\n... \r\n>>> ", b"import mountfw\r": says}
    with pytest.raises(errors.FirmwareMissing, match="deploy"):
        identify(Link(LatePort(b"", 1.0, prompt)))


def test_another_instrument_is_not_a_mount():
    with answering(lambda data: b"KEITHLEY 2000\r\n") as address, pytest.raises(errors.NotAMount, match="KEITHLEY"):
        Mount.open(address)


def test_a_flood_that_never_ends_is_not_waited_for():
    with answering(lambda data: b"x" * 100_000) as address, pytest.raises(errors.NotAMount):
        Mount.open(address)


def test_something_that_hangs_up_is_not_a_mount():
    server = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=lambda: server.accept()[0].close(), daemon=True).start()
    with pytest.raises(errors.NotAMount, match="hung up"):
        Mount.open(f"socket://127.0.0.1:{server.getsockname()[1]}")
    server.close()


class Board:
    """A virtual board in lockstep, started by hand, as a port."""

    lockstep = True

    def __init__(self, **options) -> None:
        scratch = TemporaryDirectory()
        self.simulation = Simulation(machines.cpython(Path(scratch.name), **options), scratch=[scratch])
        self.lockstep = Lockstep(self.simulation)

    def monotonic(self) -> float:
        return self.simulation.now_us * 1e-6

    def sleep(self, seconds: float) -> None:
        self.lockstep.run(round(seconds * 1e6))

    def read(self, timeout_s: float) -> bytes:
        self.lockstep.run(round(timeout_s * 1e6), lambda: bool(self.lockstep.received))
        data = bytes(self.lockstep.received)
        self.lockstep.received.clear()
        return data

    def write(self, data: bytes) -> None:
        self.lockstep.send(data)

    def close(self) -> None:
        self.simulation.close()


def test_a_python_without_the_firmware_says_so(tmp_path: Path):
    link = Link(Board(firmware=tmp_path))
    with pytest.raises(errors.FirmwareMissing, match=r"^Python answers.*deploy"):  # which Python is not known
        Mount(link)
    link.close()


def test_a_board_at_its_prompt_says_so():
    board = Board()
    board.write(b"\x03")
    with pytest.raises(errors.AtPrompt, match="Ctrl-D"):
        Mount(Link(board))
    board.close()


def test_a_board_without_a_board_file_names_the_file_to_write():
    board = Board(name="Weact F411 with STM32F411CE")
    said = board.read(2.0)
    while b">>> " not in said:
        said += board.read(2.0)
    assert b"no board file for 'Weact F411': write mountfw/boards/weact_f411.py" in said
    board.close()


@pytest.mark.parametrize("at_us", [1, 777, 100_000, 199_990])
def test_ctrl_c_twice_in_a_pulse_leaves_the_motors_off(at_us):
    board = Board()
    board.write(b"1PR5;2MV-\n")
    board.lockstep.run(50_000 + at_us)
    assert board.simulation.bench.drive("m2") == -1
    board.write(b"\x03\x03")
    board.lockstep.run(5_000)
    assert board.simulation.bench.drive("m1") is None
    assert board.simulation.bench.drive("m2") is None
    board.close()


class Sketch:
    """The paper's sketch as measured (docs/protocol.md): deaf for 143 ms after a frame, and to what
    arrives within 32 ms of another only as one string, of which it obeys the first 8 characters."""

    lockstep = True

    def __init__(self) -> None:
        self.us = 0
        self.heard: list[tuple[int, bytes]] = []
        self.obeyed: list[tuple[int, bytes]] = []  # (us, frame)
        self.out: list[tuple[int, bytes]] = []

    def monotonic(self) -> float:
        return self.us * 1e-6

    def sleep(self, seconds: float) -> None:
        self.us += round(seconds * 1e6)
        while self.heard and self.us - self.heard[0][0] >= 34_600:
            start = self.heard[0][0]
            text = b"".join(data for at, data in self.heard if at - start <= 32_000)
            self.heard = [(max(at, start + 143_000), data) for at, data in self.heard if at - start > 32_000]
            n1, n2 = (int(field) if field.lstrip(b"+-").isdigit() else 0 for field in (text[:4], text[4:8]))
            self.obeyed.append((start + 34_600, text[:8]))
            echo = b"".join(b"%s\r\n" % x for x in (text, b"%d" % n1, b"%d" % n2, b"%d" % abs(n1), b"%d" % abs(n2)))
            self.out.append((start + 90_000, echo))

    def read(self, timeout_s: float) -> bytes:
        end = self.us + round(timeout_s * 1e6)
        while self.us < end:
            self.sleep(0.001)
            if self.out and self.out[0][0] <= self.us:
                return self.out.pop(0)[1]
        return b""

    def write(self, data: bytes) -> None:
        self.heard.append((self.us, data))

    def close(self) -> None:
        pass


def test_the_papers_sketch_loses_nothing_that_is_sent_to_it():
    sketch = Sketch()
    mount = SketchMount(Link(sketch))
    assert sketch.us >= 2_000_000  # it waited for the Arduino's reset
    mount.x.step(3)
    mount.y.step(-1)
    frames = [frame for _, frame in sketch.obeyed]
    start = frames.index(b"00000255")
    assert frames[start:] == [b"00000255", b"00000000"] * 3 + [b"-2550000", b"00000000"]


def test_a_board_with_mountfw_is_not_driven_as_a_sketch(board):
    with pytest.raises(errors.NotAMount, match="leave --sketch out"):
        SketchMount.open(board.tcp)


def test_steps_on_the_sketch_last_about_as_long_as_the_papers():
    sketch = Sketch()
    SketchMount(Link(sketch)).x.step(5)
    lengths = [off - on for (on, frame), (off, _) in pairwise(sketch.obeyed) if frame == b"00000255"]
    assert all(abs(us - 200_000) < 5_000 for us in lengths), lengths


@pytest.mark.parametrize("speed", [1.001, -1.001, 0, 0.001, float("nan"), "1"])
def test_a_jog_speed_that_is_none_is_refused_and_not_sent_to_the_sketch(speed):
    sketch = Sketch()
    mount = SketchMount(Link(sketch))
    before = list(sketch.obeyed)
    with pytest.raises(errors.BadValue, match="a jog's speed"):
        mount.x.jog(speed)
    sketch.sleep(1)
    assert sketch.obeyed == before


def test_a_stop_reaches_the_sketch_even_right_after_another_frame():
    sketch = Sketch()
    mount = SketchMount(Link(sketch))
    mount.link.write(b"02550000")  # another client's frame, unconfirmed
    mount.stop()
    assert sketch.obeyed[-1][1] == b"00000000"


class StoppedSketch(Sketch):
    """Calls `stop` at a time, or as soon as nobody holds the lock: a thread of the stop socket waits for it, too."""

    at_us = 1 << 62

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        if self.us >= self.at_us and not self.lock._is_owned():
            self.at_us = 1 << 62
            self.stop()


@pytest.mark.parametrize(
    "motion",
    [
        lambda mount: mount.x.step(50),
        lambda mount: (mount.x.jog(1), mount.sleep(3600)),
        lambda mount: (mount.drive(255, -255), mount.sleep(3600)),
    ],
    ids=["step", "jog", "drive"],
)
@pytest.mark.parametrize("after_us", [1_000, 40_000, 100_000, 250_000, 300_000, 430_000, 777_000])
def test_a_stop_of_another_program_ends_a_motion_of_the_sketch(monkeypatch, motion, after_us):
    sketch, asked = StoppedSketch(), []
    monkeypatch.setattr(arduino_sketch, "open_port", lambda _address, baud: sketch)
    monkeypatch.setattr(arduino_sketch, "Stoppable", lambda names, stop: asked.append((names, stop)) or None)
    mount = SketchMount.open("/dev/ttyTEST")
    ((names, sketch.stop),) = asked
    sketch.lock = mount.link.lock
    assert names == ["/dev/ttyTEST"]
    sketch.at_us = sketch.us + after_us
    with pytest.raises(errors.MountError, match="another program has stopped"):
        motion(mount)
    sketch.sleep(1)
    stopped = sketch.us - 1_000_000
    assert sketch.obeyed[-1][1] == b"00000000"
    assert [frame for us, frame in sketch.obeyed if us > stopped and frame != b"00000000"] == []
    mount.x.step(1)  # what is asked for after the stop is done


def test_what_the_sketch_cannot_do_is_told_and_not_invented():
    mount = SketchMount(Link(Sketch()))
    for question in (lambda: mount.x.position, lambda: mount.x.move_to(3), mount.status):
        with pytest.raises(errors.NotSupported, match="sketch"):
            question()


def test_leaving_the_block_stops_the_sketch():
    sketch = Sketch()
    with SketchMount(Link(sketch)) as mount:
        mount.drive(255, 0)
    assert sketch.obeyed[-1][1] == b"00000000"


def test_an_arduino_that_does_not_answer_is_not_called_stopped():
    with answering(lambda data: b"") as address, pytest.raises(errors.NotAMount, match="sketch"):
        SketchMount.open(address)


def test_a_file_called_this_goes_before_the_boards_own(tmp_path: Path):
    import mountfw

    shutil.copytree(Path(mountfw.__file__).parent, tmp_path / "mountfw", ignore=shutil.ignore_patterns("__pycache__"))
    boards = tmp_path / "mountfw" / "boards"
    shutil.copy(boards / "pico_drv8833.py", boards / "this.py")
    board = Board(firmware=tmp_path)
    board.write(b"0100-255")
    board.sleep(0.1)
    assert {(pin, duty) for _, pin, duty in board.simulation.edges} == {("m1_pos", 100 * 257), ("m2_neg", 65535)}
    board.close()
