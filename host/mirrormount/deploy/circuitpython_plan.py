"""What a deploy puts on a CircuitPython drive, and from what is there the steps to it. Touches no drive.

CircuitPython has nothing like the journal of a MicroPython deploy: at start-up it runs code.py, whatever else the
drive holds. So the plan has code.py stand still first, with STUB in its place, and brings it back last: a deploy that
is cut anywhere leaves the old firmware, or the new one, or a board that does nothing, never a mix of versions.
"""

import hashlib
import importlib.resources
import importlib.util
import json
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from mirrormount.common.errors import DeployError, LibraryMissing
from mirrormount.common.extras import install
from mirrormount.common.printable import printable
from mirrormount.deploy import fileset
from mirrormount.deploy.fileset import THIS
from mirrormount.deploy.on_board import MANIFEST
from mirrormount.transport.circuitpy_files import is_path
from mountfw import __version__

CODE, BOOT = "code.py", "boot.py"
PROGRAMS = fileset.PROGRAMS["circuitpython"]
STUB = b'print("mirrormount: a deploy of the firmware was not finished. Nothing runs: deploy again.")\n'
_BEFORE_OURS = "code.txt"  # CircuitPython takes it rather than code.py
_FRESH = b'print("Hello World!")\n'  # the code.py that CircuitPython writes on a new drive: nobody's
_LIBRARY = "lib/adafruit_motor"
_SHA256 = re.compile("[0-9a-f]{64}")


def sha256(content: bytes) -> str:
    """SHA-256 as hex."""
    return hashlib.sha256(content).hexdigest()


def motor_library() -> dict[str, bytes]:
    """{path on the drive: content} of the part of adafruit_motor that drives DC motors. Raises LibraryMissing.

    The installed package is only looked at, not imported: that would need a board.
    """
    try:
        spec = importlib.util.find_spec("adafruit_motor")
        places = spec.submodule_search_locations if spec else None
        folder = Path((places or ["there is none"])[0])
        return {f"{_LIBRARY}/{name}": (folder / name).read_bytes() for name in ("__init__.py", "motor.py")}
    except (OSError, ValueError) as e:
        raise LibraryMissing(
            "Adafruit's motor library, which goes onto CircuitPython boards, is not installed here:"
            f" {install('circuitpython')}"
        ) from e


@dataclass(frozen=True)
class Manifest:
    """What an earlier deploy has noted on the drive."""

    files: dict[str, str] = field(default_factory=dict)  # path: SHA-256 of what it has put there
    aside: dict[str, list[str]] = field(default_factory=dict)  # somebody else's file: [its copy, SHA-256]
    # it was cut: {path: SHA-256} of what was there of an earlier one; other files of it may be half written
    unfinished: dict[str, str] | None = None
    damage: str = ""  # why what is on the drive was not taken: it is then as if there were none

    def text(self) -> bytes:
        """As it is on the drive; `version` and `files` are as on MicroPython."""
        told = {"version": __version__, "files": dict(sorted(self.files.items()))}
        if self.aside:
            told["aside"] = dict(sorted(self.aside.items()))
        if self.unfinished is not None:
            told["unfinished"] = self.unfinished
        return json.dumps(told, indent=1).encode()


def read_manifest(text: bytes) -> Manifest:
    """From what is on the drive, which is checked like any input; an empty one, with the reason, if it is not ours."""
    if not text:
        return Manifest()
    try:
        told = json.loads(text)
        unfinished = None if told.get("unfinished") is None else _hashes(told["unfinished"])
        return Manifest(_hashes(told["files"]), _asides(told.get("aside", {})), unfinished)
    except RecursionError:
        return Manifest(damage="it is nested too deeply")
    except (ValueError, KeyError, TypeError, AttributeError) as e:
        return Manifest(damage=printable(str(e) if type(e) is ValueError else f"{type(e).__name__}: {e}", 100))


def _hashes(told: dict) -> dict[str, str]:
    """{path: SHA-256}, each a path that a deploy writes to. Raises ValueError."""
    for path, sha in told.items():
        if not _is_ours(path) or not (isinstance(sha, str) and _SHA256.fullmatch(sha)):
            raise ValueError(f"{path!r} is not a file that deploy puts on a drive")
    return dict(told)


def _asides(told: dict) -> dict[str, list[str]]:
    """{path: [its copy, SHA-256]}, each copy beside its file. Raises ValueError."""
    for path, (copy, sha) in told.items():
        beside = isinstance(copy, str) and re.fullmatch(re.escape(path) + r"\.bak\d{0,4}", copy)
        if not (_is_ours(path) or path == _BEFORE_OURS) or not beside or not _SHA256.fullmatch(sha):
            raise ValueError(f"{copy!r} is not the copy that deploy makes of a file")
    return {path: [copy, sha] for path, (copy, sha) in told.items()}


