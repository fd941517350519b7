"""Boards for the tests of the host: served by `mirrormount virtual` in a process of their own."""

import gc
import io
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Self
from unittest.mock import patch

import pytest

from mirrormount.cli.main import main

# how long a wait may last before it is a failure; never a measurement. Shorter than a run of XM60000, which tests start
# to see it stopped: else its own limit ends it in time
PATIENCE_S = 50.0
HANG_S = 600.0  # the same for a command: a deploy to an emulated board takes a busy computer minutes


def wait_for(condition: Callable[[], object], what: str, told: Callable[[], object] = str) -> object:
    """Wait for an event of another process. Fails when it does not come at all, with what is told until then."""
    end = time.monotonic() + PATIENCE_S
    while not (result := condition()):
        if time.monotonic() > end:
            pytest.fail(f"waited in vain for {what} {told()}")
        time.sleep(0.005)
    return result


class ServedBoard:
    """A `mirrormount virtual` process with a pty and a TCP port, and the edges that it wrote. Use `with`.

    folder: for its files; made if it is not there.
    """

    def __init__(self, folder: Path, *options: str) -> None:
        if os.name != "posix":
            pytest.skip("a pty needs POSIX")
        folder.mkdir(exist_ok=True)
        self.link = folder / "mount"
        self.edges_file = folder / "edges.jsonl"
        where = ["--link", self.link, "--tcp", "0", "--edges", self.edges_file]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "mirrormount", "virtual", *where, *options],
            stdout=subprocess.PIPE,
            text=True,
        )
        ready = self.process.stdout.readline().split()
        assert ready[0] == "ready", ready
        self.tcp = next(word for word in ready if word.startswith("socket://"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self.process.stdout.close()

    def edges(self) -> list[dict]:
        """Every whole line that the board has written so far."""
        text = self.edges_file.read_text() if self.edges_file.exists() else ""
        return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]

    def enables(self) -> dict[str, int]:
        """The present duty of both enables."""
        return {"m1_en": 0, "m2_en": 0} | {e["pin"]: e["duty"] for e in self.edges() if e["pin"].endswith("_en")}

    def driving(self) -> bool:
        return any(self.enables().values())

    def off_after_us(self, pin: str) -> int:
        """How long the enable's last on-time was, in the board's own time."""
        edges = [e for e in self.edges() if e["pin"] == pin]
        assert edges[-1]["duty"] == 0
        return edges[-1]["t_us"] - edges[-2]["t_us"]

    def longest_drive_us(self) -> int:
        """The longest time for which an enable was on without a pause, 0 if none was."""
        since: dict[str, int] = {}
        longest = 0
        for edge in self.edges():
            if edge.get("duty"):
                since.setdefault(edge["pin"], edge["t_us"])
            elif edge["pin"] in since:
                longest = max(longest, edge["t_us"] - since.pop(edge["pin"]))
        return longest

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def end(self, with_signal: int = signal.SIGTERM) -> int:
        self.process.send_signal(with_signal)
        return self.process.wait(PATIENCE_S)


SCRIPT = Path(sys.executable).with_name("mirrormount")


def set_traps(folder: Path) -> Path:
    """Files with the names of modules that a Python needs; each one that is imported leaves a file `sprung`."""
    folder.mkdir()
    sprung = folder / "sprung"
    trap = f"open({str(sprung)!r}, 'a').write(__name__ + '\\n')\nraise SystemExit('a file of this folder was run')\n"
    for name in ("mpremote", "mountfw", "mirrormount", "json", "pip", "platformdirs", "machine", "sitecustomize"):
        (folder / f"{name}.py").write_text(trap)
    (folder / "serial").mkdir()
    (folder / "serial" / "__init__.py").write_text(trap)
    return folder


def run_cli(*args: str) -> subprocess.CompletedProcess:
    """`mirrormount …` with an empty standard input, in this process: a start of Python would take most of the time."""
    out, err, empty = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(3))
    with (
        patch.dict(os.environ),
        patch.object(sys, "stdin", empty),
        redirect_stdout(out),
        redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore", ResourceWarning)  # what an error leaves open ends with the process
        os.environ.pop("MIRRORMOUNT_PORT", None)
        try:
            status = main([*args])
        except SystemExit as e:
            status = e.code
        if status:
            gc.collect()
    return subprocess.CompletedProcess(args, status, *(stream.buffer.getvalue().decode() for stream in (out, err)))


def run_process(*args: str) -> subprocess.CompletedProcess:
    """`mirrormount …` as a shell would run it, where that it is another process is the fact."""
    environment = {k: v for k, v in os.environ.items() if k != "MIRRORMOUNT_PORT"}
    return subprocess.run(
        [sys.executable, "-m", "mirrormount", *args],
        capture_output=True,
        text=True,
        timeout=HANG_S,
        env=environment,
        stdin=subprocess.DEVNULL,
    )
