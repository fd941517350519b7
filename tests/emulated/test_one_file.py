"""One .uf2 with MicroPython, firmware and settings starts on the emulated Pico; and `flash`, from a drive to a mount.

The image is the one that the emulator has (or builds); one that is no .uf2 is made one.
"""

from pathlib import Path

import pytest
from littlefs import LittleFS
from lockstep_board import Board
from served import ServedBoard, run_cli, wait_for
from uf2_images import FLASH, RP2040, Rom, make_drive

import mountfw
from mirrormount.deploy import uf2
from mirrormount.deploy.firmware import THIS, board_choice, firmware, firmware_hash, hashes, mpy_of_pico
from mirrormount.deploy.one_file import file_system
from mirrormount.device.mount import Mount
from mirrormount.errors import EmulatorMissing, MountError
from mirrormount_sim import emulator

FLASH_BYTES = 2 << 20


@pytest.fixture(scope="module")
def image(tmp_path_factory) -> Path:
    """MicroPython as a .uf2."""
    try:
        emulator.command()
        found = emulator.find_image(None)
    except EmulatorMissing as e:
        pytest.skip(str(e))
    if found.suffix == ".uf2":
        return found
    made = tmp_path_factory.mktemp("image") / f"{found.stem}.uf2"
    made.write_bytes(uf2.written({FLASH: found.read_bytes()}, RP2040))
    return made


@pytest.fixture(scope="module")
def one(image, tmp_path_factory) -> uf2.Image:
    """One file with two settings, as the command writes it."""
    folder = tmp_path_factory.mktemp("one")
    settings = folder / "settings.toml"
    settings.write_text("[x]\npulse_us = 123000\n[y]\nvelocity = 1.25\n")
    out = folder / "class.uf2"
    run = run_cli("flash", "--uf2", str(out), "--image", str(image), "--settings", str(settings))
    assert run.returncode == 0, run.stderr
    return uf2.read_image(out)


def drop(one: uf2.Image, flash: Path) -> Path:
    """What the boot loader does: each sector that has a page in the image is erased, then the pages are programmed."""
    content = bytearray(flash.read_bytes() if flash.exists() else b"\xff" * FLASH_BYTES)
    for sector in {address - address % uf2.SECTOR - FLASH for address in one.blocks}:
        content[sector : sector + uf2.SECTOR] = b"\xff" * uf2.SECTOR
    for address, data in one.blocks.items():
        content[address - FLASH : address - FLASH + len(data)] = data
    flash.write_bytes(content)
    return flash


def wanted_hash(one: uf2.Image) -> str:
    return firmware_hash(hashes(firmware(mpy_of_pico(one.version))))


