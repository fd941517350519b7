"""Images as .uf2: what is read of one, and which are refused."""

import struct

import pytest
from uf2_images import ABSOLUTE, FILES, FILES_BYTES, FLASH, RP2040, RP2350, block, image, program, put

from mirrormount.deploy import uf2
from mirrormount.errors import WrongImage


def test_of_an_image_its_chip_its_release_its_board_and_the_place_of_its_files_are_read():
    found = uf2.parse(image(), "x.uf2")
    assert (found.chip, found.version, found.machine) == ("RP2040", (1, 25, 0), "Raspberry Pi Pico with RP2040")
    assert found.file_system() == (FILES, FILES_BYTES)
    assert found.content.startswith(program())


def test_the_block_of_an_rp2350_that_is_for_every_chip_is_no_part_of_the_image():
    data = image(family=RP2350)
    assert struct.unpack_from("<I", data, 28)[0] == ABSOLUTE
    found = uf2.parse(data, "x.uf2")
    assert (found.chip, found.start, found.family) == ("RP2350", FLASH, RP2350)


GOOD = image()
COUNT = len(GOOD) // 512


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "no .uf2"),
        (b"PK\3\4" + bytes(508), "no .uf2"),
        (GOOD[:-100], f"cut, at byte {len(GOOD) - 512}"),
        (GOOD[:-512], f"{COUNT - 1} of {COUNT} blocks"),
        (GOOD[:512] + GOOD[1024:], f"{COUNT - 1} of {COUNT} blocks"),
        (GOOD[:1020] + b"<!DO" + GOOD[1024:], "damaged or cut, at byte 512"),
        (GOOD[:512] + b"X" + GOOD[513:], "damaged, at byte 512"),
        (GOOD + image(family=RP2350), "no image for one chip.*RP2040.*RP2350"),
        (image(family=0x1234), "unknown"),
        (block(FLASH, bytes(256), 0, 1, 0, flags=0), "families: none"),
    ],
    ids=["empty", "zip", "cut", "last gone", "one gone", "end", "begin", "two chips", "other chip", "no family"],
)
def test_what_is_not_one_whole_image_for_one_chip_is_refused(data, why):
    with pytest.raises(WrongImage, match=why):
        uf2.parse(data, "x.uf2")


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (image(program(version="1.21.0")), "MicroPython 1.21.0: 1.22 or later"),
        (image(program(version="")), "holds no MicroPython$"),
        (image(b"Adafruit CircuitPython 10.0.0 on 2025-10-08; Raspberry Pi Pico"), "CircuitPython goes on by hand"),
    ],
    ids=["old", "another program", "CircuitPython"],
)
def test_what_the_firmware_does_not_run_on_is_refused(data, why):
    with pytest.raises(WrongImage, match=why):
        uf2.parse(data, "x.uf2").version  # noqa: B018


@pytest.mark.parametrize(
    "files", [(0, 0), (FLASH - 0x1000, 0x1000), (FILES + 1, FILES_BYTES)], ids=["none", "before the program", "odd"]
)
def test_an_image_that_names_no_possible_place_for_files_is_refused(files):
    with pytest.raises(WrongImage, match="where its file system lies"):
        uf2.parse(image(program(files=files)), "x.uf2").file_system()


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(WrongImage, match="there is no such image"):
        uf2.read_image(tmp_path / "x.uf2")
    with pytest.raises(WrongImage, match="there is no such image"):
        uf2.read_image(tmp_path)


def test_what_is_written_has_whole_sectors_numbers_without_a_gap_and_the_chips_family(tmp_path):
    at, second = FLASH + 0x100, FLASH + 0x5000
    data = uf2.written({at: b"ab" * 200, second: b"c" * 256}, RP2040)
    heads = [struct.unpack_from("<8I", data, n) for n in range(0, len(data), 512)]
    assert [head[3] for head in heads] == [
        sector + page for sector in (FLASH, second) for page in range(0, 0x1000, 0x100)
    ]
    assert [head[5:7] for head in heads] == [(n, 32) for n in range(32)]
    assert {head[7] for head in heads} == {RP2040}
    found = uf2.read_image(put(tmp_path, data))
    assert found.blocks[at] + found.blocks[at + 256] == (b"ab" * 200).ljust(512, b"\xff")
    assert found.blocks[FLASH] == b"\xff" * 256
