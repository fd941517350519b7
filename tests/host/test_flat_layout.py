"""From the flat layout of 0.1.0 to the folders of now: over a power cut at any operation, and off the board again."""

import hashlib
import shutil
from pathlib import Path

import pytest
from cut_board import MAIN, Board, PowerCut
from cut_drive import CutFiles, put
from drive_board import contents, hash_on_board, make_drive
from flat_layout import flat

from mirrormount.deploy.circuitpython_copy import remove
from mirrormount.deploy.fileset import firmware_hash, folders, sources
from mirrormount.transport.circuitpy_files import Files

OLD = flat("micropython", ".mpy") | {"main.py": f"{MAIN}# 0.1.0\n".encode()}
ROOMS = ("boards", "dialect", "encoder", "motion", "ports", "wire")
NEW_FOLDERS = {"mountfw", *(f"mountfw/{room}" for room in ROOMS)}


def stand_ins(platform: str, suffix: str = ".py") -> dict[str, bytes]:
    """The firmware's files of now, with short contents."""
    paths = [path for path in sources(platform) if path.startswith("mountfw/")]
    return {path.removesuffix(".py") + suffix: f"# {path} of now\n".encode() for path in paths}


NEW = stand_ins("micropython", ".mpy") | {"main.py": f"{MAIN}# now\n".encode()}


def without_manifest(files: dict[str, bytes]) -> dict[str, bytes]:
    return {path: content for path, content in files.items() if path != "mountfw/manifest.json"}


def as_imported(files: dict[str, bytes]) -> dict[str, bytes]:
    return {path.removesuffix(".mpy"): content for path, content in files.items()}


def test_the_two_layouts_share_no_module_but_those_in_the_packages_own_folder():
    both = {path for path in OLD if path in NEW and "/boards/" not in path}
    assert both <= {"main.py", *(f"mountfw/{name}.mpy" for name in ("__init__", "app", "homing", "repl", "settings"))}
    assert set(folders(NEW)) == NEW_FOLDERS and set(folders(OLD)) == {"mountfw", "mountfw/boards"}


@pytest.fixture
def board(tmp_path: Path) -> Board:
    board = Board(tmp_path / "board")
    board.deploy(OLD)
    board.put({"notes.txt": b"mine"})
    assert without_manifest(board.contents()) == OLD | {"notes.txt": b"mine"}
    return board


def test_a_deploy_over_the_flat_layout_may_lose_power_anywhere(board, tmp_path):
    whole = Board(Path(shutil.copytree(board.root, tmp_path / "whole")))
    count = whole.deploy(NEW)
    assert without_manifest(whole.contents()) == NEW | {"notes.txt": b"mine"}
    assert whole.folders() == NEW_FOLDERS
    booted = set()
    for last in range(1, count + 1):
        cut = Board(Path(shutil.copytree(board.root, tmp_path / "cut")))
        with pytest.raises(PowerCut):
            cut.deploy(NEW, last)
        cut.boot()
        runs = cut.runs()
        assert runs in (as_imported(OLD), as_imported(NEW)), f"after a cut at operation {last}"
        booted.add(runs == as_imported(OLD))
        cut.deploy(NEW)
        assert (cut.contents(), cut.folders()) == (whole.contents(), whole.folders()), f"at operation {last}"
        shutil.rmtree(cut.root)
    assert booted == {True, False}


def test_a_firmware_in_folders_that_does_not_answer_gives_way_to_the_flat_one(board):
    before = board.contents(), board.folders()
    board.deploy(NEW, answers=False)
    assert (board.contents(), board.folders()) == before


@pytest.mark.parametrize("firmware", [OLD, NEW], ids=["flat", "in folders"])
def test_an_undeploy_removes_every_file_and_folder_of_either_layout(tmp_path, firmware):
    board = Board(tmp_path / "board")
    board.deploy(firmware)
    board.put({"notes.txt": b"mine"})
    board.undeploy()
    assert board.contents() == {"notes.txt": b"mine"}
    assert board.folders() == set()


