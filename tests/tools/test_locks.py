"""Facts about the locks: what is installed for the tests and the demo, in which versions; and the entry of CI."""

import os
import re
import subprocess
import tomllib

import pytest
from packaging.requirements import Requirement
from scripts import ROOT, bootstrap, checks, demo, mechanics, release

LOCKS = ["tests/requirements.txt", "tools/demo-requirements.txt"]
MECHANICS = "tools/mechanics/requirements.txt"  # has not what mirrormount needs


def locked(lock):
    """The names in a lock file and their versions (several, where Pythons differ)."""
    text = (ROOT / lock).read_text(encoding="utf-8")
    return re.findall(r"^([a-z0-9-]+)==(\S+)", text, re.MULTILINE)


def wanted_by_the_project():
    """What mirrormount needs, its plots, and what builds it."""
    text = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project, build = text["project"], text["build-system"]
    return [*project["dependencies"], *project["optional-dependencies"]["plot"], *build["requires"]]


@pytest.mark.parametrize("lock", LOCKS)
def test_every_dependency_of_the_project_is_locked_within_its_range(lock):
    for line in wanted_by_the_project():
        wanted = Requirement(line)
        versions = [version for name, version in locked(lock) if name == wanted.name]
        assert versions, line
        assert all(version in wanted.specifier for version in versions), line


def test_both_scripts_put_the_same_versions_into_the_one_environment():
    assert set(locked(LOCKS[1])) <= set(locked(LOCKS[0]))


def test_the_parts_are_made_with_the_same_versions_in_the_one_environment():
    assert checks.MECHANICS_LOCK == mechanics.LOCK == MECHANICS
    tests, parts = (dict.fromkeys(name for name, _ in locked(lock)) for lock in (LOCKS[0], MECHANICS))
    both = tests.keys() & parts.keys()
    assert "numpy" in both and "build123d" in parts.keys() - tests.keys()
    for name in both:
        of_tests, of_parts = ({v for n, v in locked(lock) if n == name} for lock in (LOCKS[0], MECHANICS))
        assert of_parts <= of_tests, name


@pytest.mark.parametrize("lock", [*LOCKS, MECHANICS, release.LOCK])
def test_nothing_is_installed_whose_hash_is_not_locked(lock):
    assert [checks.LOCK, demo.LOCK] == LOCKS
    assert bootstrap.LOCKED == ("--no-deps", "--require-hashes", "-r")
    assert bootstrap.OURSELVES == ("--no-deps", "--no-build-isolation", "-e", ".")
    text = (ROOT / lock).read_text(encoding="utf-8")
    requirements = re.split(r"^(?=[a-z])", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in requirement for requirement in requirements)
    assert "editables" in dict(locked(lock))  # hatchling asks for it when it builds for -e


@pytest.mark.parametrize("lock", [*LOCKS, MECHANICS, release.LOCK])
def test_lock_names_no_host_and_no_folder(lock):
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if re.search(r"://|index-url|find-links|^-|(^| )/", line)] == []


@pytest.mark.skipif(os.name == "nt", reason="bash is not on every Windows")
def test_ci_entry_is_valid_bash_and_executable():
    subprocess.run(["bash", "-n", str(ROOT / ".ci" / "run")], check=True)
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
