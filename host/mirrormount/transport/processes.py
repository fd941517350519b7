"""The process that has a port open, and its command line, where the system shows them (Linux). Imports printable."""

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

from mirrormount.common.printable import printable


@dataclass(frozen=True)
class Owner:
    """A program that has a port open. pid is 0 if the system does not show it. path: its stop socket."""

    pid: int
    command: str
    path: Path | None = None

    def __str__(self) -> str:
        return f"process {self.pid} ({self.command})" if self.pid else "another program"


def who_has(port: str) -> Owner | None:
    """The other process that has a device open, if this system shows it (Linux, and a process of this user)."""
    target = os.path.realpath(port)
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            for fd in (folder / "fd").iterdir():
                if int(folder.name) != os.getpid() and os.readlink(fd) == target:
                    return Owner(int(folder.name), command_of(int(folder.name)))
    return None


def command_of(pid: int) -> str:
    """The beginning of a process's command line; safe to print."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return "command not known"
    names = [os.path.basename(w.decode("utf-8", "replace")) for w in words[:1]]
    names += [w.decode("utf-8", "replace") for w in words[1:4] if w]
    return printable(" ".join(names).strip(), 60) or "command not known"
