"""A `mirrormount serve` process for the tests, and what its clients hear."""

import os
import select
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from served import PATIENCE_S, ServedBoard, wait_for

from mirrormount.transport.link import GREETING

RUN = b"1XM60000;1MV+\n"


class Served:
    """A `mirrormount serve` process, and its clients."""

    def __init__(self, folder: Path, port: str, *options: str, **environment: str) -> None:
        words = ["serve", port, "--tcp", "0", *options]
        self.log = folder / "serve.log"
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "mirrormount", *words],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=os.environ | environment,
            )
        self.identity = self.process.stdout.readline().strip()
        self.ready = self.process.stdout.readline().strip()
        if not self.ready.startswith("ready "):
            self.process.communicate()
            pytest.fail(f"it does not serve: {self.log.read_text()}")
        self.tcp = self.ready.split()[1]
        self.clients: list[socket.socket] = []

    def connect(self, first: bytes = b"", receive_buffer: int | None = None) -> socket.socket:
        client = socket.socket()
        self.clients.append(client)
        client.settimeout(PATIENCE_S)
        if receive_buffer:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        client.connect(("127.0.0.1", int(self.tcp.rsplit(":", 1)[1])))
        client.sendall(first)
        return client

    def drive(self, first: bytes = b"") -> socket.socket:
        """A client that drives, and has read the greeting."""
        client = self.connect(first)
        assert hear(client, len(GREETING)) == GREETING
        return client

    def says(self, text: str) -> None:
        """Wait until its log has this text."""
        wait_for(lambda: text in self.log.read_text(), text)

    def end(self, number: int) -> int:
        """End it; its exit status."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)

    def clear_up(self) -> None:
        for client in self.clients:
            client.close()
        self.process.kill()
        self.process.communicate()


class Cable:
    """Joins a board's pty and whoever connects to it, so that a test can press keys on the board's console."""

    def __init__(self, board: ServedBoard) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self.console = open(board.link, "r+b", buffering=0)  # noqa: SIM115 (closed on the way out)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._carry)

    def __enter__(self) -> "Cable":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self.console.close()
        self._server.close()

    def _carry(self) -> None:
        host, _ = self._server.accept()
        with host:
            while not self._ended.is_set():
                ready = select.select([host, self.console], [], [], 0.01)[0]
                if host in ready:
                    if not (data := host.recv(4096)):
                        return
                    self.console.write(data)
                if self.console in ready:
                    host.sendall(self.console.read(4096))


def hear(client: socket.socket, n: int) -> bytes:
    """Exactly n bytes, or what came before the end."""
    heard = b""
    while len(heard) < n and (data := client.recv(n - len(heard))):
        heard += data
    return heard


def hear_line(client: socket.socket) -> bytes:
    heard = b""
    while not heard.endswith(b"\n") and (data := client.recv(1)):
        heard += data
    return heard


def ask(client: socket.socket, query: bytes) -> bytes:
    client.sendall(query + b"\n")
    return hear_line(client).strip()


def runs(board: ServedBoard) -> None:
    wait_for(board.driving, "the motor to run")


def rests(board: ServedBoard) -> None:
    wait_for(lambda: not board.driving(), "the motors to stop")
