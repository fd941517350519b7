"""What else may answer at a port: a prompt, a board without firmware, an instrument."""

import contextlib
import math
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from served import PATIENCE_S

from mirrormount import errors
from mirrormount.device.mount import Mount
from mirrormount.device.session import identify
from mirrormount.transport.link import GREETING, Link
from mirrormount_sim import machines
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.simulation import Simulation


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
