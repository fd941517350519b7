"""Files that mean harm, names that are none, output that nobody takes: one clear line, no file but the named one."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from served import run_cli

from mirrormount import errors, files
from mirrormount.cli.config import export
from mirrormount.device import calibration, settings
from mirrormount.device.mount import Mount
from mirrormount_sim import demo

MAX = ("--port", "virtual://?speed=max")


def one_line(run: subprocess.CompletedProcess) -> str:
    assert run.returncode == 1, (run.stdout, run.stderr)
    assert run.stderr.startswith("mirrormount: ") and run.stderr.count("\n") == 1, run.stderr
    assert run.stderr.rstrip("\n").isprintable()
    return run.stderr


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[x]\nvelocity = " + "7" * 900, "too long"),
        ("[x]\npulse_us = " + "[\n" * 20_000, "nested too deeply"),
        ('["\\u001b[2J"]\na = 1\n', r"\x1b[2J"),
        ('[x]\n"\\u001b[2J" = 1\n', r"\x1b[2J"),
        ('[x]\npulse_us = "\\u001b[2J"\n', r"\x1b[2J"),
        ("#" * (1 << 20) + "#", "more than"),
    ],
)
def test_a_hostile_file_of_settings_is_one_line_that_controls_no_terminal(tmp_path, text, says):
    file = tmp_path / "hostile.toml"
    file.write_text(text)
    assert says in one_line(run_cli("config", "import", str(file), *MAX))


@pytest.mark.parametrize("content", [b"[" * 100_000, b"9" * 5000, b"[1,\xff]", b" " * (1 << 20) + b"{}"])
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("run.sqlite", ("report", "FOLDER/run.sqlite")),
        ("camera.json", ("camera", "show", "--camera", "FOLDER", "--frames", "1")),
        ("calibration.json", ("hold", "--virtual", "--duration", "1", "--calibration", "FOLDER/calibration.json")),
    ],
)
def test_a_hostile_file_of_a_camera_or_a_loop_is_one_line(tmp_path, name, words, content):
    (tmp_path / name).write_bytes(content)
    assert f"{tmp_path}" in one_line(run_cli(*(word.replace("FOLDER", str(tmp_path)) for word in words)))


def test_an_export_follows_no_link_and_overwrites_no_file_beside_it(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("mine")
    for name in ("mount.toml.new", "mount.toml"):
        (tmp_path / name).symlink_to(secret)
    with Mount.open("virtual://?speed=max") as mount:
        with pytest.raises(errors.CannotWrite, match="it is a link"):
            export(mount, str(tmp_path / "mount.toml"))
        (tmp_path / "mount.toml").unlink()
        export(mount, str(tmp_path / "mount.toml"))
    assert secret.read_text() == "mine"
    assert "pulse_us" in (tmp_path / "mount.toml").read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mount.toml", "mount.toml.new", "secret"]


def test_a_users_own_link_to_the_scales_is_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    (tmp_path / "kept.toml").write_text("")
    calibration.path().symlink_to(tmp_path / "kept.toml")
    calibration.write("e661", {2: calibration.Scale(0.2, 0.2, calibration.Step(200_000, 255))})
    assert calibration.path().is_symlink()
    assert "positive = 0.2" in (tmp_path / "kept.toml").read_text()


@pytest.mark.parametrize("name", [".", "", "missing/../.."])
def test_what_is_no_files_name_is_refused(name):
    with pytest.raises(errors.CannotWrite):
        files.write_atomic(Path(name), "x = 1\n")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("virtual", "--files", "FILE", "--tcp", "0"), "it is not a folder"),
        (("virtual", "--files", "FILE/x", "--tcp", "0"), "Not a directory"),
        (("virtual", "--link", "FILE/x"), "cannot make"),
        (("virtual", "--tcp", "٣"), "port number"),
        (("virtual", "--tcp", "9" * 5000), "port number"),
        (("serve", "--tcp", "9" * 5000), "--tcp is PORT or HOST:PORT"),
        (("virtual", "--image", "FILE", "--tcp", "0"), "for the machine rp2040"),
        (("virtual", "--flash", "FILE", "--tcp", "0"), "for the machine rp2040"),
        (("virtual", "--machine", "rp2040", "--files", "FOLDER", "--tcp", "0"), "--flash"),
        (("status", "--port", "virtual://?files=FILE"), "it is not a folder"),
        (("status", "--port", "virtual://?seed=" + "9" * 5000), "a seed is a number"),
        (("status", "--port", "socket://127.0.0.1:" + "9" * 5000), "socket://HOST:PORT"),
        (("status", "--port", "socket://127.0.0.1:٣"), "socket://HOST:PORT"),
        (("status", "--port", "/dev/\x1b[2J"), r"\x1b[2J"),
        (("config", "export", ".", *MAX), "not a file"),
    ],
)
def test_names_and_numbers_that_cannot_be_are_one_line(tmp_path, words, says):
    (tmp_path / "file").write_text("")
    words = [word.replace("FILE", str(tmp_path / "file")).replace("FOLDER", str(tmp_path)) for word in words]
    assert says in one_line(run_cli(*words))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no full device here")
@pytest.mark.parametrize("words", [("status",), ("step", "x", "1"), ("config", "export", "-"), ("check",)])
def test_output_that_cannot_be_written_is_one_line(words):
    command = [sys.executable, "-m", "mirrormount", *words, *MAX]
    with open("/dev/full", "w") as full:
        run = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=600)
    assert "standard output: No space left" in one_line(run)


@pytest.mark.parametrize("words", [("setup",), ("config", "import", "-")])
def test_without_a_standard_input_there_is_one_line(words):
    code = "import sys; sys.stdin = None; from mirrormount.cli.main import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *words, *MAX]
    one_line(subprocess.run(command, capture_output=True, text=True, timeout=600))


def test_a_terminal_of_few_characters_gets_every_line():
    command = [sys.executable, "-m", "mirrormount", "config", "get", *MAX]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    run = subprocess.run(command, capture_output=True, text=True, timeout=600, env=environment)
    assert (run.returncode, run.stderr) == (0, "")
    assert len(run.stdout.splitlines()) == 2 * len(settings.SETTINGS.keys() - settings.ENCODER)


def test_a_demo_without_matplotlib_says_what_to_install_from_this_copy(monkeypatch, tmp_path):
    monkeypatch.setattr(demo.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(errors.ExtraMissing, match=r'pip install -e ".*\[plot\]"'):
        demo.demonstrate("virtual://", tmp_path / "square.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no full device here")
@pytest.mark.parametrize(("option", "what"), [("edges", "pin edges"), ("truth", "the truth")])
@pytest.mark.parametrize("speed", ["1", "max"])
def test_a_virtual_board_whose_file_cannot_be_written_says_so(option, what, speed):
    run = run_cli("step", "x", "2", "--port", f"virtual://?{option}=/dev/full&speed={speed}")
    assert f"cannot write {what} to /dev/full: No space left on device" in one_line(run)
