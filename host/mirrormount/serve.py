"""`mirrormount serve`: the board's stream of bytes on TCP, for software that drives a New Focus controller on Ethernet.

One client controls at a time. When it goes, the motors stop, and the next one finds the board at rest
and silent. One thread does all but listening to the board, so nothing here needs a lock.
"""

import argparse
import contextlib
import os
import re
import select
import signal
import sys
import time
from types import FrameType

from mirrormount.client import Mount
from mirrormount.door import Door, parse_where
from mirrormount.ear import Ear
from mirrormount.errors import BadValue, ConnectionLost, MountError
from mirrormount.guest import Guest, acknowledge
from mirrormount.identify import NO_BOARD
from mirrormount.telnet import GREETING
from mirrormount.tokens import check_token
from mirrormount.turned_away import TAKEN_LINE

_NO_BOARD_LINE = NO_BOARD.encode() + b"\r\n"
_AT_ONCE = 512  # bytes handed to the board between two looks at the network
_WAITING_MOST = 1 << 20  # bytes of a client that may wait for the board
_QUIET_S, _QUIET_LONGEST_S = 0.1, 10.0  # the board has no more to say to the client before
_RETRY_S, _GIVE_UP_S = 1.0, 600.0  # looking for a board that has gone
_WEB = re.compile(rb"[A-Z]+ (/|https?:|\S+ HTTP/)")  # of a long request the end may be still to come
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def run(args: argparse.Namespace) -> None:
    """Serve until told to end. Raises MountError."""
    token = check_token(args.token if args.token is not None else os.environ.get("MIRRORMOUNT_TOKEN") or None)
    host, port = parse_where(args.tcp)
    for number in _SIGNALS:
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores one
            signal.signal(number, _end)
    door = Door(host, port, token, telnet=args.telnet)
    try:
        server = Server(args.at or args.port, door, GREETING if args.telnet else b"")
        try:
            print(server.identity)
            print(f"ready {door.address}{' (with a token)' if token else ''}", flush=True)
            while True:
                server.look()
        finally:
            server.close()
    finally:
        door.close()


