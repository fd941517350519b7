"""`mirrormount ioc` in a process of its own, and clients of it in processes of theirs."""

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import textwrap
import threading
from typing import Self

import pytest
from served import HANG_S, PATIENCE_S

PREFIX = "T:"
BEGIN = """
import os, sys, time
P = sys.argv[1]
def wait_for(condition, what):
    end = time.monotonic() + 50
    while not condition():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.01)
def event(name):
    print(name, flush=True)
    sys.stdin.readline()
"""


def free_port() -> int:
    """A port that is free for TCP and UDP, and that no client gets by chance: those begin at 32768."""
    while True:
        where = ("127.0.0.1", random.randrange(10_000, 32_000))
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp, contextlib.suppress(OSError):
            tcp.bind(where)
            udp.bind(where)
            return where[1]


class Ioc:
    """A `mirrormount ioc` process. Use `with`. environment: by which clients find it. program: what runs it."""

    def __init__(
        self, *words: str, environment: dict[str, str] | None = None, program: tuple[str, ...] = ("-m", "mirrormount")
    ) -> None:
        ports = ("EPICS_CA_SERVER_PORT", "EPICS_CA_REPEATER_PORT", "EPICS_PVA_SERVER_PORT", "EPICS_PVA_BROADCAST_PORT")
        hosts = {f"EPICS_{protocol}_ADDR_LIST": "127.0.0.1" for protocol in ("CA", "PVA")}
        automatic = {f"EPICS_{protocol}_AUTO_ADDR_LIST": "NO" for protocol in ("CA", "PVA")}
        self.environment = environment or {**hosts, **automatic, **{name: str(free_port()) for name in ports}}
        command = [sys.executable, *program, "ioc", *words, "--prefix", PREFIX]
        self.process = subprocess.Popen(
            command, env=os.environ | self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.ready = self.process.stdout.readline()
        assert self.ready.startswith("ready "), self.ready + (self.process.stderr.read() if not self.ready else "")
        self.errors: list[str] = []
        self._reader = threading.Thread(target=self._read_errors, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join()
        self.process.stdout.close()
        self.process.stderr.close()

    def _read_errors(self) -> None:
        for line in self.process.stderr:
            self.errors.append(line)

    def port(self, protocol: str) -> int:
        """Where it serves "CA" or "PVA"."""
        return int(self.environment[f"EPICS_{protocol}_SERVER_PORT"])

    def client(self, code: str) -> "Client":
        """A Python process with this code, for which P is the prefix."""
        return Client(code, self.environment)

    def run(self, code: str) -> list[str]:
        """The lines that such a process prints. It must succeed."""
        return self.client(code).end()

    def end(self) -> int:
        """End it as a service is ended. Returns the exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)


class Client:
    """A process with a client's code. It waits in event(name) until the test goes on with it."""

    def __init__(self, code: str, environment: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", BEGIN + textwrap.dedent(code), PREFIX],
            env=os.environ | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def until(self, event: str) -> None:
        """Wait until it is there."""
        lines = []
        for line in self.process.stdout:
            lines.append(line)
            if line.strip() == event:
                return
        pytest.fail(f"waited in vain for {event}: {''.join(lines)}")

    def go_on(self) -> None:
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def end(self) -> list[str]:
        """Wait for its end. Returns the lines that it has printed since."""
        out, _ = self.process.communicate(timeout=HANG_S)
        assert self.process.returncode == 0, out
        return out.splitlines()
