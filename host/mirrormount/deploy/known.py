"""The firmware hashes that this host knows: what XF? answers for each board that its deploy can make."""

import hashlib
from collections.abc import Iterator

from mirrormount.deploy.fileset import (
    MPY_OF_PICO,
    MPY_VERSION,
    THIS,
    board_choice,
    boards,
    firmware,
    firmware_checksum,
    firmware_hash,
    sources,
)


def answers(files: dict[str, bytes]) -> tuple[str, ...]:
    """What XF? may answer on a CircuitPython board with these files: by SHA-256, or by CRC-32 before 10.1."""
    return firmware_hash(_hashes(files), "circuitpython"), firmware_checksum(files, "circuitpython")


def known_hashes() -> Iterator[str]:
    """What XF? answers for each board that a deploy can make, but for those with a file of somebody's own.

    The virtual boards of the cpython and circuitpython machines run the package as it is here, with the files of both
    platforms and no program beside it. Raises DeployError.
    """
    drive = sources("circuitpython")
    for name in (None, *boards(drive)):
        yield from answers(drive | ({THIS: board_choice(name)} if name else {}))
    for mpy in (None, MPY_VERSION, MPY_OF_PICO):
        files = _hashes(firmware(mpy))
        yield firmware_hash(_hashes(drive) | files, platform=None)
        for name in (None, *boards(files)):
            yield firmware_hash(files | (_hashes({THIS: board_choice(name)}) if name else {}), "micropython")


def _hashes(files: dict[str, bytes]) -> dict[str, str]:
    return {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}
