"""A stand-in for a CircuitPython board: a folder as its drive, and ports that behave as such a board's do.

What it knows of CircuitPython: code.py runs at start-up and holds its modules in memory; boot.py of the firmware
gives it a data channel from the next reset on; Ctrl-C on the console leads to the prompt; a change of the drive
while a program runs restarts it, unless the program has switched that off.
"""

import hashlib
import shutil
from pathlib import Path
from types import SimpleNamespace

import mountfw
from mirrormount.deploy import circuitpython
from mirrormount.errors import ConnectionLost, PortAbsent
from mirrormount.transport import discovery
from mountfw.ports.shared import FOLDERS

UID = "E6605838835C8A2F"
BOOT_OUT = (
    "Adafruit CircuitPython {version} on 2024-11-20; Raspberry Pi Pico with rp2040\n"
    "Board ID:raspberry_pi_pico\nUID:" + UID + "\nboot.py output:\n"
)
THEIRS = b"print('a program of somebody else')\n"
FRESH = b'print("Hello World!")\n'
BROKEN = b"raise RuntimeError('broken')\n"  # what a firmware that fails begins with
CONSOLE, DATA = "/dev/ttyACM0", "/dev/ttyACM1"


def stand_in_firmware(folder: Path) -> Path:
    """A copy of the firmware's package with stand-ins for the two programs of CircuitPython."""
    library = Path(mountfw.__file__).parent
    copy = Path(shutil.copytree(library, folder / "mountfw", ignore=shutil.ignore_patterns("__pycache__")))
    (copy / "entry" / "code.py").write_text("# runs the mount\n")
    (copy / "entry" / "boot.py").write_text("# switches the data channel on\n")
    return copy


def make_drive(root: Path, version: str = "9.2.1") -> Path:
    """A new drive, as CircuitPython makes it."""
    (root / "lib").mkdir(parents=True)
    (root / "boot_out.txt").write_text(BOOT_OUT.format(version=version))
    (root / "code.py").write_bytes(FRESH)
    (root / "settings.toml").write_text("")
    return root


def contents(root: Path) -> dict[str, bytes]:
    """Every file of a drive."""
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def hash_on_board(root: Path) -> str:
    """XF? as the firmware makes it from the files that are there."""
    total = hashlib.sha256()
    for folder in ("", "mountfw", *(f"mountfw/{name}" for name in FOLDERS)):
        for path in sorted((root / folder).iterdir(), key=lambda p: p.name) if (root / folder).exists() else ():
            wanted = path.suffix in (".py", ".mpy") if folder else path.name in ("boot.py", "code.py")
            if path.is_file() and wanted:
                name = f"{folder}/{path.name}" if folder else path.name
                total.update(name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return f"sha256-{total.hexdigest()}"


def usb_port(device: str, location: str, interface: str | None, serial: str = UID) -> SimpleNamespace:
    """What pyserial tells of a port."""
    return SimpleNamespace(
        device=device, location=location, interface=interface, serial_number=serial, vid=0x239A, pid=0x80F4
    )


class Board:
    """The board. code: the code.py that is the firmware's; None: whatever is there."""

    def __init__(self, root: Path, code: bytes) -> None:
        self.root, self.code = root, code
        self.moving = False
        self.one_channel = False
        self.with_console = True
        self.heard = b""  # all that came in on any port
        self.resets = 0
        self.running = ""  # XF? of the firmware that runs, "" while none does
        self.has_data = False
        self.start()

    def start(self) -> None:
        """What happens at a reset."""
        self.at_prompt = False
        self.has_data = (self.root / "boot.py").exists() and not self.one_channel
        code = self.root / "code.py"
        starts = code.exists() and code.read_bytes() == self.code and not self.broken()
        self.running = hash_on_board(self.root) if starts else ""
        self.moving = False

    def broken(self) -> bool:
        """True if app.py is one that fails."""
        app = self.root / "mountfw" / "app.py"
        return app.exists() and app.read_bytes().startswith(BROKEN)

    def ports(self) -> list[SimpleNamespace]:
        """What list_ports tells."""
        console = [usb_port(CONSOLE, "1-2:1.0", "CircuitPython CDC control")] if self.with_console else []
        data = [usb_port(DATA, "1-2:1.2", "CircuitPython CDC2 control")] if self.has_data else []
        return console + data

    def open(self, address: str, **_) -> "BoardPort":
        """As link.open_port."""
        if address not in [port.device for port in self.ports()]:
            raise PortAbsent(f"{address}: there is no such port")
        return BoardPort(self, address)

    def hear(self, address: str, data: bytes) -> bytes:
        """What it says to data on a port."""
        self.heard += data
        if address == CONSOLE and b"microcontroller.reset()" in data:
            self.resets += 1
            self.start()
            raise ConnectionLost("reset")
        if address == CONSOLE and b"\x03" in data:
            self.at_prompt, self.running, self.moving = True, "", False
        if self.at_prompt and data == b"\x04" and address == CONSOLE and self.broken():
            return b'\r\nTraceback (most recent call last):\r\n  File "code.py"\r\nRuntimeError: broken\r\n\r\n>>> '
        if self.at_prompt:
            return b"\r\n>>> " if address == CONSOLE else b""
        if not self.running or (address == CONSOLE and self.has_data):
            return b""
        return self.firmware(data)

    def firmware(self, data: bytes) -> bytes:
        """The firmware's answers."""
        if data == b"!\n":
            self.moving = False
        status = f"1,2,0|0,{int(self.moving)},1,0,0,0|0,0,1,0,0,0"
        answers = {
            b"XS?\n": status,
            b"*IDN?\n": f"mirrormount,Raspberry Pi Pico,{UID},0.3.0",
            b"01>XF?;XH?;XS?\n": f"01>{self.running}; 1,2,3,0,0; {status}",
        }
        return (answers[data] + "\r\n").encode() if data in answers else b""


def plug_in(board: Board, monkeypatch, *, back_s: float) -> None:
    """Make it the only board that this computer sees. back_s: how long a deploy waits for it after a reset."""
    monkeypatch.setattr(discovery, "mounted", lambda: [board.root])
    monkeypatch.setattr("serial.tools.list_ports.comports", board.ports)
    monkeypatch.setattr(circuitpython, "open_port", board.open)
    monkeypatch.setattr(circuitpython, "_QUIET_S", 0.0)
    monkeypatch.setattr(circuitpython, "_BACK_S", back_s)


class BoardPort:
    """One open port of it."""

    lockstep = False

    def __init__(self, board: Board, address: str) -> None:
        self.board, self.address = board, address
        self.waiting = b""

    def read(self, timeout_s: float) -> bytes:
        data, self.waiting = self.waiting, b""
        return data

    def write(self, data: bytes) -> None:
        self.waiting += self.board.hear(self.address, data)

    def close(self) -> None:
        pass
