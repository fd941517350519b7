"""A board on TCP, for software that drives a New Focus controller on Ethernet.

One client at a time has control. When it disconnects, the motors stop, and the next one starts with the board at
rest and silent. One thread does all but reading the port, so nothing here needs a lock.
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
from mirrormount.device.session import Session
from mirrormount.network.client_session import ClientSession
from mirrormount.network.listener import Listener, parse_where
from mirrormount.network.port_reader import PortReader
from mirrormount.network.relay import Relay
from mirrormount.transport.find import find_one
from mirrormount.transport.first_bytes import NotAClient
from mirrormount.transport.refusals import NO_BOARD, TAKEN, refusal_line
from mirrormount.transport.stop_socket import SENT, STOPPED
from mirrormount.transport.stoppable import Stoppable
from mirrormount.transport.tcp_port import acknowledge
from mirrormount.transport.telnet import GREETING

_WAITING_MOST = 1 << 20  # bytes of a client that wait for the board
_RECEIVED_MOST = 1 << 18  # bytes of a client that are received at once, before other events are served
_QUIET_S, _QUIET_LONGEST_S = 0.1, 10.0  # then the replies to the client before are over
_RETRY_S, _GIVE_UP_S = 1.0, 600.0  # for opening the port of a lost board
_REST_S = 1.5  # until the board must be known to be at rest, when another program asked for a stop
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
    listener = Listener(host, port, token, telnet=telnet)
    try:
        server = Server(address, listener, GREETING if telnet else b"", finish=finish)
        try:
            print(server.identity)
            print(f"ready {listener.address}{' (with a token)' if token else ''}", flush=True)
            while True:
                server.run_once()
        finally:
            server.close()
    finally:
        listener.close()


class Server:
    """One board and the client that controls it. finish: moves of known length go on when the client leaves."""

    def __init__(self, address: str | None, listener: Listener, greeting: bytes, *, finish: bool = False) -> None:
        self._address = find_one() if address is None else address
        self._listener = listener
        self._greeting = greeting
        self._finish = finish
        self._client: ClientSession | None = None
        self._reader: PortReader | None = None
        self._session: Session | None = Session.open(self._address)
        self.identity = self._session.board.identity
        if self._session.link.lockstep:
            self._session.close()
            raise BadValue("a live client needs its own pace: speed=max is for use in one process")
        self._relay = Relay(self._session.link.port.write)
        self._reader = PortReader(self._session.link.port)
        self._retry_at_s = self._give_up_at_s = 0.0
        self._asked: list[threading.Event] = []  # by other programs, for a stop: to be set when the board is at rest
        self._confirming: list[threading.Event] = []
        self._stoppable = Stoppable([self._address, listener.address], self._stop_for_another_program)
        if self._stoppable.why_not:
            _say(f"`mirrormount stop` does not get through this program: {self._stoppable.why_not}")

    def run_once(self) -> None:
        """Wait for events and serve them once. Raises ConnectionLost if the board stays lost."""
        client, reader = self._client, self._reader
        watched = [s for s in (client and client.socket, reader and reader.end) if s]
        eager = [client.socket] if client and client.unread else []
        wait_s = min(self._relay.due_s(), 0.05 if self._listener.busy() else 0.5)
        readable, _, _ = select.select([*watched, *self._listener.watched()], eager, [], wait_s)
        if client and client.socket in readable:
            self._receive_from_client(client)
        self._with_board(self._relay.pump)
        if reader and reader.end in readable and reader is self._reader:
            self._receive_from_board(reader)
        if self._client:
            self._client.flush()
        self._confirm_stops()
        if self._session is None:
            self._look_for_board()
        self._listener.poll()
        self._admit()

    def close(self) -> None:
        """Stop the motors and close. Raises MountError if they did not stop."""
        try:
            if self._session:
                self._session.link.port.write(b"!\n")
            if self._reader:
                self._reader.close()
            if self._session:
                self._session.link.drain(_QUIET_S)
                self._session.stop()
        finally:
            self._stoppable.close()
            if self._session:
                self._session.close()
            if self._client:
                self._client.socket.close()

    # ---- the client

    def _receive_from_client(self, client: ClientSession) -> None:
        """Receive all that is there, up to a bound: the last byte may be a stop."""
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
        self._forward(sent)
        if why and client is self._client:
            self._dismiss(why)

    def _forward(self, data: bytes) -> None:
        self._with_board(lambda: self._relay.from_client(data))
        if self._relay.waiting > _WAITING_MOST:
            self._dismiss("sends more than the board can take")

    def _dismiss(self, why: str) -> None:
        """Disconnect the client: stop its motion, or let moves of known length finish."""
        client, self._client = self._client, None
        what = "motors stopped"
        if not self._finish:
            self._with_board(self._relay.stop)
        elif self._session and self._with_board(self._relay.client_left):
            what = "its move is finished"
        if client:
            client.socket.close()
            _say(f"{client.name} {why}{f': {what}' if self._session else ''}")

    def _admit(self) -> None:
        if self._client or self._session is None:
            self._listener.reject_waiting(refusal_line(TAKEN if self._client else NO_BOARD))
            return
        client = self._listener.next()
        if client:
            self._client = client
            client.unread += self._greeting
            client.flush()  # first of all: a driver waits for it
            _say(f"{client.name} controls the board")
            if self._finish and self._relay.moving:
                self._with_board(self._relay.mute_old_replies)
            else:
                self._settle()
            if self._session:
                self._forward(client.pending)

    # ---- the board

    def _with_board(self, tell: Callable[[], object]) -> object:
        """Call a function that writes to the board, if there is one. Returns its result."""
        if self._session:
            try:
                return tell()
            except ConnectionLost as e:
                self._lose_board(e)
        return None

    def _receive_from_board(self, reader: PortReader) -> None:
        data = reader.end.recv(1 << 16)
        if not data:
            self._lose_board(reader.lost)
            return
        if reader.at_prompt(data):  # bytes of a client would be executed as Python there
            self._lose_board("the board is at its Python prompt")
            return
        answers = self._relay.from_board(data)
        if self._client and self._client.answer(answers):
            _say(f"{self._client.name} does not read: answers are dropped")

    def _settle(self) -> None:
        """Stop the motors, wait for the end of replies to the client before, check the board."""
        session, reader = self._session, self._reader
        if session is None or reader is None:
            return
        reader.close()
        try:
            session.link.port.write(b"!\n")
            session.link.drain(_QUIET_S, _QUIET_LONGEST_S)
            self._session = Session(session.link)
            self._session.ask("XK0;XK?")  # the keep-alive of a client that fed it, for one that may not
            self._relay = Relay(session.link.port.write)
            self._reader = PortReader(session.link.port)
        except MountError as e:
            self._lose_board(e)

    def _lose_board(self, why: object) -> None:
        _say(f"{why}: what moves is ended by the board's own keep-alive or run limit; waiting for the board")
        if self._reader:
            self._reader.close()
        if self._session:
            self._session.close()
        if self._client:
            self._client.socket.close()
        self._reader = self._session = self._client = None
        self._relay = Relay(_nowhere)
        self._retry_at_s = time.monotonic() + _RETRY_S
        self._give_up_at_s = time.monotonic() + _GIVE_UP_S

    def _look_for_board(self) -> None:
        """Open the same board again if it is back. It is stopped then; no motion resumes."""
        if time.monotonic() < self._retry_at_s:
            return
        try:
            session = Session.open(self._address)
            if _who(session.board.identity) == _who(self.identity):
                self._session, self._reader = session, PortReader(session.link.port)
                self._relay = Relay(session.link.port.write)
                _say("the board is back")
                return
            session.close()
            why = f"another board is there: {session.board.identity}"
        except MountError as e:
            why = str(e)
        if time.monotonic() > self._give_up_at_s:
            raise ConnectionLost(f"the board did not come back within {_GIVE_UP_S / 60:g} minutes: {why}")
        self._retry_at_s = time.monotonic() + _RETRY_S

    def _stop_for_another_program(self) -> str:
        """Write the stop to the port at once. Runs in a thread of the stop socket."""
        session = self._session
        if session is None:
            raise ConnectionLost("the board is not there")
        at_rest = threading.Event()
        session.link.port.write(b"!\n")
        self._asked.append(at_rest)
        return STOPPED if at_rest.wait(_REST_S) else SENT

    def _confirm_stops(self) -> None:
        if self._asked:
            while self._asked:  # another thread may add to it
                self._confirming.append(self._asked.pop())
            self._with_board(self._relay.stop)
            self._relay.query_motion()
        elif self._confirming and not self._relay.moving:
            while self._confirming:
                self._confirming.pop().set()


def _nowhere(_data: bytes) -> None:
    """Drop bytes for a board that is lost."""


def _who(identity: str) -> str:
    """The board in an identity, without the version of its firmware."""
    return identity.rpartition(",")[0]


def _say(line: str) -> None:
    with contextlib.suppress(OSError):  # a closed log must not end the service
        print(f"mirrormount: {line}", file=sys.stderr, flush=True)


def _end(number: int, _frame: FrameType | None) -> None:
    for every in _SIGNALS:  # no further signal may interrupt the stop that follows
        signal.signal(every, signal.SIG_IGN)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(0)
