"""docs/other-programs.md: the bytes by hand and the program in C, on a board in a process or a clock of its own."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from served import HANG_S

from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep

DOCS = Path(__file__).parent.parent.parent / "docs"
PAGE = (DOCS / "other-programs.md").read_text(encoding="utf-8")
ROW = re.compile(r"\| `((?:[0-9A-F]{2} ?)+)` \| (`[^`]+`|LF) \|")
LOOK_US = 100_000


def lines_by_hand() -> list[tuple[bytes, str]]:
    """The bytes of each line of the page, and what the page says that comes back."""
    _, *parts = re.split(r"^\*\*\d\. ", PAGE.partition("## Five lines by hand")[2].partition("\n## ")[0], flags=re.M)
    found = []
    for part in parts:
        sent = b""
        for hexes, characters in ROW.findall(part):
            data = bytes.fromhex(hexes)
            assert characters == "LF" if data == b"\n" else characters.strip("`").encode() == data
            sent += data
        found.append((sent, part.partition("Comes back: ")[2]))
    return found


@pytest.fixture
def line():
    """A board in lockstep: sends bytes, and returns those that come back within a tenth of a second."""
    simulation = make_simulation(Options())
    board = Lockstep(simulation)
    board.run(LOOK_US)

    def send(data: bytes) -> bytes:
        board.received.clear()
        board.send(data)
        board.run(LOOK_US)
        return bytes(board.received)

    yield send
    simulation.close()


def test_the_bytes_of_the_page_do_what_it_says(line):
    (who, is_told), (move, nothing), (is_done, _), (where, at), (stop, nothing_either) = lines_by_hand()
    identity, five = (re.match(r"`(.+?)` and `0D 0A`", told)[1].encode() + b"\r\n" for told in (is_told, at))
    assert nothing.startswith("nothing") and nothing_either.startswith("nothing")
    assert line(who) == identity
    assert line(move) == b""
    answers = [line(is_done)]
    while answers[-1] == b"0\r\n":
        answers.append(line(is_done))
    assert answers[-1] == b"1\r\n" and len(answers) > 20, "five steps take 2.5 s"
    assert line(where) == five
    assert line(b"2XE?\n").startswith(b"1,5,")
    assert line(move) == b"" and line(is_done) == b"0\r\n"
    assert line(stop) == b"" and line(is_done) == b"1\r\n"
    assert line(b"2XE?\n").startswith(b"3,")


def test_a_move_with_the_pages_keep_alive_ends_when_nobody_asks(line):
    _, (move, _), *_ = lines_by_hand()
    line(move)
    for _ in range(6):
        line(b"")
    assert line(b"2MD?\n") == b"1\r\n"
    assert not line(b"2XE?\n").startswith(b"1,")


@pytest.mark.full  # it needs a compiler of C
def test_the_program_in_c_drives_a_board(board, tmp_path):
    compiler = shutil.which("cc")
    assert compiler, "install a compiler of C"
    program = tmp_path / "program"
    source = DOCS / "examples" / "mount.c"
    subprocess.run([compiler, "-Wall", "-Wextra", "-Werror", str(source), "-o", str(program)], check=True)
    run = subprocess.run([str(program), str(board.link)], capture_output=True, text=True, timeout=HANG_S)
    assert run.returncode == 0, run.stderr
    identity, position = run.stdout.splitlines()
    assert identity.startswith("mirrormount,Raspberry Pi Pico,") and position == "5"
    absent = subprocess.run([str(program), str(tmp_path / "none")], capture_output=True, text=True, timeout=HANG_S)
    assert (absent.returncode, absent.stderr) == (1, "port: No such file or directory\n")
