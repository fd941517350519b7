"""What ends a deploy or an undeploy under way, a signal, and what does not: `mirrormount stop`, which is answered."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from deployed import Served, contents
from served import run_cli, wait_for

import mountfw
from mirrormount import errors
from mirrormount.deploy import micropython
from mirrormount.deploy.micropython import Mpremote, Survey, deploy, plan, undeploy
from mirrormount.deploy.prompt import Options, StopAnswer
from mirrormount.errors import MountError
from mirrormount.terminal import Progress, Terminated
from mirrormount.transport.link import Link
from mirrormount.transport.stop_socket import SENT, STOPPED


def end_by_signal(board: Served, tmp_path: Path, number: int, command: str, under_way) -> subprocess.CompletedProcess:
    """Run a command, and send it a signal when under_way(lines of stderr so far) is true."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    words = [sys.executable, "-m", "mirrormount", *command.split(), board.port]
    said: list[str] = []
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=os.environ | {"TMPDIR": str(scratch)}) as run:
        assert run.stderr
        reader = threading.Thread(target=lambda: said.extend(run.stderr))
        reader.start()
        wait_for(lambda: under_way(said), f"{command} to be under way")
        run.send_signal(number)
        reader.join()
    assert list(scratch.iterdir()) == []
    return subprocess.CompletedProcess(words, run.returncode, stderr="".join(said))


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_deploy_that_a_signal_ends_leaves_the_firmware_that_ran_and_starts_it(deployed, tmp_path, name):
    before, number = contents(deployed.root), getattr(signal, name)
    ended = end_by_signal(
        deployed, tmp_path, number, "deploy --source", lambda _: list(deployed.root.glob("mountfw.new/*.py"))
    )
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (128 + number, f"mirrormount: ended by {name}")
    assert contents(deployed.root) == before
    assert deployed.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"


@pytest.mark.parametrize("command", ["deploy", "undeploy"])
def test_a_signal_before_anything_was_changed_starts_the_firmware_again(deployed, tmp_path, command):
    before = contents(deployed.root)
    ended = end_by_signal(deployed, tmp_path, signal.SIGTERM, command, len)
    assert ended.returncode == 128 + signal.SIGTERM, ended.stderr
    left = contents(deployed.root)
    assert left.items() <= before.items()  # a late signal may find some files removed
    if left == before:
        assert deployed.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"


class Ending(Progress):
    """A signal comes as the first phase at the prompt begins."""

    def phase(self, text: str) -> None:
        if text != "looking at the board":
            raise Terminated(signal.SIGTERM)


@pytest.mark.parametrize("work", [deploy, undeploy])
def test_a_signal_at_the_begin_of_a_phase_starts_the_firmware_again(deployed, work):
    with pytest.raises(Terminated):
        work(Options(port=deployed.port), Ending())
    assert deployed.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"


class Stopping(Progress):
    """Says stop as each phase begins, but for the first, in which the port is not yet open."""

    def __init__(self, port: str) -> None:
        super().__init__()
        self._port = port
        self.said: dict[str, tuple[int, str]] = {}

    def phase(self, text: str) -> None:
        if text != "looking at the board":
            run = run_cli("stop", "--port", self._port)
            self.said[text.split()[0]] = (run.returncode, run.stdout[:8] + run.stderr)


@pytest.mark.parametrize(
    ("command", "phases"), [(deploy, {"compiling", "uploading", "restarting"}), (undeploy, {"looking"})]
)
def test_a_stop_gets_through_while_the_board_is_worked_on(deployed, command, phases):
    progress = Stopping(deployed.port)
    command(Options(port=deployed.port, source=True), progress)
    assert progress.said == dict.fromkeys(phases, (0, "stopped "))


def does_not_answer(*_) -> None:
    raise errors.DeployError("the firmware on the board does not answer")


def test_a_signal_while_the_old_files_are_put_back_resets_the_board_too(monkeypatch):
    board, resets = Mpremote("/dev/none"), []

    def end(*_):
        raise Terminated(signal.SIGTERM)

    monkeypatch.setattr(board, "put_back", end)
    monkeypatch.setattr(board, "reset", lambda: resets.append(1))
    monkeypatch.setattr(micropython, "come_back", does_not_answer)
    there = Survey()
    with pytest.raises(Terminated):
        micropython.try_it(board, "/dev/none", there, plan({"main.py": b""}, there, lambda _aside: True), Progress())
    assert resets == [1]


class Port:
    """Notes what is written."""

    lockstep = False

    def __init__(self) -> None:
        self.written = b""

    def write(self, data: bytes) -> None:
        self.written += data


def test_before_the_firmware_was_found_at_rest_the_stop_is_written_even_if_the_exchange_hangs():
    answer, port = StopAnswer(), Port()
    link = Link(port)  # pyright: ignore[reportArgumentType]
    answer.asking(link)
    with link.lock:
        assert (answer.stop(), port.written) == (SENT, b"!\n")


def test_at_rest_nothing_is_written_into_the_prompt():
    answer, port = StopAnswer(), Port()
    answer.asking(Link(port))  # pyright: ignore[reportArgumentType]
    answer.found(at_rest=True)
    assert (answer.stop(), port.written) == (STOPPED, b"")


def test_of_somebody_elses_program_no_stop_is_claimed():
    answer = StopAnswer()
    answer.asking(Link(Port()))  # pyright: ignore[reportArgumentType]
    answer.found(at_rest=False)
    with pytest.raises(MountError, match="no firmware that takes a stop"):
        answer.stop()