def test_an_undeploy_after_a_cut_deploy_over_the_flat_layout_removes_both(board, tmp_path):
    count = Board(Path(shutil.copytree(board.root, tmp_path / "whole"))).deploy(NEW)
    for last in range(1, count + 1, 7):
        cut = Board(Path(shutil.copytree(board.root, tmp_path / "cut")))
        with pytest.raises(PowerCut):
            cut.deploy(NEW, last)
        cut.deploy(NEW)
        cut.undeploy()
        assert (cut.contents(), cut.folders()) == ({"notes.txt": b"mine"}, set()), f"at operation {last}"
        shutil.rmtree(cut.root)


def hashes(files: dict[str, bytes]) -> dict[str, str]:
    return {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}


@pytest.mark.parametrize("stray", ["mountfw/axis.py", "mountfw/axis.mpy"])
def test_a_flat_file_that_was_left_over_shows_in_the_hash_of_the_firmware(tmp_path, stray):
    of_now = sources("circuitpython")
    board = Board(tmp_path / "board")
    board.put(of_now)
    expected = firmware_hash(hashes(of_now), "circuitpython")
    assert hash_on_board(board.root) == expected
    board.put({stray: b"# axis of 0.1.0\n"})
    assert hash_on_board(board.root) == firmware_hash(hashes(of_now | {stray: b"# axis of 0.1.0\n"}), "circuitpython")
    assert hash_on_board(board.root) != expected


# ---- a CircuitPython drive

PROGRAMS = ("boot.py", "code.py")
OLD_DRIVE = flat("circuitpython") | {name: b"# old\n" + name.encode() for name in PROGRAMS}
NEW_DRIVE = stand_ins("circuitpython") | {name: b"# new\n" + name.encode() for name in PROGRAMS}


def runs_on(root: Path) -> str:
    """ "old", "new" or "nothing"; fails for a mix of the layouts."""
    on_it = contents(root)
    program = on_it.get("code.txt", on_it.get("code.py", b""))
    for name, version in (("old", OLD_DRIVE), ("new", NEW_DRIVE)):
        if program == version["code.py"]:
            assert {path: on_it.get(path) for path in version} == version
            return name
    return "nothing"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    root = make_drive(tmp_path / "drive")
    put(Files(root), OLD_DRIVE)
    assert runs_on(root) == "old"
    return root


def folders_on(root: Path) -> set[str]:
    return {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_dir()}


def test_a_deploy_to_a_drive_over_the_flat_layout_may_lose_power_anywhere(drive, tmp_path):
    whole = CutFiles(Path(shutil.copytree(drive, tmp_path / "whole")))
    put(whole, NEW_DRIVE)
    wanted = contents(whole.root)
    assert runs_on(whole.root) == "new" and not set(flat("circuitpython")) - set(NEW_DRIVE) & set(wanted)
    assert {name for name in folders_on(whole.root) if name.startswith("mountfw")} == NEW_FOLDERS
    seen = set()
    for last in range(1, whole.count + 1):
        root = Path(shutil.copytree(drive, tmp_path / "cut"))
        with pytest.raises(PowerCut):
            put(CutFiles(root, last), NEW_DRIVE)
        seen.add(runs_on(root))
        put(Files(root), NEW_DRIVE)
        assert contents(root) == wanted, f"after a cut at operation {last}"
        shutil.rmtree(root)
    assert seen == {"old", "nothing"}


@pytest.mark.parametrize("firmware", [OLD_DRIVE, NEW_DRIVE], ids=["flat", "in folders"])
def test_an_undeploy_removes_every_file_and_folder_of_either_layout_from_a_drive(tmp_path, firmware):
    root = make_drive(tmp_path / "drive")
    put(Files(root), firmware)
    remove(Files(root))
    assert set(contents(root)) == {"boot_out.txt", "settings.toml"}  # the code.py that every new drive has is no loss
    assert folders_on(root) <= {"lib"}
