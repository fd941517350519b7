"""The prompt of a board on the MicroPython VM reaches nothing of the computer but the board's own files."""

import pytest

from mirrormount_sim import machines
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.machines import new_files
from mirrormount_sim.simulation import Simulation

SECRET = "a-word-that-is-in-no-other-file"


@pytest.fixture
def ask(tmp_path):
    """Runs Python at the raw prompt of a virtual board; returns what it prints."""
    (tmp_path / "secret.py").write_text(f"WORD = '{SECRET}'")
    root = tmp_path / "root"
    root.mkdir()
    new_files(root)
    simulation = Simulation(machines.micropython(root))
    board = Lockstep(simulation)
    board.boot()
    board.send(b"\x03\x03")
    board.run(100_000)
    board.send(b"\x01")
    board.run(100_000)

    def run(source: str) -> str:
        board.received.clear()
        board.send(source.encode() + b"\x04")
        board.run(3_000_000, lambda: board.received.count(b"\x04") >= 2)
        assert board.received.startswith(b"OK"), bytes(board.received)
        return bytes(board.received[2:]).decode()

    yield run
    simulation.close()


HOST_MODULES = (
    "ffi",
    "socket",
    "usocket",
    "ssl",
    "tls",
    "termios",
    "uctypes",
    "websocket",
    "_thread",
    "__main__",
    "mip",
)


def test_modules_of_the_host_cannot_be_imported(ask):
    for name in HOST_MODULES:
        assert "ImportError" in ask(f"import {name}"), name
        assert "ImportError" in ask(f"import sys\nsys.modules.pop('{name}', None)\n__import__('{name}')"), name
        assert "ImportError" in ask(f"import {name}.core"), name


WAYS_TO_OS = (
    "import os as m",
    "import uos as m",
    "import sys\nm = sys.modules['os']",
    "import sys\ndel sys.modules['os']\nimport os as m",
    "import usys\nusys.modules.clear()\nimport os as m",
    "import builtins\ndel builtins.__import__\nimport os as m",
    "import ubuiltins\nm = ubuiltins.__import__('os')",
    "m = print.__globals__.get('os')",
    "m = __import__.__globals__.get('os')",
    "m = open.__globals__.get('vfs') or open.__globals__.get('os')",
    "import micropython\nm = micropython.kbd_intr.__globals__.get('os')",
    "import os\nm = os.listdir.__globals__['os']",
    "import sys\ntry:\n import os.path\nexcept ImportError:\n pass\nm = sys.modules['os']",
    "import sys\nsys.modules.clear()\ntry:\n import os.path\nexcept ImportError:\n pass\nm = sys.modules['os']",
    "import vfs as m",
    "import uvfs as m",
    "import asyncio\nm = asyncio.core.sys.modules['os']",
)


@pytest.mark.parametrize("way", WAYS_TO_OS)
def test_no_way_leads_to_commands_or_to_another_mount_of_the_disk(ask, way):
    said = ask(f"{way}\nprint([n for n in ('system', 'getenv', 'putenv', 'VfsPosix') if hasattr(m, n)])")
    assert said.startswith("[]\r\n\x04") or "Error" in said, said


@pytest.mark.parametrize(
    "way",
    [
        "print(open('../secret.py').read())",
        "print(open('/../secret.py').read())",
        "print(open('/mountfw/../../secret.py').read())",
        "import io\nprint(io.open('/./../secret.py').read())",
        "import uio\nprint(uio.open('../secret.py').read())",
        "import os\nos.chdir('..')\nprint(open('secret.py').read())",
        "import os\nos.chdir('mountfw')\nprint(open('../../secret.py').read())",
        "import sys\nsys.path.append('..')\nimport secret\nprint(secret.WORD)",
        "import sys\nsys.path.append('/mountfw/../..')\nimport secret\nprint(secret.WORD)",
        "import os\nos.rename('../secret.py', 'secret.py')\nprint(open('secret.py').read())",
        "import builtins\nbuiltins.execfile('../secret.py')\nprint(WORD)",
        "execfile('../secret.py')\nprint(WORD)",
        "import vfs\nprint(type(vfs.mount()[0][0])('/').open('SECRET', 'r').read())",
        "print(type(open('main.py'))('SECRET').read())",
        "import vfs\nvfs.umount('/')\nprint(open('SECRET').read())",
    ],
)
def test_no_file_outside_of_the_boards_own_is_read(ask, way, tmp_path):
    assert SECRET not in ask(way.replace("SECRET", str(tmp_path / "secret.py")))
    assert (tmp_path / "secret.py").exists()


def test_a_descriptor_of_the_host_is_no_file(ask):
    for number in (0, 1, 2, 3, 4):
        assert "TypeError" in ask(f"open({number})")


def test_what_a_board_has_works(ask, tmp_path):
    (tmp_path / "root" / "mine.py").write_text("print('from a file')")
    source = """
import os, uos, io, sys, json, hashlib, machine, time
os.mkdir('d')
with open('d/a', 'w') as f: f.write('x')
os.rename('d/a', 'd/b'); os.chdir('d')
print(os.getcwd(), os.listdir(), os.stat('b')[6], list(os.ilistdir('/d'))[0][0], os is uos)
os.remove('b'); os.chdir('/'); os.rmdir('d')
os.statvfs('/')
print(io.StringIO('s').read(), machine.Pin is not None, time.ticks_ms() > 0)
import mine
"""
    assert ask(source).startswith("/d ['b'] 1 b True\r\ns True True\r\nfrom a file\r\n\x04\x04")
