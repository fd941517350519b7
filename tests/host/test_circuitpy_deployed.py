"""What deploy has put on a drive is what runs: the port on fakes, booted from that very drive, answers for itself."""

import pytest
from drive_board import Board, make_drive, plug_in

from mirrormount import __version__
from mirrormount.deploy.firmware import package
from mirrormount.deploy.micropython import deploy
from mirrormount.deploy.prompt import Options
from mirrormount.device.mount import Mount
from mirrormount.transport.link import Link
from mirrormount_sim import machines
from mirrormount_sim.board import LockstepPort
from mirrormount_sim.simulation import Simulation


class BootedBoard(Board):
    """Runs the firmware that is on its drive, not one of its own."""

    port: LockstepPort | None = None

    def start(self) -> None:
        super().start()
        self.end()
        if self.running:
            self.port = LockstepPort(Simulation(machines.circuitpython(self.root, firmware=self.root)))

    def firmware(self, data: bytes) -> bytes:
        self.port.write(data)
        answer = b""
        while not answer.endswith(b"\n") and (more := self.port.read(1)):
            answer += more
        return answer

    def end(self) -> None:
        if self.port:
            self.port.close()
            self.port = None


@pytest.fixture
def board(tmp_path, monkeypatch):
    code = (package() / "entry" / "code.py").read_bytes()
    board = BootedBoard(make_drive(tmp_path / "CIRCUITPY"), code)
    plug_in(board, monkeypatch, back_s=5)
    yield board
    board.end()


def test_the_firmware_on_the_drive_tells_the_hash_that_deploy_has_computed(board):
    said = deploy(Options())
    assert said.startswith("OK: Raspberry Pi Pico, mountfw 0.3.0, 2 axes, the board tells the hash of what was sent")


def test_the_firmware_on_the_drive_makes_steps(board):
    deploy(Options())
    link = Link(board.port)
    mount = Mount(link)
    mount.x.step(2)
    pulses = [(pin, duty) for _, pin, duty in board.port.simulation.edges if duty]
    assert pulses == [("m2_pos", 65535), ("m2_en", 65535)] * 2
    assert mount.x.position == 2


def test_what_is_on_the_drive_runs_and_not_the_firmware_of_this_computer(board):
    deploy(Options())
    package = board.root / "mountfw" / "__init__.py"
    # another length: Python takes a compiled file for the same one by its second and length
    package.write_text(package.read_text().replace(f'"{__version__}"', '"98.7.65"'))
    module = board.root / "mountfw" / "codes.py"
    assert "NO ERROR DETECTED" in module.read_text()
    module.write_text(module.read_text().replace("NO ERROR DETECTED", "NO ERROR ON THIS DRIVE"))
    board.start()
    assert board.firmware(b"*IDN?\n").rstrip().endswith(b",98.7.65")
    assert board.firmware(b"TB?\n") == b"0, NO ERROR ON THIS DRIVE\r\n"


def test_a_build_without_sha256_tells_a_checksum_that_deploy_knows(board):
    (board.root / "hashlib.py").write_text("def new(name):\n    raise ValueError('Unsupported hash algorithm')\n")
    said = deploy(Options())
    assert "the board tells the checksum (it has no SHA-256) of what was sent" in said
    (board.root / "mountfw" / "boards" / "mine.py").write_text("# a board of my own\n")
    assert deploy(Options()).startswith("OK")
    (board.root / "mountfw" / "wire" / "ticks.py").write_bytes(
        (board.root / "mountfw" / "wire" / "ticks.py").read_bytes() + b"#"
    )
    board.start()
    assert board.firmware(b"XF?\n").startswith(b"crc32-")
