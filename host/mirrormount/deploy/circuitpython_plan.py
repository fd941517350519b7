"""The files of a deploy on a CircuitPython drive, and the steps from what is there to these. Touches no drive.

A CircuitPython drive has no journal as in a MicroPython deploy: at start-up the board runs code.py, whatever else the
drive holds. So the plan replaces code.py by STUB first, and writes the new code.py last. A deploy that is cut anywhere
leaves the old firmware, or the new one, or a board that does nothing, but never a mix of versions.
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
_BEFORE_OURS = "code.txt"  # CircuitPython runs it instead of code.py
_FRESH = b'print("Hello World!")\n'  # the code.py that CircuitPython writes on a new drive: no user's work
_LIBRARY = "lib/adafruit_motor"
_SHA256 = re.compile("[0-9a-f]{64}")


def sha256(content: bytes) -> str:
    """SHA-256 as hex."""
    return hashlib.sha256(content).hexdigest()


def motor_library() -> dict[str, bytes]:
    """{path on the drive: content} of the part of adafruit_motor that drives DC motors. Raises LibraryMissing.

    The package is found, but not imported: its import needs a board.
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
    """The list that an earlier deploy has left on the drive."""

    files: dict[str, str] = field(default_factory=dict)  # {path: SHA-256} of the files that it wrote
    aside: dict[str, list[str]] = field(default_factory=dict)  # {the user's file: [its copy, SHA-256]}
    # of a deploy that was cut: {path: SHA-256} of the programs before it; its other files may be half written
    unfinished: dict[str, str] | None = None
    damage: str = ""  # why the manifest on the drive is ignored

    def text(self) -> bytes:
        """The manifest as JSON; `version` and `files` are as on MicroPython."""
        told = {"version": __version__, "files": dict(sorted(self.files.items()))}
        if self.aside:
            told["aside"] = dict(sorted(self.aside.items()))
        if self.unfinished is not None:
            told["unfinished"] = self.unfinished
        return json.dumps(told, indent=1).encode()


def read_manifest(text: bytes) -> Manifest:
    """The manifest in this text, which is checked as untrusted input. Empty, with `damage`, if no deploy wrote it."""
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
    """The steps of a deploy on a drive. MANIFEST has the content `during` while it runs, then `manifest`."""

    aside: dict[str, str]  # {the user's file: its copy}
    remove: list[str]
    write: dict[str, bytes]  # without code.py and the manifest
    during: bytes
    manifest: bytes
    code: bytes
    changed: int  # files of the firmware that are new or differ
    after: dict[str, str]  # {path: SHA-256} at the end

    @property
    def nothing(self) -> bool:
        """True if the drive needs no change."""
        return not self.during


def drive_plan(
    wanted: dict[str, bytes], there: dict[str, str], old: Manifest, may_replace: Callable[[dict[str, str]], bool]
) -> DrivePlan:
    """The plan that makes a drive with the files `there` ({path: SHA-256}) hold `wanted`.

    A file that is neither wanted nor of an earlier deploy stays. may_replace gets the user's files that are in the way,
    {path: name of the copy}. Raises DeployError if it returns False.
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
    # the library first, boot.py last: it runs at start-up, so it changes as late as possible
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
    """Files that a deploy wrote to rename them into place, and was cut before."""
    return {path for path in there if path.endswith(".new") and path.startswith((*PROGRAMS, _BEFORE_OURS, MANIFEST))}


def belongs(path: str, there: dict[str, str], old: Manifest) -> bool:
    """True if a deploy wrote the file at path, and it is unchanged since."""
    present = there.get(path)
    if present is None or path not in old.files:
        return False
    if present == old.files[path] or (path == CODE and present == sha256(STUB)):
        return True
    if old.unfinished is None:
        return False
    # programs are renamed into place, so they are never half written
    return path not in PROGRAMS or present == old.unfinished.get(path)


def _aside(hashes: dict[str, str], there: dict[str, str], old: Manifest) -> dict[str, str]:
    """{path: name of its copy} of the user's files that are in the way. No older copy is overwritten."""
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