def used(one: uf2.Image, image: Path, flash: Path) -> Path:
    """The flash of a board on which that file was dropped once, and whose files have often been written since."""
    at, size = uf2.read_image(image).file_system()
    files = LittleFS(block_size=4096, block_count=size // 4096, read_size=32, prog_size=256, mount=False)
    files.context.buffer[:] = drop(one, flash).read_bytes()[at - FLASH : at - FLASH + size]
    files.mount()
    folders = [folder for folder, _, _ in files.walk("/")]
    for turn in range(40):  # each block of each directory is written again
        for path in ("main.py", *(f"{folder}/older.py" for folder in folders)):
            with files.open(path, "wb") as file:
                file.write(b"print('older')\n# %d\n" % turn)
    content = flash.read_bytes()
    flash.write_bytes(content[: at - FLASH] + bytes(files.context.buffer) + content[at - FLASH + size :])
    return flash


@pytest.fixture(params=["empty", "used"])
def board(request, one, image, tmp_path, make_board) -> Board:
    """A Pico on which the file was dropped: a new one, or one that had other files."""
    flash = tmp_path / "flash.bin"
    if request.param == "used":
        used(one, image, flash)
    return make_board(flash=drop(one, flash), image=image)


def test_it_answers_with_its_hash_and_its_settings_without_a_deploy(board, one):
    assert board.ask(b"*IDN?\n", 3_000_000).startswith(b"mirrormount,")
    assert board.ask(b"XF?\n", 5_000_000).decode().strip() == wanted_hash(one)
    assert board.ask(b"2XP?;1XP?;1VA?;2VA?;TE?\n", 1_000_000) == b"123000; 200000; 1.25; 2; 0\r\n"


def test_the_board_that_had_other_files_ran_them_before(one, image, tmp_path, make_board):
    board = make_board(flash=used(one, image, tmp_path / "flash.bin"), image=image)
    board.send(b"\x04")
    board.until(b"older\r\n")


def test_nothing_else_is_on_it_and_what_is_saved_later_stays(board):
    board.ask(b"*IDN?\n", 3_000_000)
    board.send(b"1XP150000;SM\n")
    board.run(1_000_000)
    board.send(b"\x03")
    board.until(b">>> ")
    board.send(b"import os; print(sorted(os.listdir()), os.statvfs('/')[2])\r")
    board.until(b"['main.py', 'mountfw', 'mountfw.settings'] 352\r\n")
    board.simulation.lit = False
    board.simulation.reset(power=True)
    board.run(1_000)
    board.boot()
    board.received.clear()
    assert board.ask(b"1XP?;2XP?;TE?\n", 3_000_000) == b"150000; 123000; 0\r\n"


def test_the_firmware_starts_where_as_little_memory_is_left_as_on_a_pico_w(image, tmp_path, make_board):
    program = uf2.read_image(image)
    at, size = program.file_system()
    radio = b"taken = bytearray(41_000)  # of a Pico W's heap, which has 205 568 bytes, a Pico's 245 888\n"
    files = firmware(mpy_of_pico(program.version)) | {"main.py": radio + b"import mountfw.start\n"}
    files |= {THIS: board_choice("pico")}
    made = uf2.written({**program.blocks, at: file_system(files, size // uf2.SECTOR)}, RP2040)
    board = make_board(flash=drop(uf2.parse(made, "made"), tmp_path / "flash.bin"), image=image)
    assert board.ask(b"*IDN?\n", 3_000_000).startswith(b"mirrormount,")
    assert int(board.ask(b"XH?\n", 3_000_000).split(b",")[0]) > 60_000


@pytest.mark.full
def test_a_deploy_to_such_a_board_finds_all_as_it_should_be(one, image, tmp_path):
    flash = drop(one, tmp_path / "flash.bin")
    with ServedBoard(tmp_path / "board", "--machine", "rp2040", "--image", str(image), "--flash", str(flash)) as board:
        run = run_cli("deploy", "--port", str(board.link))
        assert run.returncode == 0, run.stderr
        count = len(firmware(mpy_of_pico(one.version)))
        assert f"mountfw {mountfw.__version__}, 2 axes, {count} files ({count} unchanged)" in run.stdout


@pytest.mark.full
def test_flash_makes_an_empty_pico_a_mount_with_the_real_image_and_the_real_mpremote(image, tmp_path):
    boards: list[ServedBoard] = []
    link = tmp_path / "board" / "mount"

    def restart() -> None:
        (tmp_path / "taken.uf2").write_bytes(rom.taken)
        words = ["--image", str(tmp_path / "taken.uf2"), "--flash", str(tmp_path / "flash.bin")]
        boards.append(ServedBoard(link.parent, "--machine", "rp2040", *words))

    rom = Rom(make_drive(tmp_path / "RPI-RP2"), restart)
    try:
        run = run_cli("flash", str(link), "--drive", str(tmp_path / "RPI-RP2"), "--image", str(image))
        assert run.returncode == 0, run.stderr
        assert "(0 unchanged)" in run.stdout and "ok         firmware" in run.stdout
        with wait_for(lambda: _opened(link), "the firmware to answer") as mount:
            mount.x.step(1)
        assert "m2_en" in [edge["pin"] for edge in boards[0].edges()]
    finally:
        for board in boards:
            board.kill()
            board.process.stdout.close()


def _opened(link: Path) -> Mount | None:
    try:
        return Mount.open(str(link))
    except MountError:
        return None
