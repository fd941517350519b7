"""One .uf2 with MicroPython and, in its file system, the firmware, a board file and settings: to drop on many boards.

The file system is littlefs, as MicroPython's rp2 port makes it (ports/rp2/modules/_boot.py, extmod/vfs_lfs.c: blocks of
4096 bytes, read 32, program 256). A board that starts from it finds what a deploy would have left, the manifest
included, so that later deploys go on from there.
"""

from mirrormount.deploy import uf2
from mirrormount.deploy.firmware import check_board_file, check_choice, firmware, folders, mpy_of_pico
from mirrormount.deploy.micropython import Survey, chosen_board, plan
from mirrormount.deploy.prompt import Options
from mirrormount.errors import DeployError, WrongImage
from mirrormount.supported import MICROPYTHON

_READ, _PROGRAM, _CACHE, _LOOKAHEAD, _CYCLES = 32, uf2.PAGE, 1024, 32, 100
_DISK_VERSION = 0x00020000  # littlefs 2.0: what has 2.1 mounts it, too, and makes it 2.1 when it writes
_GROWTH = 16  # blocks between two tries of a size
_SPARE = 8  # blocks that stay free: littlefs needs some at its end


def one_file(image: uf2.Image, options: Options, more: dict[str, bytes]) -> bytes:
    """The .uf2. options: those of a deploy, of which the board file counts; more: further files, such as the settings.

    Raises WrongImage for an image that is not MicroPython's for an RP2040, DeployError.
    """
    if image.family != uf2.RP2040:
        raise WrongImage(
            f"{image.name} is for an {image.chip}, and one file with the firmware is made for an RP2040: it was not"
            " tried on others; mirrormount flash --image FILE puts such an image on one board"
        )
    at, size = image.file_system()
    files = firmware_files(image, options) | more
    return uf2.written({**image.blocks, at: file_system(files, size // uf2.SECTOR)}, image.family)


def firmware_files(image: uf2.Image, options: Options) -> dict[str, bytes]:
    """What a deploy leaves on an RP2040 with this image: {path: content}. Raises WrongImage, DeployError."""
    version = image.version
    # what the compiled files of a newer one must look like is not known: it takes the source in any case
    files = firmware(None if MICROPYTHON.untried(version) else mpy_of_pico(version)) | chosen_board(options)
    check_choice(options.board, files)
    check_board_file(image.machine, files)
    return dict(plan(files, Survey(), lambda _aside: True).upload)


def file_system(files: dict[str, bytes], blocks: int) -> bytes:
    """The first blocks of a littlefs of so many blocks that holds these files; the rest is free.

    Those that may be read before they are erased are all there: a directory is a pair of blocks, of which the one with
    the higher number counts, so what an earlier file system has left in the other one must go. Raises DeployError.
    """
    from littlefs import LittleFS, LittleFSError

    # as small as it can be: littlefs takes its blocks from all that it has
    for count in range(_GROWTH, blocks, _GROWTH):
        try:
            made = LittleFS(
                block_size=uf2.SECTOR,
                block_count=count,
                read_size=_READ,
                prog_size=_PROGRAM,
                cache_size=_CACHE,
                lookahead_size=_LOOKAHEAD,
                block_cycles=_CYCLES,
                disk_version=_DISK_VERSION,
            )
            for folder in folders(files):
                made.mkdir(folder)
            for path, content in sorted(files.items()):
                with made.open(path, "wb") as file:
                    file.write(content)
            if made.used_block_count + _SPARE <= count:
                made.fs_grow(blocks)
                return bytes(made.context.buffer)
        except (LittleFSError, OSError):  # no room
            continue
    raise DeployError(f"the files do not fit into a file system of {blocks * uf2.SECTOR // 1024} KB")
