"""Where the rp2040 machine's MicroPython image comes from, and that no other is taken for the official one."""

import hashlib
import os
import socket
import struct
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from served import run_cli

from mirrormount.common import errors
from mirrormount.virtual import emulator, image

CONTENT = b"UF2\n" + bytes(range(256)) * 8
NAME = "RPI_PICO-1.uf2"


class Site(ThreadingHTTPServer):
    """Stands for micropython.org."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.status, self.content = 200, CONTENT
        self.asked = 0

    def official(self) -> image.Official:
        url = f"http://127.0.0.1:{self.server_port}/{NAME}"
        return image.Official(url, hashlib.sha256(CONTENT).hexdigest(), len(CONTENT))


class Handler(BaseHTTPRequestHandler):
    server: Site

    def do_GET(self) -> None:
        self.server.asked += 1
        self.send_response(self.server.status)
        self.end_headers()
        self.wfile.write(self.server.content)

    def log_message(self, *_args) -> None:
        pass


@pytest.fixture
def site(monkeypatch) -> Iterator[Site]:
    with Site() as site:
        threading.Thread(target=site.serve_forever, args=(0.01,)).start()
        monkeypatch.setattr(image, "OFFICIAL", site.official())
        yield site
        site.shutdown()


@pytest.fixture(autouse=True)
def images(monkeypatch, tmp_path) -> Path:
    """The folder where images are kept: empty, on a machine where none can be built and nothing says CI."""
    for name in ("CI", "http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path))
    monkeypatch.setattr(image.shutil, "which", lambda _name: None)
    monkeypatch.setattr(image, "build", lambda _folder: pytest.fail("nothing to build it with"))
    return tmp_path / "images"


@pytest.fixture
def debian(monkeypatch, images) -> Path:
    """The image that comes of Debian's sources, where that is possible."""
    built = images / "RPI_PICO-debian.bin"
    monkeypatch.setattr(image, "can_build", lambda: True)
    monkeypatch.setattr(image, "build", lambda _folder: built)
    return built


def kept(images: Path) -> list[str]:
    return [path.name for path in images.iterdir()] if images.exists() else []


def test_an_image_that_is_named_goes_before_all(site, images, tmp_path):
    images.mkdir()
    (images / NAME).write_bytes(b"kept")
    named = tmp_path / "mine.bin"
    named.write_bytes(bytes(256) + struct.pack("<II", 0x20042000, 0x100001F7))
    assert emulator.find_image(named) == named
    assert site.asked == 0


def test_an_image_that_is_named_and_not_there_is_told(tmp_path):
    with pytest.raises(errors.EmulatorMissing, match="no such image"):
        emulator.find_image(tmp_path / "RPI_PICO.uf2")


@pytest.mark.parametrize(
    "content",
    [
        b"root:x:0:0:root:/root:/bin/bash\n" * 100,
        b"",
        bytes(512),
        b"UF2\n" + bytes(24) + struct.pack("<I", 0xE48BFF59) + bytes(256) + struct.pack("<II", 0x20042000, 0x100001F7),
    ],
    ids=["a text", "nothing", "zeros", "of an RP2350"],
)
def test_a_file_that_no_rp2040_starts_from_is_refused(tmp_path, content):
    named = tmp_path / "passwd"
    named.write_bytes(content)
    with pytest.raises(errors.EmulatorMissing, match="passwd: that is no image for an RP2040"):
        emulator.find_image(named)


def test_an_image_in_the_cache_is_taken(site, images):
    images.mkdir()
    image = images / "RPI_PICO-1.25.0.bin"
    image.write_bytes(b"")
    assert emulator.find_image(None) == image
    assert site.asked == 0


def test_the_official_image_is_fetched_once(site, debian, images):
    assert emulator.find_image(None).read_bytes() == CONTENT
    assert emulator.find_image(None) == images / NAME
    assert kept(images) == [NAME]
    assert site.asked == 1


@pytest.mark.parametrize(
    "content",
    [CONTENT[:-1] + b"?", CONTENT + b"?", CONTENT[:-1], b"", b"<html>log in first</html>"],
    ids=["one byte differs", "longer", "shorter", "nothing", "a page"],
)
def test_anything_else_is_refused_in_one_line_and_neither_used_nor_kept(site, debian, images, capsys, content):
    site.content = content
    assert emulator.find_image(None) == debian
    (line,) = capsys.readouterr().err.splitlines()
    assert NAME in line and hashlib.sha256(content[: len(CONTENT) + 1]).hexdigest()[:12] in line
    assert kept(images) == []


