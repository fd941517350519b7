"""Build the files of a release and check them; nothing is published: python tools/release.py [FOLDER]

Makes sdist and wheel twice from the last commit, compares their bytes, checks what an index would show, lists what a
wheel is installed with as a CycloneDX SBOM, and prints the hashes. FOLDER (dist) must be empty or absent.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Dict, List

import _bootstrap as bootstrap

LOCK = "tools/release-requirements.txt"
INSTALLED = "tools/demo-requirements.txt"  # what the SBOM lists: mirrormount's own needs and those of its demo
SBOM = "mirrormount.cdx.json"


def committed_copy(folder: Path) -> str:
    """Put the files of the last commit into a folder; the time of that commit, in s since 1970."""
    try:
        time = subprocess.run(["git", "log", "-1", "--format=%ct"], cwd=bootstrap.ROOT, capture_output=True, check=True)
        archive = subprocess.run(["git", "archive", "HEAD"], cwd=bootstrap.ROOT, capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        raise bootstrap.Stop(
            "A release is made from a commit: this needs git, and a clone of the repository."
        ) from None
    (folder / "tree.tar").write_bytes(archive.stdout)
    shutil.unpack_archive(folder / "tree.tar", folder / "tree")
    return time.stdout.decode().strip()


def build(tree: Path, folder: Path, time: str) -> None:
    """The sdist of a tree, and the wheel of that sdist, so that neither has what the other could not make."""
    for target, source in (("sdist", tree), ("wheel", folder / "unpacked")):
        if target == "wheel":
            shutil.unpack_archive(next(folder.glob("*.tar.gz")), source)
            source = next(source.iterdir())
        words = ["-m", "hatchling", "build", "-t", target, "-d", str(folder)]
        if bootstrap.call([str(bootstrap.PYTHON), *words], cwd=source, environment={"SOURCE_DATE_EPOCH": time}):
            raise bootstrap.Stop(f"The {target} was not built: hatchling says why above.")
    shutil.rmtree(folder / "unpacked")


def hashes(folder: Path) -> Dict[str, str]:
    """{name: SHA-256} of the files in a folder."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def check(words: List[str], failure: str) -> None:
    """Run a module of .venv, or stop with what its failure means."""
    if bootstrap.call([str(bootstrap.PYTHON), "-m", *words]):
        raise bootstrap.Stop(failure)


def main(arguments: List[str]) -> int:
    """Build, compare, check, and list into a folder, which is filled only when all of it is right."""
    if len(arguments) > 1 or any(word.startswith("-") for word in arguments):
        bootstrap.say(str(__doc__))
        return 0 if arguments in (["-h"], ["--help"]) else 2
    out = Path(arguments[0] if arguments else bootstrap.ROOT / "dist").absolute()
    if out.exists() and any(out.iterdir()):
        raise bootstrap.Stop(f"{out} is not empty: move or delete its files, for nothing here is overwritten.")
    bootstrap.prepare("release", LOCK)
    with tempfile.TemporaryDirectory() as scratch:
        first, second = Path(scratch, "first"), Path(scratch, "second")
        for folder in (first, second):
            copy = Path(scratch, f"of-{folder.name}")
            copy.mkdir()
            build(copy / "tree", folder, committed_copy(copy))
        if hashes(first) != hashes(second):
            raise bootstrap.Stop("Two builds of one commit differ: the release is not reproducible.")
        check(["twine", "check", "--strict", *map(str, first.iterdir())], "An index would refuse this: see above.")
        sbom = ["--output-reproducible", "--pyproject", "pyproject.toml", "-o", str(first / SBOM), INSTALLED]
        check(["cyclonedx_py", "requirements", *sbom], "The SBOM was not made: see above.")
        shutil.copytree(first, out, dirs_exist_ok=True)
    for name, value in hashes(out).items():
        bootstrap.say(f"{value}  {name}")
    return 0


if __name__ == "__main__":
    sys.exit(bootstrap.guarded(main))
