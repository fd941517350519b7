"""`mirrormount repl` on a virtual board of the MicroPython VM, with a terminal of its own."""

import contextlib
import os
import select
import subprocess
from pathlib import Path

import pytest
from served import PATIENCE_S, SCRIPT, run_cli, set_traps, wait_for

from mirrormount.device.mount import Mount
from mirrormount.errors import EmulatorMissing
from mirrormount.transport.link import Link
from mirrormount.transport.ports import SerialPort
from mirrormount_sim import machines
from mirrormount_sim.machines import new_files

STEP_US = 200_000


class Terminal:
    """`mirrormount repl` with a pseudo-terminal of its own."""

    def __init__(self, *arguments: str, folder: Path | None = None) -> None:
        import pty

        self._master, slave = pty.openpty()
        self.said = b""
        ends = {"stdin": slave, "stdout": slave, "stderr": slave}
        self.process = subprocess.Popen([SCRIPT, "repl", *arguments], **ends, start_new_session=True, cwd=folder)
        os.close(slave)

    def until(self, text: bytes) -> bytes:
        """Wait until text was said; returns all since the last time."""

        def there() -> bool:
            if select.select([self._master], [], [], 0)[0]:
                with contextlib.suppress(OSError):  # the program has ended
                    self.said += os.read(self._master, 4096)
            return text in self.said

        wait_for(there, f"{text!r}, not {self.said!r}")
        end = self.said.index(text) + len(text)
        before, self.said = self.said[:end], self.said[end:]
        return before

    def type(self, data: bytes) -> None:
        os.write(self._master, data)

    def end(self) -> int:
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            os.close(self._master)


@pytest.fixture
def serve_vm(serve):
    try:
        machines.micropython(Path())
    except EmulatorMissing as e:
        pytest.skip(str(e))
    return lambda *options: serve("--machine", "micropython", *options)


def test_mirrormount_repl_opens_the_prompt_with_m_and_starts_the_firmware_again(serve_vm):
    served = serve_vm()
    port = SerialPort(str(served.link))
    port.write(b"2MV+\n")  # somebody left a motor running
    wait_for(served.driving, "a motor that runs")
    port.close()
    terminal = Terminal(str(served.link))
    said = terminal.until(b"to exit this shell")
    assert b"m.x.step(5)" in said and b"leaves" in said and b"Traceback" not in said
    terminal.until(b">>> ")
    assert not served.driving()

    terminal.type(b"m.x.step(1)\r")
    terminal.until(b"m.x.step(1)\r\n>>> ")
    assert served.off_after_us("m2_en") == pytest.approx(STEP_US, abs=20)
    terminal.type(b"m.y.jog(1, ms=9000)\r")
    wait_for(served.driving, "a jog")
    terminal.type(b"\x03")
    terminal.until(b"KeyboardInterrupt")
    assert not served.driving()
    terminal.until(b">>> ")

    terminal.type(b"m.y.jog(1, ms=9000)\r")
    wait_for(served.driving, "a jog")
    terminal.type(b"\x1d")  # Ctrl-] in mid-move
    assert b"mirrormount,Raspberry Pi Pico," in terminal.until(b"started again")
    assert terminal.end() == 0
    assert not served.driving()
    with Mount.open(str(served.link)) as mount:
        mount.x.step(1)


def test_a_stop_ends_a_move_at_the_prompt_while_repl_has_the_port(serve_vm):
    served = serve_vm()
    terminal = Terminal(str(served.link))
    terminal.until(b"to exit this shell")
    terminal.until(b">>> ")
    terminal.type(b"m.y.jog(1, ms=9000)\r")
    wait_for(served.driving, "a jog")
    run = run_cli("stop", "--port", str(served.link))
    assert run.returncode == 0 and run.stdout.startswith("stop sent"), run.stderr
    terminal.until(b"KeyboardInterrupt")
    assert not served.driving()
    terminal.until(b">>> ")
    terminal.type(b"\x1d")
    terminal.until(b"started again")
    assert terminal.end() == 0


def test_a_stop_ends_a_move_at_the_prompt_that_nobody_has_open_any_more(serve_vm):
    served = serve_vm()
    port = SerialPort(str(served.link))
    port.write(b"\x03")
    said = bytearray()
    wait_for(lambda: said.extend(port.read(0.1)) or b">>> " in said, "the prompt")
    port.write(b"from mountfw.repl import m\rwhile 1: m.y.jog(1, ms=9000)\r\r")
    wait_for(served.driving, "a jog")
    port.close()
    run = run_cli("stop", "--port", str(served.link))
    assert not served.driving()
    assert run.returncode == 0 and run.stdout.startswith("stopped: the program at"), run.stderr


@pytest.mark.full
def test_no_python_of_the_current_folder_is_run_by_repl(serve_vm, tmp_path):
    folder = set_traps(tmp_path / "traps")
    terminal = Terminal(str(serve_vm().link), folder=folder)
    terminal.until(b"to exit this shell")
    terminal.until(b">>> ")
    terminal.type(b"\x1d")
    terminal.until(b"started again")
    assert terminal.end() == 0
    assert not (folder / "sprung").exists()


def test_a_board_without_the_firmware_is_named_as_such_and_left_at_its_prompt(serve_vm, tmp_path):
    (tmp_path / "empty").mkdir()
    board = serve_vm("--files", str(tmp_path / "empty"))
    terminal = Terminal(str(board.link))
    terminal.until(b"deploy it")
    assert terminal.end() == 1
    port = SerialPort(str(board.link))
    port.write(b"1+1\r")
    assert b"2" in Link(port).drain(1.0)
    port.close()


@pytest.mark.full
def test_a_firmware_without_prompt_control_is_started_again(serve_vm, tmp_path):
    (new_files(tmp_path / "files") / "mountfw" / "repl.py").unlink()
    board = serve_vm("--files", str(tmp_path / "files"))
    terminal = Terminal(str(board.link))
    terminal.until(b"started again")
    terminal.until(b"no module named 'mountfw.repl'): deploy it")
    assert terminal.end() == 1


def test_what_cannot_have_a_prompt_is_one_line(tmp_path):
    for port in ("virtual://", str(tmp_path / "none")):
        terminal = Terminal(port)
        terminal.until(b"mirrormount: " + port.encode())
        assert terminal.end() == 1
    assert run_cli("repl", str(tmp_path / "none")).stderr == "mirrormount: repl needs a terminal to type in\n"
