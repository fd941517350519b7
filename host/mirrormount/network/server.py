"""`mirrormount serve`: the board's stream of bytes on TCP, for software that drives a New Focus controller on Ethernet.

One client controls at a time. When it goes, the motors stop, and the next one finds the board at rest
and silent. One thread does all but listening to the board, so nothing here needs a lock.
"""

import contextlib
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType

from mirrormount.common.errors import BadValue, ConnectionLost, MountError
from mirrormount.common.tokens import SHORT, is_short
from mirrormount.device.mount import Mount
from mirrormount.network.client_session import Guest
from mirrormount.network.listener import Door, parse_where
from mirrormount.network.port_reader import Ear
from mirrormount.network.relay import Relay
from mirrormount.transport.find import find_one
from mirrormount.transport.first_bytes import NotAClient
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port
from mirrormount.transport.refusals import NO_BOARD, TAKEN, refusal_line
from mirrormount.transport.stop_socket import SENT, STOPPED, Stoppable
from mirrormount.transport.tcp_port import acknowledge
from mirrormount.transport.telnet import GREETING

_WAITING_MOST = 1 << 20  # bytes of a client that may wait for the board
_RECEIVED_MOST = 1 << 18  # bytes of a client that are received at once; then the others have their turn
_QUIET_S, _QUIET_LONGEST_S = 0.1, 10.0  # the board has no more to say to the client before
_RETRY_S, _GIVE_UP_S = 1.0, 600.0  # looking for a board that has gone
_REST_S = 1.5  # how long the board may take to say that it is at rest, for another program that asked for a stop
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def serve(address: str | None, where: str, token: bytes | None, *, telnet: bool, finish: bool) -> None:
    """Serve the board at address (None: the one there is) at where, HOST:PORT, until a signal. Raises MountError.

    token: the first line of a client, if one is asked for. telnet: greet and filter. finish: see Server.
    """
    if is_short(token):
        _say(SHORT)
    host, port = parse_where(where)
    for number in _SIGNALS:
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores one
            signal.signal(number, _end)
    door = Door(host, port, token, telnet=telnet)
    try:
        server = Server(address, door, GREETING if telnet else b"", finish=finish)
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
    """One board and the client that controls it. finish: moves of known length go on when the client leaves."""

    def __init__(self, address: str | None, door: Door, greeting: bytes, *, finish: bool = False) -> None:
        self._address = find_one() if address is None else address
        self._door = door
        self._greeting = greeting
        self._finish = finish
        self._client: Guest | None = None
        self._ear: Ear | None = None
        self._mount: Mount | None = Mount(Link(open_port(self._address)))
        self.identity = self._mount.identity
        if self._mount.link.lockstep:
            self._mount.close()
            raise BadValue("a live client needs its own pace: speed=max is for use in one process")
        self._relay = Relay(self._mount.link.port.write)
        self._ear = Ear(self._mount.link.port)
        self._retry_at_s = self._give_up_at_s = 0.0
        self._asked: list[threading.Event] = []  # by other programs, for a stop: to be set when the board is at rest
        self._confirming: list[threading.Event] = []
        self._stoppable = Stoppable([self._address, door.address], self._stop_for_another_program)
        if self._stoppable.why_not:
            _say(f"`mirrormount stop` does not get through this program: {self._stoppable.why_not}")

    def look(self) -> None:
        """Wait for news and do what they ask for, once round. Raises ConnectionLost if the board stays away."""
        client, ear = self._client, self._ear
        watched = [s for s in (client and client.socket, ear and ear.end) if s]
        eager = [client.socket] if client and client.unread else []
        wait_s = min(self._relay.due_s(), 0.05 if self._door.busy() else 0.5)
        readable, _, _ = select.select([*watched, *self._door.watched()], eager, [], wait_s)
        if client and client.socket in readable:
            self._hear_client(client)
        self._tell_board(self._relay.pump)
        if ear and ear.end in readable and ear is self._ear:
            self._hear_board(ear)
        if self._client:
            self._client.flush()
        self._confirm_stops()
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
                self._mount.link.drain(_QUIET_S)
                self._mount.stop()
        finally:
            self._stoppable.close()
            if self._mount:
                self._mount.close()
            if self._client:
                self._client.socket.close()

    # ---- the client

    def _hear_client(self, client: Guest) -> None:
        """Take all that is there: the last of it may be a stop. Bounded, because of much of it nothing may be left."""
        sent, why, received = b"", "", 0
        while not why and received < _RECEIVED_MOST:
            try:
                data = client.socket.recv(1 << 16)
                received += len(data)
                sent += client.sent(data)
                why = "" if data else "has gone"
            except BlockingIOError:
                break
            except OSError:
                why = "has gone"
            except NotAClient as e:  # a web page may make a browser on this computer post commands here
                why = str(e)
        acknowledge(client.socket)
        self._take(sent)
        if why and client is self._client:
            self._dismiss(why)

    def _take(self, data: bytes) -> None:
        self._tell_board(lambda: self._relay.take(data))
        if self._relay.waiting > _WAITING_MOST:
            self._dismiss("sends more than the board can take")

    def _dismiss(self, why: str) -> None:
        """The client goes: stop what it has started, or finish it."""
        client, self._client = self._client, None
        what = "motors stopped"
        if not self._finish:
            self._tell_board(self._relay.stop)
        elif self._mount and self._tell_board(self._relay.leave):
            what = "its move is finished"
        if client:
            client.socket.close()
            _say(f"{client.name} {why}{f': {what}' if self._mount else ''}")

    def _let_in(self) -> None:
        if self._client or self._mount is None:
            self._door.turn_away(refusal_line(TAKEN if self._client else NO_BOARD))
            return
        guest = self._door.next()
        if guest:
            self._client = guest
            guest.unread += self._greeting
            guest.flush()  # first of all: a driver waits for it
            _say(f"{guest.name} controls the board")
            if self._finish and self._relay.moving:
                self._tell_board(self._relay.forget_answers)
            else:
                self._settle()
            if self._mount:
                self._take(guest.held)

    # ---- the board

    def _tell_board(self, tell: Callable[[], object]) -> object:
        """Do what writes to the board, if it is there. Returns what that does."""
        if self._mount:
            try:
                return tell()
            except ConnectionLost as e:
                self._lose_board(e)
        return None

    def _hear_board(self, ear: Ear) -> None:
        data = ear.end.recv(1 << 16)
        if not data:
            self._lose_board(ear.lost)
            return
        if ear.at_prompt(data):  # what a client sends there would be obeyed as Python
            self._lose_board("the board is at its Python prompt")
            return
        answers = self._relay.hear(data)
        if self._client and self._client.answer(answers):
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
            self._relay = Relay(mount.link.port.write)
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
        self._relay = Relay(_nowhere)
        self._retry_at_s = time.monotonic() + _RETRY_S
        self._give_up_at_s = time.monotonic() + _GIVE_UP_S

    def _look_for_board(self) -> None:
        """Open the same board again if it is back; it is stopped then, and nothing goes on by itself."""
        if time.monotonic() < self._retry_at_s:
            return
        try:
            link = Link(open_port(self._address))
            try:
                mount = Mount(link)
            except BaseException:
                link.close()
                raise
            if _who(mount.identity) == _who(self.identity):
                self._mount, self._ear = mount, Ear(mount.link.port)
                self._relay = Relay(mount.link.port.write)
                _say("the board is back")
                return
            mount.close()
            why = f"another board is there: {mount.identity}"
        except MountError as e:
            why = str(e)
        if time.monotonic() > self._give_up_at_s:
            raise ConnectionLost(f"the board did not come back within {_GIVE_UP_S / 60:g} minutes: {why}")
        self._retry_at_s = time.monotonic() + _RETRY_S

    def _stop_for_another_program(self) -> str:
        """Called in a thread of its own: the stop goes to the port whatever the others do."""
        mount = self._mount
        if mount is None:
            raise ConnectionLost("the board is not there")
        at_rest = threading.Event()
        mount.link.port.write(b"!\n")
        self._asked.append(at_rest)
        return STOPPED if at_rest.wait(_REST_S) else SENT

    def _confirm_stops(self) -> None:
        if self._asked:
            while self._asked:  # another thread may add to it
                self._confirming.append(self._asked.pop())
            self._tell_board(self._relay.stop)
            self._relay.look_again()
        elif self._confirming and not self._relay.moving:
            while self._confirming:
                self._confirming.pop().set()


def _nowhere(_data: bytes) -> None:
    """Where what is for a board goes that is not there."""


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