class Server:
    """One board and the client that controls it."""

    def __init__(self, address: str | None, door: Door, greeting: bytes) -> None:
        self._address = address
        self._door = door
        self._greeting = greeting
        self._client: Guest | None = None
        self._to_board = bytearray()
        self._ear: Ear | None = None
        self._mount: Mount | None = Mount.open(address)
        self.identity = self._mount.identity
        if self._mount.link.lockstep:
            self._mount.close()
            raise BadValue("a live client needs its own pace: speed=max is for use in one process")
        self._ear = Ear(self._mount.link.port)
        self._retry_at_s = self._give_up_at_s = 0.0

    def look(self) -> None:
        """Wait for news and do what they ask for, once round. Raises ConnectionLost if the board stays away."""
        client, ear = self._client, self._ear
        watched = [s for s in (client and client.socket, ear and ear.end) if s]
        eager = [client.socket] if client and client.unread else []
        wait_s = 0 if self._to_board else 0.05 if self._door.busy() else 0.5
        readable, _, _ = select.select([*watched, *self._door.watched()], eager, [], wait_s)
        if client and client.socket in readable:
            self._hear_client(client)
        self._tell_board()
        if ear and ear.end in readable and ear is self._ear:
            self._hear_board(ear)
        if self._client:
            self._client.flush()
        if self._mount is None:
            self._look_for_board()
        self._door.look()
        self._let_in()

    def close(self) -> None:
        """Stop the motors and close. Raises MountError if they did not stop."""
        try:
            if self._mount:
                self._mount.link.port.write(b"!\n")
            if self._ear:
                self._ear.close()
            if self._mount:
                self._mount.stop()
        finally:
            if self._mount:
                self._mount.close()
            if self._client:
                self._client.socket.close()

    # ---- the client

    def _hear_client(self, client: Guest) -> None:
        try:
            data = client.socket.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        acknowledge(client.socket)
        if not data:
            self._dismiss("has gone")
        elif client.new and _WEB.match(data):  # a web page may make a browser on this computer post commands here
            self._dismiss("is a web browser")
        else:
            self._take(client.inlet.feed(data))
        client.new = False

    def _take(self, data: bytes) -> None:
        """Put bytes in line for the board. A stop overtakes, and what waited before it is void."""
        waited = len(self._to_board)
        self._to_board += data
        zeros = self._to_board.rfind(b"00000000", max(0, waited - 7))
        stop = max(self._to_board.rfind(b"!", waited), zeros)
        if stop > _AT_ONCE:
            self._to_board[:stop] = b"!\n"  # the board may be in the middle of a message: this ends it
        if len(self._to_board) > _WAITING_MOST:
            self._dismiss("sends more than the board can take")

    def _dismiss(self, why: str) -> None:
        """The client goes: stop what it has started."""
        client, self._client = self._client, None
        self._to_board[:] = b"!\n"
        self._tell_board()
        if client:
            client.socket.close()
            _say(f"{client.name} {why}{': motors stopped' if self._mount else ''}")

    def _let_in(self) -> None:
        if self._client or self._mount is None:
            self._door.turn_away(TAKEN_LINE if self._client else _NO_BOARD_LINE)
            return
        guest = self._door.next()
        if guest:
            self._client = guest
            guest.unread += self._greeting
            guest.flush()  # first of all: a driver waits for it
            _say(f"{guest.name} controls the board")
            self._settle()
            if self._mount:
                self._take(guest.held)

    # ---- the board

    def _tell_board(self) -> None:
        if self._to_board and self._mount:
            data = bytes(self._to_board[:_AT_ONCE])
            del self._to_board[:_AT_ONCE]
            try:
                self._mount.link.port.write(data)
            except ConnectionLost as e:
                self._lose_board(e)

    def _hear_board(self, ear: Ear) -> None:
        data = ear.end.recv(1 << 16)
        if not data:
            self._lose_board(ear.lost)
        elif ear.at_prompt(data):  # what a client sends there would be obeyed as Python
            self._lose_board("the board is at its Python prompt")
        elif self._client and self._client.answer(data):
            _say(f"{self._client.name} does not read: answers are dropped")

    def _settle(self) -> None:
        """Stop what moves, let the board finish its answers to the client before, see that it is well."""
        mount, ear = self._mount, self._ear
        if mount is None or ear is None:
            return
        ear.close()
        try:
            mount.link.port.write(b"!\n")
            mount.link.drain(_QUIET_S, _QUIET_LONGEST_S)
            self._mount = Mount(mount.link)
            self._mount.ask("XK0;XK?")  # the keep-alive of a client that fed it, for one that may not
            self._ear = Ear(mount.link.port)
        except MountError as e:
            self._lose_board(e)

    def _lose_board(self, why: object) -> None:
        _say(f"{why}: what moves is ended by the board's own keep-alive or run limit; waiting for the board")
        if self._ear:
            self._ear.close()
        if self._mount:
            self._mount.close()
        if self._client:
            self._client.socket.close()
        self._ear = self._mount = self._client = None
        self._to_board.clear()
        self._retry_at_s = time.monotonic() + _RETRY_S
        self._give_up_at_s = time.monotonic() + _GIVE_UP_S

    def _look_for_board(self) -> None:
        """Open the same board again if it is back; it is stopped then, and nothing goes on by itself."""
        if time.monotonic() < self._retry_at_s:
            return
        try:
            mount = Mount.open(self._address)
            if _who(mount.identity) == _who(self.identity):
                self._mount, self._ear = mount, Ear(mount.link.port)
                _say("the board is back")
                return
            mount.close()
            why = f"another board is there: {mount.identity}"
        except MountError as e:
            why = str(e)
        if time.monotonic() > self._give_up_at_s:
            raise ConnectionLost(f"the board did not come back within {_GIVE_UP_S / 60:g} minutes: {why}")
        self._retry_at_s = time.monotonic() + _RETRY_S


def _who(identity: str) -> str:
    """Which board it is, whatever the version of its firmware."""
    return identity.rpartition(",")[0]


def _say(line: str) -> None:
    with contextlib.suppress(OSError):  # a log that nobody takes must not end the service
        print(f"mirrormount: {line}", file=sys.stderr, flush=True)


def _end(number: int, _frame: FrameType | None) -> None:
    for every in _SIGNALS:  # one is enough: nothing may interrupt the stop that follows
        signal.signal(every, signal.SIG_IGN)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(0)
