"""UF2 images of MicroPython: what one holds, whether it is whole, where its board's file system lies.

A .uf2 is a row of blocks of 512 bytes, each with an address, up to 476 bytes (256 on these chips) and the family of the
chips that it is for (github.com/microsoft/uf2). The families and block 0x10FFFF00 of an RP2350: RP2350 data sheet 5.5.3
and erratum RP2350-E10. A boot loader ignores blocks of other families.
"""

import functools
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mirrormount.errors import WrongImage
from mirrormount.supported import MICROPYTHON, Version, text
from mirrormount.supported import parse as parse_version

PAGE, SECTOR = 256, 4096  # what the flash of these chips programs and erases at once
_BLOCK = 512
_HEAD = struct.Struct("<8I")  # two marks, flags, address, size, number, count, family; then 476 bytes and a third mark
_BEGIN, _END = (0x0A324655, 0x9E5D5157), 0x0AB16F30
_HAS_FAMILY = 0x2000  # of the flags
FAMILIES = {0xE48BFF56: "RP2040", 0xE48BFF59: "RP2350", 0xE48BFF5A: "RP2350"}  # the last two: its Arm and RISC-V cores
RP2040 = 0xE48BFF56
_ABSOLUTE = 0xE48BFF57  # a block of zeros at 0x10FFFF00 for erratum RP2350-E10; its row has a count of its own
_LARGEST = 32 << 20  # bytes; the largest flash of these chips is 16 MB, in blocks twice as long

# The SDK's binary info (pico-sdk, pico_binary_info: defs.h and structure.h): a table of what the image says of itself.
_INFO_BEGIN, _INFO_END, _INFO_WITHIN = 0x7188EBF2, 0xE71AA390, 1024
_BLOCK_DEVICE = 7
_FILES = b"MicroPython"  # the name of the block device that is MicroPython's file system


@dataclass(frozen=True)
class Image:
    """An image for one family of chips. blocks: {address: bytes}, in the order of their addresses."""

    name: str
    family: int
    blocks: Mapping[int, bytes]

    @property
    def chip(self) -> str:
        """RP2040 or RP2350."""
        return FAMILIES[self.family]

    @property
    def start(self) -> int:
        """The lowest address."""
        return next(iter(self.blocks))

    @functools.cached_property
    def content(self) -> bytes:
        """All bytes from `start` on; what no block has is erased flash, 0xFF."""
        last = max(self.blocks)
        whole = bytearray(b"\xff" * (last + len(self.blocks[last]) - self.start))
        for address, data in self.blocks.items():
            whole[address - self.start : address - self.start + len(data)] = data
        return bytes(whole)

    @property
    def version(self) -> Version:
        """The release of MicroPython that it holds, (major, minor, ...). Raises WrongImage for none or an old one."""
        found = micropython_version(self.content)
        if found is None:
            other = b"Adafruit CircuitPython" in self.content
            then = "; CircuitPython goes on by hand, then mirrormount deploy" if other else ""
            raise WrongImage(f"{self.name} holds no MicroPython{then}")
        if MICROPYTHON.too_old(found):
            lowest = text(MICROPYTHON.lowest)
            raise WrongImage(f"{self.name} is MicroPython {text(found)}: {lowest} or later is needed")
        return found

    @property
    def machine(self) -> str:
        """What MicroPython calls the board, "Raspberry Pi Pico with RP2040"; "" if it does not say."""
        found = re.search(rb"([ -:<-~]{1,60} with " + self.chip.encode() + rb")\0", self.content)
        return found[1].decode().strip() if found else ""

    def file_system(self) -> tuple[int, int]:
        """Address and size of MicroPython's file system. Raises WrongImage."""
        for entry in self._info():
            name, address, size = (self._word(entry + offset) for offset in (4, 8, 12))
            if self._word(entry) & 0xFFFF == _BLOCK_DEVICE and self._text(name) == _FILES:
                if address <= max(self.blocks) < address + size:
                    raise WrongImage(f"{self.name} holds files already: name MicroPython's own image")
                if size and address % SECTOR == size % SECTOR == 0 and max(self.blocks) < address:
                    return address, size
                break
        raise WrongImage(f"{self.name} does not say where its file system lies, so no files can be put into it")

    def _info(self) -> list[int]:
        """The addresses of what the image says of itself."""
        for at in range(self.start, self.start + _INFO_WITHIN, 4):
            if self._word(at) == _INFO_BEGIN and self._word(at + 16) == _INFO_END:
                first, last = self._word(at + 4), self._word(at + 8)
                return [self._word(pointer) for pointer in range(first, min(last, first + _INFO_WITHIN), 4)]
        return []

    def _word(self, address: int) -> int:
        word = self.content[address - self.start : address - self.start + 4] if address >= self.start else b""
        return int.from_bytes(word, "little") if len(word) == 4 else 0

    def _text(self, address: int) -> bytes:
        return self.content[max(0, address - self.start) :][:32].partition(b"\0")[0]


