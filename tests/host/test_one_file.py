"""One .uf2 with MicroPython, firmware, board file and settings: what is in it. tests/emulated starts one."""

import json
import re
import sys

import pytest
from littlefs import LittleFS
from served import run_cli
from uf2_images import FILES, FILES_BYTES, FLASH, RP2040, RP2350, image, program, put

from mirrormount.deploy import one_file, uf2
from mirrormount.deploy.firmware import THIS, board_choice, firmware, mpy_of_pico
from mirrormount.deploy.prompt import Options
from mirrormount.device.mount import Mount
from mirrormount.device.settings import saved_file
from mirrormount.errors import BadValue, DeployError


def files_of(image: uf2.Image) -> tuple[LittleFS, dict[str, bytes]]:
    """The file system as MicroPython would mount it, and its files."""
    at, size = image.file_system() if max(image.blocks) < FILES else (FILES, FILES_BYTES)
    flash = image.content[at - image.start :].ljust(size, b"\xff")
    found = LittleFS(block_size=4096, block_count=size // 4096, read_size=32, prog_size=256, mount=False)
    found.context.buffer[:] = flash
    found.mount()
    files = {}
    for folder, _, names in found.walk("/"):
        for name in names:
            path = f"{folder}/{name}".lstrip("/")
            with found.open(path, "rb") as file:
                files[path] = file.read()
    return found, files


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One file with a board file and two settings, by the command; and what the command said."""
    folder = tmp_path_factory.mktemp("one")
    settings = folder / "settings.toml"
    settings.write_text("[x]\npulse_us = 123000\nvelocity = 1.25\n[y]\ninverted = 1\n")
    out, source = folder / "class.uf2", put(folder, image())
    words = ["--board", "pico_drv8833", "--settings", str(settings), "--image", str(source)]
    run = run_cli("flash", "--uf2", str(out), *words)
    assert run.returncode == 0, run.stderr
    return uf2.read_image(out), run.stdout


def test_its_file_system_has_the_place_and_the_size_that_micropython_mounts(made):
    found, _ = files_of(made[0])
    assert found.fs_stat().block_count == FILES_BYTES // 4096
    assert found.fs_stat().disk_version == 0x00020000  # the oldest: newer ones mount it, too


def test_it_holds_what_a_deploy_leaves_and_the_settings_and_nothing_else(made):
    _, files = files_of(made[0])
    wanted = firmware(mpy_of_pico((1, 25))) | {THIS: board_choice("pico_drv8833")}
    manifest = json.loads(files.pop("mountfw/manifest.json"))
    settings = {"x": {"pulse_us": 123_000, "velocity": 1.25}, "y": {"inverted": 1}}
    assert files == wanted | {"mountfw.settings": saved_file(settings)}
    assert set(manifest["files"]) == set(wanted)


def test_its_program_is_the_images(made):
    assert made[0].content.startswith(program())


def test_no_block_of_the_file_system_that_may_be_read_is_left_as_the_board_had_it(made):
    found, _ = files_of(made[0])
    written = {address for address in made[0].blocks if address >= FILES}
    used = found.used_block_count
    count = len(written) * 256 // 4096
    assert written == set(range(FILES, FILES + count * 4096, 256))  # without a gap, both blocks of each pair
    assert used <= count < FILES_BYTES // 4096 // 2


def test_the_command_says_what_it_holds_and_that_the_files_on_a_board_go(made):
    said = made[1]
    assert "MicroPython 1.25.0" in said and "3 settings" in said and "Raspberry Pi Pico with RP2040" in said
    assert "RPI-RP2" in said and "all files that are on the board go" in said


@pytest.mark.parametrize("version", ["1.22.2", "1.99.0"])
def test_a_release_whose_native_code_is_not_known_gets_the_source(version):
    files = one_file.firmware_files(uf2.parse(image(program(version=version)), "x.uf2"), Options())
    assert "mountfw/ports/rp2_lane.py" in files
    assert ("mountfw/app.mpy" in files) == (version == "1.22.2")


def test_files_that_do_not_fit_are_told():
    with pytest.raises(DeployError, match="do not fit into a file system of 128 KB"):
        one_file.file_system({"big": bytes(200_000)}, 32)


@pytest.mark.parametrize(
    ("data", "words", "why"),
    [
        (image(family=RP2350), [], "for an RP2350, .*made for an RP2040: it was not tried on others"),
        (image(program(machine="Some Board with RP2040")), [], "no board file for a 'Some Board'"),
        (image(), ["--board", "nosuch"], "there is no board file 'nosuch'"),
        (image(), ["/dev/ttyACM0"], "leave PORT and --drive out"),
        (uf2.written({FLASH: program(), FILES: b"files"}, RP2040), [], "holds files already"),
    ],
    ids=["RP2350", "a board without a file", "no such board file", "a port", "one file"],
)
def test_what_cannot_be_made_is_one_line_and_no_file(tmp_path, data, words, why):
    out = tmp_path / "out.uf2"
    run = run_cli("flash", "--uf2", str(out), "--image", str(put(tmp_path, data)), *words)
    assert (run.returncode, run.stdout, run.stderr.count("\n")) == (1, "", 1)
    assert re.search(why, run.stderr), run.stderr
    assert not out.exists()


def test_the_image_itself_is_not_replaced(tmp_path):
    path = put(tmp_path, image())
    run = run_cli("flash", "--uf2", str(path), "--image", str(path))
    assert run.returncode == 1 and "is the image itself" in run.stderr
    assert path.read_bytes() == image()


@pytest.mark.parametrize("missing", ["littlefs", "pooch"])
def test_without_the_extra_one_line_says_what_to_install(tmp_path, monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path))
    words = ["--image", str(put(tmp_path, image()))] if missing == "littlefs" else []
    run = run_cli("flash", "--uf2", str(tmp_path / "out.uf2"), *words)
    last = run.stderr.splitlines()[-1]
    assert run.returncode == 1
    assert (
        last.startswith("mirrormount: `mirrormount flash` needs a package that is not installed") and "[flash]" in last
    )


def test_a_board_that_finds_the_file_has_these_settings_and_the_rest_as_made(tmp_path):
    wanted = {"x": {"pulse_us": 123_000, "velocity": 1.25}, "y": {"soft_minimum": -5, "inverted": 1}}
    with Mount.open("virtual://?speed=max") as mount:
        made = mount.settings()
    (tmp_path / "mountfw.settings").write_bytes(saved_file(wanted))
    with Mount.open(f"virtual://?speed=max&files={tmp_path}") as mount:
        assert mount.errors() == []
        assert mount.settings() == {axis: values | wanted.get(axis, {}) for axis, values in made.items()}


@pytest.mark.parametrize(
    "wanted",
    [{"x": {"pulse_us": 1}}, {"x": {"soft_minimum": 5, "soft_maximum": 4}}, {"axis9": {"pulse_us": 1000}}],
    ids=["out of range", "contrary", "no such axis"],
)
def test_settings_that_no_board_takes_are_refused_before_a_file_is_made(wanted):
    with pytest.raises(BadValue):
        saved_file(wanted)
