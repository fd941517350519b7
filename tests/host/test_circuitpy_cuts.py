"""A deploy by drive whose power goes at each single file operation, and in the middle of each write.

What CircuitPython would then run is code.py with what it imports: all of it old, or all of it new, or nothing of ours.
"""

import shutil
from pathlib import Path

import pytest
from cut_board import PowerCut
from cut_drive import CutFiles, put
from drive_board import THEIRS, contents, make_drive, stand_in_firmware

from mirrormount.deploy import firmware
from mirrormount.deploy.circuitpython import Files, remove

OLD_LIBRARY = {"lib/adafruit_motor/__init__.py": b"", "lib/adafruit_motor/motor.py": b"# old library\n"}
NEW_LIBRARY = {"lib/adafruit_motor/__init__.py": b"", "lib/adafruit_motor/motor.py": b"# new library\n"}


@pytest.fixture(scope="module")
def versions(tmp_path_factory) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Two versions of the firmware: in the new one every file differs, one is new and one is gone."""
    folder = stand_in_firmware(tmp_path_factory.mktemp("firmware"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(firmware, "package", lambda: folder)
        files = firmware.sources("circuitpython")
    few = ("boot.py", "code.py", "mountfw/__init__.py", "mountfw/app.py", "mountfw/boards/pico.py")
    old = {path: b"# old\n" + files[path] for path in few} | OLD_LIBRARY | {"mountfw/gone.py": b"# old\n"}
    new = {path: b"# new\n" + files[path] for path in few} | NEW_LIBRARY | {"mountfw/added.py": b"# new\n"}
    return old, new


def before_the_cut(kind: str, root: Path, old: dict[str, bytes]) -> Path:
    """A drive of this kind."""
    make_drive(root)
    if kind == "an older version":
        put(Files(root), old)
    if kind == "somebody's program":
        (root / "lib" / "adafruit_motor").mkdir()
        for path in ("code.py", "boot.py", "code.txt", "lib/adafruit_motor/motor.py"):
            (root / path).write_bytes(THEIRS + path.encode())
    return root


def runs(root: Path, old: dict[str, bytes], new: dict[str, bytes]) -> str:
    """What this drive runs: "old", "new", "theirs", or "nothing"; fails for a mix."""
    on_it = contents(root)
    program = on_it.get("code.txt", on_it.get("code.py", b""))
    for name, version in (("old", old), ("new", new)):
        if program == version["code.py"]:
            assert {path: on_it.get(path) for path in version} == version
            return name
    return "theirs" if program.startswith(THEIRS) else "nothing"


KINDS = ("a new drive", "an older version", "somebody's program")


@pytest.mark.parametrize("kind", KINDS)
def test_wherever_the_power_goes_no_mix_of_versions_runs_and_a_second_deploy_mends_it(kind, versions, tmp_path):
    old, new = versions
    start = before_the_cut(kind, tmp_path / "start", old)
    whole = CutFiles(Path(shutil.copytree(start, tmp_path / "whole")))
    put(whole, new)
    wanted = contents(whole.root)
    seen = set()
    for last in range(1, whole.count + 1):
        root = Path(shutil.copytree(start, tmp_path / str(last)))
        with pytest.raises(PowerCut):
            put(CutFiles(root, last), new)
        seen.add(runs(root, old, new))
        assert_nothing_of_theirs_is_lost(start, root, kind)
        put(Files(root), new)
        assert contents(root) == wanted, f"after a cut at operation {last}"
        shutil.rmtree(root)
    first = {"a new drive": "nothing", "an older version": "old", "somebody's program": "theirs"}[kind]
    assert seen == {first, "nothing"}  # the last operation makes it the new one, and a cut comes before it


@pytest.mark.parametrize("kind", KINDS)
def test_an_undeploy_after_a_cut_gives_the_user_back_what_was_there(kind, versions, tmp_path):
    old, new = versions
    start = before_the_cut(kind, tmp_path / "start", old)
    whole = CutFiles(Path(shutil.copytree(start, tmp_path / "whole")))
    put(whole, new)
    for last in range(1, whole.count + 1):
        root = Path(shutil.copytree(start, tmp_path / str(last)))
        with pytest.raises(PowerCut):
            put(CutFiles(root, last), new)
        remove(Files(root))
        assert_nothing_of_theirs_is_lost(start, root, kind)
        assert runs(root, old, new) == ("theirs" if kind == "somebody's program" else "nothing"), last
        shutil.rmtree(root)


def test_an_undeploy_whose_power_goes_is_finished_by_the_next(versions, tmp_path):
    old, new = versions
    start = before_the_cut("somebody's program", tmp_path / "start", old)
    theirs = contents(start)
    put(Files(start), new)
    whole = CutFiles(Path(shutil.copytree(start, tmp_path / "whole")))
    remove(whole)
    for last in range(1, whole.count + 1):
        root = Path(shutil.copytree(start, tmp_path / str(last)))
        with pytest.raises(PowerCut):
            remove(CutFiles(root, last))
        assert runs(root, old, new) in ("new", "nothing", "theirs")
        remove(Files(root))
        assert contents(root) == theirs, f"after a cut at operation {last}"
        shutil.rmtree(root)


def assert_nothing_of_theirs_is_lost(start: Path, root: Path, kind: str) -> None:
    if kind == "somebody's program":
        held = set(contents(root).values())
        assert {text for text in contents(start).values() if text.startswith(THEIRS)} <= held
