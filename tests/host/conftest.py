"""Fixtures: boards that are served while a test runs, boards that were deployed to, mounts with encoders."""

import itertools
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from deployed import Served, mpy_of_the_vm
from served import ServedBoard
from serving import Served as ServeProcess

from mirrormount.deploy.firmware import firmware
from mirrormount.deploy.micropython import Survey, plan
from mirrormount.device.mount import Mount
from mirrormount.errors import EmulatorMissing
from mirrormount_sim import machines


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., ServedBoard]]:
    with ExitStack() as boards:
        folders = (tmp_path / str(number) for number in itertools.count())
        yield lambda *options: boards.enter_context(ServedBoard(next(folders), *options))


@pytest.fixture
def board(serve) -> ServedBoard:
    return serve()


@pytest.fixture
def served(board, tmp_path) -> Iterator[Callable[..., ServeProcess]]:
    all_served: list[ServeProcess] = []

    def start(*options: str, **environment: str) -> ServeProcess:
        all_served.append(ServeProcess(tmp_path, str(board.link), *options, **environment))
        return all_served[-1]

    yield start
    for each in all_served:
        each.clear_up()


@pytest.fixture
def boot(serve, tmp_path):
    """Switches on a VM; root is its file system, by default an empty one."""

    def switch_on(root: Path | None = None) -> Served:
        root = root or tmp_path / "files"
        root.mkdir(exist_ok=True)
        try:
            machines.micropython(root)
        except EmulatorMissing as e:
            pytest.skip(str(e))
        return Served(serve("--machine", "micropython", "--files", str(root)), root)

    return switch_on


@pytest.fixture(scope="module")
def deployed_files(tmp_path_factory) -> Path:
    """What a deploy leaves on a blank board, made without a board."""
    root = tmp_path_factory.mktemp("deployed")
    todo = plan(firmware(mpy_of_the_vm()), Survey(), lambda _aside: True)
    for path, content in todo.upload.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(content)
    return root


@pytest.fixture
def deployed(boot, deployed_files: Path, tmp_path: Path) -> Served:
    """A board that was deployed to, as it is after power-up."""
    return boot(Path(shutil.copytree(deployed_files, tmp_path / "deployed")))


HOLDER = """
import os, sys, threading
from mirrormount import Mount
m = Mount.open(sys.argv[1])
exec(sys.argv[2])
print('ready', flush=True)
input()
"""


@pytest.fixture
def runtime(tmp_path_factory, monkeypatch):
    """The folder of stop sockets, of this test's own: other boards on this computer are not meant."""
    folder = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    return folder / "mirrormount"


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    """A folder of settings of this test's own."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))


@pytest.fixture
def mount():
    """A mount with end-stops, in lockstep."""
    with Mount.open("virtual://?speed=max&bench=switches") as mount:
        yield mount


@pytest.fixture
def holder():
    """Starts a program that opens a mount and runs some code with it."""
    started = []

    def start(address: str, code: str = "") -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDER, address, code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout.readline() == "ready\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def loop():
    from closed_loop import ClosedLoop

    made = []

    def make(*args, **options):
        made.append(ClosedLoop(*args, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()
