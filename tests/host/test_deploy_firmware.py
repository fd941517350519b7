"""Which files of the firmware a MicroPython board gets compiled: native code only where it fits the board."""

import pytest
from drive_board import hash_on_board

from mirrormount.deploy.firmware import MPY_OF_PICO, MPY_VERSION, firmware, firmware_hash, hashes, sources
from mirrormount.errors import DeployError

NATIVE = {path for path, text in sources("micropython").items() if b"@micropython.viper" in text}
ARCHITECTURE = 0xF << 10  # in sys.implementation._mpy
SUBVERSION = 3 << 8


def as_source(mpy: int) -> set[str]:
    return {path for path in firmware(mpy) if path.endswith(".py")}


def test_a_pico_gets_native_code_compiled():
    assert {"mountfw/ports/rp2_gate.py", "mountfw/ports/micropython_console.py"} <= NATIVE
    assert as_source(MPY_OF_PICO) == {"main.py"}
    assert firmware(MPY_OF_PICO)["mountfw/ports/rp2_gate.mpy"][2] == MPY_OF_PICO >> 8


@pytest.mark.parametrize("processor", [0, 7, 11])
def test_another_processor_compiles_native_code_itself(processor):
    assert as_source(MPY_OF_PICO & ~ARCHITECTURE | processor << 10) == {"main.py", *NATIVE}


@pytest.mark.parametrize("subversion", [1, 2])
def test_a_pico_with_an_older_format_compiles_native_code_itself(subversion):
    assert as_source(MPY_OF_PICO & ~SUBVERSION | subversion << 8) == {"main.py", *NATIVE}


def test_another_version_of_the_format_is_refused():
    with pytest.raises(DeployError, match="version 5"):
        firmware(MPY_VERSION - 1)


@pytest.mark.parametrize("stray", ["mountfw/axis.py", "mountfw/motion/stray.mpy"])
def test_a_file_that_nobody_listed_shows_in_the_hash_that_the_board_computes(tmp_path, stray):
    files = sources("circuitpython")
    for path, content in files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    assert hash_on_board(tmp_path) == firmware_hash(hashes(files), "circuitpython")
    (tmp_path / stray).write_text("")
    assert hash_on_board(tmp_path) == firmware_hash(hashes(files | {stray: b""}), "circuitpython")
