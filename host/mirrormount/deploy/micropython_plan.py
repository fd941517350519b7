"""What a deploy puts on a board: the firmware's files, and from what is there the steps to what is wanted.

No board is needed here: plan() is a function of what the board holds.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mirrormount.common.errors import DeployError
from mirrormount.deploy import on_board
from mirrormount.deploy.fileset import THIS
from mountfw import __version__


@dataclass(frozen=True)
class Plan:
    """What a deploy has to do. journal: its lines, "old>new" to rename and "name" to remove."""

    upload: dict[str, bytes]  # path: content; goes to path.new
    verify: dict[str, str]  # path: SHA-256 that path.new must have, those from an upload that was cut included
    backup: str  # what the main.py that is there is copied to, or ""
    journal: list[str]
    changed: int  # files of the firmware that are new or differ
    after: dict[str, str]  # path: SHA-256 when it is done
    keep: list[str]  # what is replaced or removed: copied to KEPT/0, KEPT/1 ... until the new firmware has answered


def plan(
    wanted: dict[str, bytes],
    there: dict[str, str],
    manifest: dict[str, str],
    may_replace: Callable[[str], bool],
    aside: Mapping[str, list[str]] | None = None,
) -> Plan:
    """The plan that makes a board with the files `there` ({path: SHA-256}) hold `wanted`.

    manifest is what an earlier deploy has put there, aside what it has put aside ({path: [its copy, SHA-256]}).
    Files that are neither wanted nor in it, or that somebody has changed since, are not touched, but for a .py or .mpy
    that would hide a wanted file or be hidden by it. may_replace is asked about a main.py that is not ours, with the
    name for its copy. Raises DeployError.
    """
    hashes = {path: hashlib.sha256(content).hexdigest() for path, content in wanted.items()}
    copy = _copy_of_main(hashes["main.py"], there, manifest, may_replace)
    backup = "" if copy in there else copy
    aside = dict(aside or {}) | ({"main.py": [copy, there["main.py"]]} if copy else {})
    ours = dict(hashes)
    if THIS in manifest and THIS in there:  # an earlier choice stays
        ours.setdefault(THIS, manifest[THIS])
    noted = {"version": __version__, "files": dict(sorted(ours.items()))} | ({"aside": aside} if aside else {})
    listed = json.dumps(noted, indent=1).encode()
    new = wanted | {on_board.MANIFEST: listed}
    hashes[on_board.MANIFEST] = hashlib.sha256(listed).hexdigest()
    verify = {path: sha for path, sha in hashes.items() if there.get(path) != sha}
    upload = {path: new[path] for path in verify if there.get(path + ".new") != verify[path]}
    gone = {_counterpart(path) for path in wanted}
    gone |= {path for path, sha in manifest.items() if path not in ours and there.get(path) == sha}
    known = set(ours) | set(manifest) | gone
    gone |= {path + ".new" for path in known if path not in verify}
    # main.py first: from then on the board has one that finishes the rest, whatever it had before
    order = sorted(verify, key=lambda path: (path != "main.py", path == on_board.MANIFEST, path))
    journal = [f"{path}.new>{path}" for path in order[:1]] + sorted(gone & set(there))
    journal += [f"{path}.new>{path}" for path in order[1:]]
    after = {path: sha for path, sha in (there | hashes).items() if path not in gone}
    keep = [path for path in order if path in there]
    keep += sorted(path for path in gone & set(there) if not path.endswith(".new"))
    return Plan(upload, verify, backup, journal, len(verify.keys() & wanted.keys()), after, keep)


def _copy_of_main(
    wanted_main: str, there: dict[str, str], manifest: dict[str, str], may_replace: Callable[[str], bool]
) -> str:
    """The name for a copy of somebody else's main.py, which may be there already; "" if the main.py is ours."""
    present = there.get("main.py")
    if present in (None, wanted_main, manifest.get("main.py")):
        return ""
    number = 1
    while there.get(name := f"main.py.bak{number if number > 1 else ''}", present) != present:
        number += 1
    if not may_replace(name):
        raise DeployError(
            "the board has a main.py of somebody else: nothing was changed; to replace it (a copy stays"
            f" as {name}) say --replace-main"
        )
    return name


def _counterpart(path: str) -> str:
    stem, dot, suffix = path.rpartition(".")
    return stem + dot + ("py" if suffix == "mpy" else "mpy")