def _is_ours(path: str) -> bool:
    return is_path(path) and (path in PROGRAMS or path.startswith(("mountfw/", f"{_LIBRARY}/")))


@dataclass(frozen=True)
class DrivePlan:
    """What a deploy has to do on a drive. First during and then manifest is what MANIFEST says."""

    aside: dict[str, str]  # somebody else's file: what it is copied to
    remove: list[str]
    write: dict[str, bytes]  # without code.py and the manifest
    during: bytes
    manifest: bytes
    code: bytes
    changed: int  # files of the firmware that are new or differ
    after: dict[str, str]  # path: SHA-256 when it is done

    @property
    def nothing(self) -> bool:
        """True if the drive is already as it should be."""
        return not self.during


def drive_plan(
    wanted: dict[str, bytes], there: dict[str, str], old: Manifest, may_replace: Callable[[dict[str, str]], bool]
) -> DrivePlan:
    """The plan that makes a drive with the files `there` ({path: SHA-256}) hold `wanted`.

    What is neither wanted nor of an earlier deploy stays as it is. may_replace is asked about files of
    somebody else that have to go, {path: name of the copy}. Raises DeployError if it says no.
    """
    hashes = {path: sha256(content) for path, content in wanted.items()}
    aside = _aside(hashes, there, old)
    if aside and not may_replace(aside):
        raise DeployError(
            f"the drive has files of somebody else ({', '.join(sorted(aside))}): nothing was changed; to replace them"
            f" (copies stay as {', '.join(sorted(aside.values()))}) say --replace-main"
        )
    ours = dict(hashes)
    if THIS in old.files and THIS in there:  # an earlier choice stays
        ours.setdefault(THIS, old.files[THIS])
    kept = old.aside | {path: [copy, there[path]] for path, copy in aside.items()}
    manifest = Manifest(ours, kept).text()
    gone = {path for path in old.files if path not in ours and belongs(path, there, old)}
    gone |= {path.removesuffix(".py") + ".mpy" for path in wanted if path.startswith("mountfw/")}
    gone |= leftovers(there)
    gone |= aside.keys() - wanted.keys()
    changed = {path for path in wanted if there.get(path) != hashes[path]}
    # the library first, boot.py last: what a board does at start-up changes as late as it can
    order = sorted(changed - {CODE}, key=lambda path: (path == BOOT, path))
    remove = sorted(gone & set(there))
    as_it_is = not (aside or remove or changed) and there.get(MANIFEST) == sha256(manifest)
    present = {path: there[path] for path in PROGRAMS if belongs(path, there, old)}
    during = b"" if as_it_is else Manifest(old.files | ours, kept, present).text()
    after = {path: sha for path, sha in (there | hashes | {MANIFEST: sha256(manifest)}).items() if path not in gone}
    after |= {copy: there[path] for path, copy in aside.items()}
    write = {path: wanted[path] for path in order}
    return DrivePlan(aside, remove, write, during, manifest, wanted[CODE], len(changed), after)


def leftovers(there: Iterable[str]) -> set[str]:
    """What a deploy that was cut has left of the files that it renames into place."""
    return {path for path in there if path.endswith(".new") and path.startswith((*PROGRAMS, _BEFORE_OURS, MANIFEST))}


def belongs(path: str, there: dict[str, str], old: Manifest) -> bool:
    """True if what is at path is what a deploy has put there, and nobody has changed it since."""
    present = there.get(path)
    if present is None or path not in old.files:
        return False
    if present == old.files[path] or (path == CODE and present == sha256(STUB)):
        return True
    if old.unfinished is None:
        return False
    # those two are renamed into place, so never half written
    return path not in PROGRAMS or present == old.unfinished.get(path)


def _aside(hashes: dict[str, str], there: dict[str, str], old: Manifest) -> dict[str, str]:
    """The files of somebody else that have to go, each with a name for its copy that loses no older copy."""
    found = {}
    for path in (*hashes, _BEFORE_OURS):
        present = there.get(path)
        nobodys = present in (None, hashes.get(path), sha256(STUB)) or (path == CODE and present == sha256(_FRESH))
        if path.startswith("mountfw/") or nobodys or belongs(path, there, old):
            continue
        copy, sha = old.aside.get(path, ["", ""])
        if old.unfinished is not None and sha == present == there.get(copy) and path in hashes:  # copied before the cut
            continue
        number = 1
        while there.get(name := f"{path}.bak{number if number > 1 else ''}", present) != present:
            number += 1
        found[path] = name
    return found