def test_what_is_refused_is_told_where_none_can_be_built(site, images):
    site.content = b"another"
    with pytest.raises(errors.EmulatorMissing, match="not the image that it should be") as e:
        emulator.find_image(None)
    assert len(str(e.value).splitlines()) == 1
    assert kept(images) == []


@pytest.mark.parametrize("status", [403, 404, 500])
def test_a_site_that_does_not_give_it_is_passed_over_in_silence(site, debian, images, capsys, status):
    site.status = status
    assert emulator.find_image(None) == debian
    assert capsys.readouterr().err == ""
    assert kept(images) == []


def test_a_net_that_does_not_let_us_out_is_passed_over_in_silence(monkeypatch, debian, capsys):
    with Site() as gone:
        monkeypatch.setattr(image, "OFFICIAL", gone.official())
    assert emulator.find_image(None) == debian
    assert capsys.readouterr().err == ""


def test_a_site_that_never_answers_is_not_waited_for(monkeypatch, debian, capsys):
    monkeypatch.setattr(image, "_PATIENCE_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}/{NAME}"
        monkeypatch.setattr(image, "OFFICIAL", image.Official(url, "", 1))
        assert emulator.find_image(None) == debian
    assert capsys.readouterr().err == ""


def test_a_name_server_that_never_answers_is_not_waited_for(monkeypatch, site, debian):
    answered = threading.Event()
    monkeypatch.setattr(image, "_PATIENCE_S", 0.05)
    monkeypatch.setattr(image.urllib.request, "urlopen", lambda *_args, **_kw: answered.wait())
    assert emulator.find_image(None) == debian
    answered.set()


def test_ci_asks_nobody(monkeypatch, site, debian):
    monkeypatch.setenv("CI", "true")
    assert emulator.find_image(None) == debian
    assert site.asked == 0


def test_without_image_net_and_toolchain_it_says_where_to_put_one(monkeypatch):
    with Site() as gone:
        monkeypatch.setattr(image, "OFFICIAL", gone.official())
    with pytest.raises(errors.EmulatorMissing, match=rf"{NAME} cannot be had .*--image FILE"):
        emulator.find_image(None)


def test_the_official_image_is_one_for_the_pico_and_its_sum_is_written_down():
    assert image.OFFICIAL.url.startswith("https://micropython.org/resources/firmware/RPI_PICO-")
    assert len(bytes.fromhex(image.OFFICIAL.sha256)) == 32 and image.OFFICIAL.size % 512 == 0


@pytest.mark.skipif(os.name != "posix", reason="the lock needs POSIX")
def test_two_processes_do_not_make_the_same_part_of_the_cache_at_once(tmp_path):
    import fcntl

    at_once = fcntl.LOCK_EX | fcntl.LOCK_NB
    with (tmp_path / "emulator.lock").open("a") as other:
        with image.held("emulator"), image.held("flash"), pytest.raises(BlockingIOError):
            fcntl.flock(other, at_once)
        fcntl.flock(other, at_once)  # free again


@pytest.mark.skipif(os.name != "posix", reason="the lock needs POSIX")
def test_two_processes_do_not_build_an_image_at_once_and_the_second_takes_the_firsts(monkeypatch, site, tmp_path):
    import fcntl

    monkeypatch.setenv("CI", "true")  # which builds
    monkeypatch.setattr(image, "can_build", lambda: True)

    def build(folder: Path) -> Path:
        with (tmp_path / "image.lock").open("a") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        folder.mkdir()
        (folder / NAME).write_bytes(CONTENT)
        return folder / NAME

    monkeypatch.setattr(image, "build", build)
    first = image.find_image(None)
    looks = iter([None, first])  # the second looks while the first builds, and again when that is over
    monkeypatch.setattr(image, "_kept", lambda _folder: next(looks))
    assert image.find_image(None) == first


def test_a_cache_that_cannot_be_written_to_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path / "file"))
    with pytest.raises(errors.EmulatorMissing, match="MIRRORMOUNT_CACHE"), image.held("emulator"):
        pass


@pytest.mark.parametrize(("name", "why"), [("/dev/zero", "there is no such image"), ("large", "at most 32 MB")])
def test_what_is_no_file_of_an_images_size_is_not_read(tmp_path, name, why):
    path = tmp_path / name  # a path that begins with / stays itself
    if name == "large":
        with path.open("wb") as file:
            file.truncate((32 << 20) + 1)
    run = run_cli("virtual", "--machine", "rp2040", "--image", str(path))
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr.startswith(f"mirrormount: {path}: ") and run.stderr.endswith(f"{why}\n")