def micropython_version(content: bytes) -> Version | None:
    """The release of the MicroPython whose image has this content; None if it is none."""
    found = re.search(rb"MicroPython v(\d{1,3}(?:\.\d{1,3}){1,2})", content)
    return parse_version(found[1].decode()) if found else None


def read_image(path: Path) -> Image:
    """The image in a file, whole and for one family of FAMILIES. Raises WrongImage."""
    try:
        if not path.is_file():
            raise WrongImage(f"{path}: there is no such image")
        if path.stat().st_size > _LARGEST:
            raise WrongImage(f"{path}: {path.stat().st_size >> 20} MB, more than a board's flash holds")
        return parse(path.read_bytes(), str(path))
    except OSError as e:
        raise WrongImage(f"{path}: {e.strerror}") from e


def parse(data: bytes, name: str) -> Image:
    """The image that these bytes of a .uf2 are. Raises WrongImage."""
    rows: dict[int, dict[int, bytes]] = {}  # by family
    numbers: dict[int, list[tuple[int, int]]] = {}  # by family: (number, count) of each block
    if not data.startswith(b"UF2\n"):
        raise WrongImage(f"{name} is no .uf2")
    for at in range(0, len(data), _BLOCK):
        block = data[at : at + _BLOCK]
        if len(block) < _BLOCK or block[-4:] != _END.to_bytes(4, "little"):
            raise WrongImage(f"{name} is damaged or cut, at byte {at}: fetch it again")
        first, second, flags, address, size, number, count, family = _HEAD.unpack_from(block)
        if (first, second) != _BEGIN or size > _BLOCK - _HEAD.size - 4:
            raise WrongImage(f"{name} is damaged, at byte {at}: fetch it again")
        if not flags & _HAS_FAMILY or family == _ABSOLUTE:
            continue
        rows.setdefault(family, {})[address] = block[_HEAD.size : _HEAD.size + size]
        numbers.setdefault(family, []).append((number, count))
    if len(ours := rows.keys() & FAMILIES.keys()) != 1 or len(rows) != 1:
        found = ", ".join(f"{FAMILIES.get(family, 'unknown')} ({family:#010x})" for family in rows) or "none"
        raise WrongImage(f"{name} is no image for one chip, RP2040 or RP2350; its families: {found}")
    (family,) = ours
    if numbers[family] != [(n, len(numbers[family])) for n in range(len(numbers[family]))]:
        count = numbers[family][0][1]
        raise WrongImage(f"{name} is cut or damaged: {len(rows[family])} of {count} blocks; fetch it again")
    return Image(name, family, dict(sorted(rows[family].items())))


def written(blocks: Mapping[int, bytes], family: int) -> bytes:
    """A .uf2 with this content, {address: bytes}; addresses are multiples of PAGE.

    A sector is written whole: the RP2040's boot loader may lose what is in a sector that is not, unless it is the last
    (erratum RP2040-E14).
    """
    pages: dict[int, bytes] = {}
    for address, data in blocks.items():
        for at in range(0, len(data), PAGE):
            pages[address + at] = data[at : at + PAGE].ljust(PAGE, b"\xff")
    sectors = sorted({address - address % SECTOR for address in pages})
    every = [sector + at for sector in sectors for at in range(0, SECTOR, PAGE)]
    whole = bytearray()
    for number, at in enumerate(every):
        whole += _HEAD.pack(*_BEGIN, _HAS_FAMILY, at, PAGE, number, len(every), family)
        whole += pages.get(at, b"\xff" * PAGE).ljust(_BLOCK - _HEAD.size - 4, b"\0") + _END.to_bytes(4, "little")
    return bytes(whole)
