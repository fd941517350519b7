"""The rehearsal of docs/bring-up.md does what it says, on the board that it starts."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mirrormount.errors import EmulatorMissing
from mirrormount.transport.discovery import KNOWN_IDS
from mirrormount_sim import machines

DOCS = Path(__file__).parent.parent.parent / "docs"
PAGE = (DOCS / "bring-up.md").read_text()
SCRIPT = str(Path(sys.executable).with_name("mirrormount"))


def blocks() -> list[list[str]]:
    """The commands of the rehearsal: those of the one terminal, and those of the other."""
    section = PAGE.split("## Rehearsal without parts\n")[1].split("\n## ")[0]
    found = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    return [[line.partition(" #")[0].strip() for line in block.splitlines()] for block in found]


@pytest.mark.wall_clock  # a command that gets no processor for half a second is stopped by the board, by design
@pytest.mark.skipif(os.name != "posix", reason="a pseudo-terminal needs POSIX")
def test_the_commands_of_the_rehearsal_work_in_their_order(tmp_path):
    try:
        machines.micropython(tmp_path)
    except EmulatorMissing as e:
        pytest.skip(str(e))
    (start,), (setting, *commands, unsetting) = blocks()
    name, _, value = setting.removeprefix("export ").partition("=")
    environment = os.environ | {name: value, "MIRRORMOUNT_CONFIG": str(tmp_path)}
    program, *words = shlex.split(start)
    assert program == "mirrormount" and name == "MIRRORMOUNT_PORT" and len(commands) >= 12
    assert unsetting == f"unset {name}"
    board = subprocess.Popen([SCRIPT, *words], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        assert board.stdout and board.stdout.readline().startswith("ready ")
        for command in commands:
            program, *words = shlex.split(command)
            assert program == "mirrormount"
            done = subprocess.run(
                [SCRIPT, *words],
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                timeout=300,
                stdin=subprocess.DEVNULL,
            )
            assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    finally:
        board.send_signal(signal.SIGTERM)
        board.communicate()


def test_what_the_page_says_of_the_board_files_is_true():
    from mirrormount.deploy.firmware import boards, firmware
    from mountfw.board_file import FILE_OF

    known = boards(firmware(None))
    for named in re.findall(r"--board (\w+)`", PAGE):
        assert named in known or named == "NAME"
    assert set(FILE_OF.values()) <= set(known)


def test_the_page_and_the_udev_file_have_the_usb_ids_that_are_looked_for():
    ids = {f"{vendor:04x}:{product:04x}" for vendor, product in KNOWN_IDS}
    text = (DOCS / "60-mirrormount.rules").read_text()
    comment, rules = text.split("ACTION==", 1)
    found = re.findall(r'^(SUBSYSTEMS?)=.*idVendor}=="(\w+)", ATTRS{idProduct}=="([\w|]+)"', rules, re.MULTILINE)
    of = {
        kind: {f"{v}:{p}" for one, v, several in found if one == kind for p in several.split("|")} for kind, *_ in found
    }
    assert of["SUBSYSTEM"] == of["SUBSYSTEMS"] >= ids  # each may be opened, and is no modem
    boot_loaders = {"2e8a:0003", "2e8a:000f"}
    assert set(re.findall(r"\b[0-9a-f]{4}:[0-9a-f]{4}\b", comment)) - boot_loaders == of["SUBSYSTEM"]
    assert all(f"USB id {one}" in PAGE for one in ids)
    in_doubt = (0x239A, 0x80F2)  # of the Feather RP2040 with CircuitPython
    assert in_doubt not in KNOWN_IDS and f"{in_doubt[0]:04x}:{in_doubt[1]:04x}" in PAGE
