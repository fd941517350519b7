"""A board on TCP, for programs that drive a New Focus 8742 on Ethernet.

    serve("/dev/ttyACM0", listen("127.0.0.1", 5023, []))   # until a signal ends it

One client at a time drives; a stop is taken from every client. When the client that drives goes, the motors stop. One
thread does all but reading the port, so nothing here needs a lock.

`Relay` is the part without I/O. Only whole messages go to the board, so it is at a message boundary after each write,
and queries of this program may go between them. They feed the board's keep-alive while a motion lasts: if this program
dies, the mount stops within 0.5 s. A client that sets a keep-alive itself (`XK`) feeds it itself: after its silence of
that length the motors stop.
"""

import contextlib
import errno
import ipaddress
import math
import os
import re
import select
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from mirrormount.device.session import Session
from mirrormount.device.status import check_same_board, parse_status
from mirrormount.errors import (
    AllowNeeded,
    AtPrompt,
    BadAddress,
    BadValue,
    CannotListen,
    ConnectionLost,
    MountError,
    NotAMount,
)
from mirrormount.transport.discovery import find_one
from mirrormount.transport.link import GREETING, NO_BOARD, NOT_ALLOWED, TAKEN, refusal_line
from mirrormount.transport.ports import Port, acknowledge
from mirrormount.transport.stop_socket import SENT, STOPPED, StopListener
from mirrormount.values import KEEP_ALIVE_MS
from mountfw.dialect.line import COMMAND, QUERY, Line, key
from mountfw.wire.frame import Frame, pack
from mountfw.wire.receiver import FRAME, FRAME_GAP_US, LINE, NEED_BYTES, RETURNED, STOP, ZEROS, Receiver

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

GRACE_S = 0.2  # how long a second client waits: the end of the first one's connection may not be seen yet

# Ctrl-C would drop the firmware to its prompt, which executes text as Python; the other keys are mpremote's.
_CTRL_C_STOPS = bytes.maketrans(b"\x03", b"!")
_KEYS = b"\x01\x02\x04\x05\x18"
_TELNET = re.compile(rb"\xff[\xfb-\xfe][^!0]")  # an answer to GREETING; a stop in it stays
# A web page can make the browser of this computer send text here, and the text would be executed: no command line has
# a slash. The byte 0x16 begins TLS.
_HTTP = re.compile(rb"^\x16|^[^\s;]+ +(/|https?:)|HTTP/", re.IGNORECASE | re.MULTILINE)
_EIGHT_ZEROS = b"00000000"

_AHEAD = 512  # bytes sent to the board and not yet executed: a stop waits behind them
_ADDRESS = b"01>"  # the board's own address, as no client writes it: answers that begin so are to queries of this file
_DAMAGE = b"\x7f\n"  # malformed: the board stops and queues error 60, and its next message begins after it
_FEED_S = 0.1  # between two queries of a motion
_ANSWER_S = 0.5  # the board has dropped a query without an answer by then
_LAPSE_S = 0.2  # after a client's keep-alive is over, until the board's is certainly over, too
_MARGIN_S = 0.02  # before it is over, the board's may be: what starts then gets one of this program
_STARTS = [key(name) for name in (b"PR", b"PA", b"XU", b"OR", b"MT", b"MV")]
_MV, _XK, _RST = key(b"MV"), key(b"XK"), key(b"*RST")

_LINE_MOST = 4096  # bytes of a line that are remembered
_RECEIVED_MOST = 1 << 18  # bytes that are received of a client before the others have their turn
_WAITING_MOST = 1 << 20  # bytes of a client that wait for the board
_UNREAD_MOST = 1 << 16  # bytes of answers that wait for a client; beyond, whole answers are dropped
_CROWD_MOST = 16  # clients that wait or were refused; beyond, the oldest is disconnected
_LOST_AFTER = (10, 5, 3)  # a silent connection is probed after 10 s, then each 5 s; 3 times in vain, it is lost
_RETRY_S = 1.0  # between two attempts to open the port of a lost board
_SILENCE_S = 0.2  # after so much of it no rest of an answer follows
_REST_S = 1.5  # until the board must be known to be at rest, when another program asked for a stop


class Messages:
    """Splits a client's bytes as the board does, with the firmware's own parser."""

    def __init__(self) -> None:
        self._frame, self._line = Frame(pack), Line()
        self._receiver = Receiver(self._frame, self._line, pack, 64)

    def feed(self, c: int) -> int:
        """Parse a byte. Returns the kind of the message that it ends, or NEED_BYTES."""
        self._receiver.receive(c)
        message = NEED_BYTES
        while self._receiver.waits():
            message = self._receiver.next() or message
        return message

    @property
    def gap_s(self) -> float:
        """After which silence the board drops an unfinished message; 0 between messages."""
        return self._receiver.gap_us() * 1e-6

    def frame_drives(self) -> bool:
        """True if the last frame drives a motor."""
        return bool(self._frame.m1 or self._frame.m2)

    def commands(self) -> Iterator[tuple[int, int]]:
        """The commands of the last line that are no queries: key of the name, value (0 if it was no number)."""
        line = self._line
        line.rewind()
        while line.more():
            if line.advance() == COMMAND and line.name and line.kind != QUERY:
                yield line.name, line.rounded()


class Relay:
    """Bytes between a client and the board. write hands bytes to the board; call pump() after due_s() at the latest."""

    def __init__(self, write: Callable[[bytes], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._write, self._clock = write, clock
        self._waiting = bytearray()  # for the board
        self._tail = b""  # the last seven bytes of the client: eight zeros may come in two pieces
        self._messages, self._held = Messages(), bytearray()  # held: of an unfinished message
        self._skipping = False  # the rest of a message that was damaged or cut by a stop, as the board does
        self._returned = False  # and of what a client's port returns: all of it, up to a silence
        self._received_s = self._asked_s = self._kept_s = -math.inf
        self._due = self._stale = 0  # answers that will come; of these: to queries from before the last start
        self._ahead = self._unasked = 0  # bytes that may not be executed yet; of these: since the last query
        self._line = b""
        self._client_ms = 0  # the keep-alive that the client has set
        self._runs = False  # something moves that has no end of its own
        self.moving = False  # as far as is known

    @property
    def waiting(self) -> int:
        """Bytes of the client that wait for the board."""
        return len(self._waiting)

    @property
    def settled(self) -> bool:
        """True if no answer for an earlier client can come any more."""
        return not self._due

    def from_client(self, data: bytes) -> None:
        """Take bytes for the board. A stop overtakes what waits, and makes it void if it is much."""
        now_s = self._clock()
        self._skipping = self._skipping and now_s - self._received_s < FRAME_GAP_US * 1e-6
        self._forget_lapsed(now_s, -_MARGIN_S)
        self._received_s = now_s
        zeros = (self._tail + data).rfind(_EIGHT_ZEROS)
        stop = max(data.rfind(b"!") + 1, zeros + 8 - len(self._tail) if zeros >= 0 else 0)  # where it ends
        self._tail = (self._tail + data)[-7:]
        least = len(self._waiting) + stop if stop else 0
        self._waiting += data
        if least > _AHEAD:
            self._forget_message()
            self._waiting[:least] = b"!\n"
            least = 2
        self._forward(least)

    def stop(self) -> None:
        """Stop the motors, and drop what waits."""
        is_cut = bool(self._waiting or self._held)
        self._waiting.clear()
        self._forget_message()
        self._skipping = is_cut
        self._client_ms, self._runs = 0, False
        self._send(b"!\n")
        self._begun()
        self._ask()

    def client_left(self, *, finish: bool) -> bool:
        """The client is gone: stop; or finish, if all that moves has an end of its own. True if a move goes on."""
        if finish and len(self._waiting) <= _AHEAD:
            self._forward(len(self._waiting))
            if self.moving and not self._runs and not self._held:
                self._client_ms = 0
                self._send(self._keep_alive())
                self._ask()
                return True
        self.stop()
        self._send(b"XK0\n")  # of a client that fed it: the next one may not
        self._skipping = False
        return False

    def pump(self) -> None:
        """Send what the board has room for, and feed the keep-alive. Raises ConnectionLost."""
        now_s = self._clock()
        if self._due and now_s - self._asked_s > _ANSWER_S:
            self._due = self._stale = self._ahead = self._unasked = 0
        self._forward()
        if self._held and not self._waiting and now_s - self._received_s > self._messages.gap_s:
            self._forget_message()
            self._send(_DAMAGE)  # as the board would do with half a message
        self._forget_lapsed(now_s, _LAPSE_S)
        fed_until_s = self._received_s + (self._client_ms - KEEP_ALIVE_MS) * 1e-3 + _FEED_S
        if self.moving and now_s - self._asked_s >= _FEED_S and (not self._client_ms or now_s < fed_until_s):
            self._ask()

    def due_s(self) -> float:
        """Seconds until pump() must be called, with or without events."""
        return 0.02 if self._held else 0.05 if self.moving or self._due else 0.5

    def from_board(self, data: bytes) -> bytes:
        """The client's part of the board's answers: whole lines. Raises AtPrompt if Python's prompt is there."""
        whole, end, self._line = (self._line + data).rpartition(b"\n")
        self._line = self._line[-_LINE_MOST:]
        if b">>> " in whole + self._line:  # in no answer of the firmware; text is executed there
            raise AtPrompt("the board is at its Python prompt")
        lines = (whole + end).splitlines(keepends=True)
        for line in lines:
            if line.startswith(_ADDRESS):
                self._see_status(line[len(_ADDRESS) :].decode("ascii", "replace").strip())
        return b"".join(line for line in lines if not line.startswith(_ADDRESS))

    def _forget_lapsed(self, now_s: float, margin_s: float) -> None:
        if now_s - self._received_s > self._client_ms * 1e-3 + margin_s:
            self._client_ms = 0  # the board's has fired, or was not needed

    def _forget_message(self) -> None:
        self._messages, self._skipping = Messages(), False
        self._held.clear()

    def _forward(self, least: int = 0) -> None:
        """Send whole messages: least bytes in any case, others as the board has room."""
        out = bytearray()
        while self._waiting and (least > 0 or self._ahead + len(out) < _AHEAD):
            c = self._waiting[0]
            del self._waiting[0]
            least -= 1
            out += self._take(c)
        self._send(out)
        if self._ahead >= _AHEAD and not self._due:
            self._ask()

    def _take(self, c: int) -> bytes:
        """What goes to the board when byte c has come: nothing, or a whole message."""
        if self._skipping and c != ord("!"):
            self._skipping = self._returned or c not in b"\r\n"
            return b""
        returned = self._skipping and self._returned
        self._held.append(c)
        message = self._messages.feed(c)
        if message == ZEROS:  # a query might go between the zeros; the frame that they are in is not over
            return b"!\n"
        if not message and self._messages.gap_s:
            return b""
        data, cut = bytes(self._held), len(self._held) > 1
        self._held.clear()
        if message == FRAME:
            return self._frame_complete() + data
        if message == LINE:
            return data + self._line_complete()
        if message:
            self._forget_message()
            self._returned = message == RETURNED or (message == STOP and returned)
            self._skipping = self._returned or (c not in b"\r\n" and (cut or message != STOP))
            return b"!\n" if message == STOP else _DAMAGE
        return data

    def _frame_complete(self) -> bytes:
        """The keep-alive for a frame, which is before it and not at each one of a stream."""
        if not self._messages.frame_drives():
            return b""
        self._runs = True
        self._begun()
        return self._keep_alive() if self._clock() - self._kept_s > _FEED_S else b""

    def _line_complete(self) -> bytes:
        """The keep-alive for what a line starts, which is after it: the line may have switched one off."""
        touched = False
        for name, value in self._messages.commands():
            if name in _STARTS:
                self._runs = self._runs or name == _MV
                self._begun()
            elif name == _XK and 0 <= value <= 60_000:
                self._client_ms = value
            elif name == _RST:
                self._client_ms = 0
            touched = touched or name in (*_STARTS, _XK, _RST)
        return self._keep_alive() if touched else b""

    def _keep_alive(self) -> bytes:
        if 0 < self._client_ms <= KEEP_ALIVE_MS:
            return b""
        self._kept_s = self._clock()
        return b"XK%d\n" % KEEP_ALIVE_MS

    def _begun(self) -> None:
        """Something may move from here on, which no answer to an earlier query shows."""
        self.moving = True
        self._stale = self._due

    def _ask(self) -> None:
        self._send(_ADDRESS + b"XS?\n")
        self._asked_s = self._clock()
        self._due += 1
        self._unasked = 0

    def _send(self, data: bytes | bytearray) -> None:
        if data:
            self._ahead += len(data)
            self._unasked += len(data)
            self._write(bytes(data))

    def _see_status(self, status: str) -> None:
        self._due = max(0, self._due - 1)
        if not self._due:
            self._ahead = self._unasked
        if self._stale:
            self._stale -= 1
            return
        with contextlib.suppress(NotAMount):  # damaged on its way: the next one is not
            self.moving = parse_status(status, 1).moving
            self._runs = self._runs and self.moving


class Client:
    """A connection: what it sends, and the answers that it has not read yet. gone: why it is over, else ""."""

    def __init__(self, connection: socket.socket, name: str = "") -> None:
        self.socket, self.name = connection, name
        self.gone = ""
        self.since_s = time.monotonic()
        self.pending = b""  # received before it may drive
        self.refused = False
        self._line = b""
        self._unread = bytearray()
        connection.setblocking(False)
        with contextlib.suppress(OSError):  # gone already: the next read shows it
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option, value in zip(("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"), _LOST_AFTER, strict=True):
                if hasattr(socket, option):
                    connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def receive(self) -> bytes:
        """The bytes for the board that are there: all, up to a bound, for the last one may be a stop. Sets gone."""
        received = b""
        while not self.gone and len(received) < _RECEIVED_MOST:
            try:
                data = self.socket.recv(1 << 16)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            received += data
            self.gone = "" if data else "has gone"
        acknowledge(self.socket)
        lines = self._line + received
        if _HTTP.search(lines):
            self.gone = "is a web browser"
            return b""
        self._line = lines[lines.rfind(b"\n") + 1 :][-_LINE_MOST:]
        return _TELNET.sub(b"", received).translate(_CTRL_C_STOPS, _KEYS)

    def answer(self, data: bytes) -> None:
        """Queue answers, whole lines. A client that does not read loses them, as on the board's own port."""
        if len(self._unread) + len(data) <= _UNREAD_MOST:
            self._unread += data
        self.flush()

    def flush(self) -> bool:
        """Send as much as the connection takes now. True if something waits on."""
        with contextlib.suppress(OSError):  # it does not read, or it has gone: receive() tells
            while self._unread:
                del self._unread[: self.socket.send(self._unread)]
        return bool(self._unread)

    def refuse(self, text: str) -> None:
        """Tell why it may not drive. It is closed when it has closed: else it might lose the line."""
        self.refused, self.pending = True, b""
        with contextlib.suppress(OSError):
            self.socket.send(refusal_line(text))
            self.socket.shutdown(socket.SHUT_WR)


class PortReader:
    """Reads a board's port in a thread, for select() cannot wait for a Port: its bytes come out of `end`.

    When the board is lost, `end` is at its end and `lost` has the cause.
    """

    def __init__(self, port: Port) -> None:
        self.end, self._input = socket.socketpair()
        self.lost = "the board has gone"
        self._port, self._closing = port, False
        self._thread = threading.Thread(target=self._read, name="port reader", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading."""
        self._closing = True
        self.end.close()
        self._thread.join()

    def _read(self) -> None:
        try:
            while not self._closing:
                self._input.sendall(self._port.read(0.05))
        except ConnectionLost as e:
            self.lost = str(e)
        except OSError:  # closed
            pass
        finally:
            self._input.close()


class Server:
    """A board and its clients. allowed: networks beyond this computer. finish: moves with an end outlive their client.

    Raises MountError if the board cannot be opened.
    """

    def __init__(
        self, address: str | None, listening: socket.socket, allowed: Sequence[Network], *, finish: bool = False
    ) -> None:
        self._address = find_one() if address is None else address
        self._listening, self._allowed, self._finish = listening, allowed, finish
        listening.setblocking(False)
        name, number = listening.getsockname()[:2]
        self.where = f"socket://[{name}]:{number}" if ":" in name else f"socket://{name}:{number}"
        self._client: Client | None = None  # that drives
        self._crowd: list[Client] = []  # those that wait, and those that were refused
        self._session: Session | None = None
        self._retry_at_s = 0.0
        self._asked: list[threading.Event] = []  # by other programs, for a stop: to be set when the board is at rest
        self._confirming: list[threading.Event] = []
        self._open_board()
        if self._stop_listener.why_not:
            _say(f"`mirrormount stop` does not get through this program: {self._stop_listener.why_not}")

    def run_once(self) -> None:
        """Wait for events, and serve them once."""
        board = self._session and self._reader.end
        clients = self._crowd + ([self._client] if self._client else [])
        watched = [self._listening, *(client.socket for client in clients), *([board] if board else [])]
        eager = [self._client.socket] if self._client and self._client.flush() else []
        wait_s = min(self._relay.due_s(), 0.05 if any(not client.refused for client in self._crowd) else 0.5)
        readable = select.select(watched, eager, [], wait_s)[0]
        for client in clients:
            if client.socket in readable:
                self._receive(client)
        if board in readable and self._session:
            self._receive_from_board()
        if self._relay.moving and (why := self._stop_listener.why_deaf()):
            self._with_board(self._relay.stop)
            self._dismiss(f"is disconnected, for {why}", finish=False)
        self._with_board(self._relay.pump)
        self._confirm_stops()
        if self._session is None:
            self._look_for_board()
        if self._listening in readable:
            self._accept()
        self._admit()

    def close(self) -> None:
        """Stop the motors and close. Raises MountError if they did not stop."""
        try:
            if self._session:
                self._session.link.port.write(b"!\n")
                self._reader.close()
                self._session.link.drain(0.1)
                _stop(self._session)
        finally:
            self._stop_listener.close()
            if self._session:
                self._session.close()
            for client in self._crowd + ([self._client] if self._client else []):
                client.socket.close()

    # ---- clients

    def _accept(self) -> None:
        try:
            connection, peer = self._listening.accept()
        except OSError:  # it has gone already, or too many files are open
            return
        client = Client(connection, f"{peer[0]}:{peer[1]}")
        if not _is_allowed(str(peer[0]), self._allowed):
            client.refuse(NOT_ALLOWED)
            connection.close()
            _say(f"{client.name} is not allowed")
            return
        self._crowd.append(client)
        if len(self._crowd) > _CROWD_MOST:
            self._crowd.pop(0).socket.close()

    def _admit(self) -> None:
        """Let the next client drive, or refuse those that have waited for too long."""
        for client in [client for client in self._crowd if not client.refused]:
            if self._session and not self._client and self._relay.settled:
                self._crowd.remove(client)
                self._client = client
                client.answer(GREETING)  # before all else: a driver waits for it
                _say(f"{client.name} controls the board")
                self._forward(client.pending)
            elif (self._client or not self._session) and time.monotonic() - client.since_s > GRACE_S:
                client.refuse(TAKEN if self._client else NO_BOARD)

    def _receive(self, client: Client) -> None:
        data = client.receive()
        if client is self._client:
            self._forward(data)
            if client.gone and self._client is client:
                self._dismiss(client.gone, finish=self._finish)
        elif client in self._crowd:
            if b"!" in data or _EIGHT_ZEROS in client.pending[-7:] + data:
                self._with_board(self._relay.stop)
                _say(f"{client.name} stops the motors")
            client.pending = (client.pending + data)[-_UNREAD_MOST:]
            if client.gone:
                self._crowd.remove(client)
                client.socket.close()

    def _forward(self, data: bytes) -> None:
        self._with_board(lambda: self._relay.from_client(data))
        if self._relay.waiting > _WAITING_MOST:
            self._dismiss("sends more than the board can take", finish=self._finish)

    def _dismiss(self, why: str, *, finish: bool) -> None:
        """Disconnect the client that drives: what it started stops, or is finished."""
        client, self._client = self._client, None
        if client and self._session:
            goes_on = self._with_board(lambda: self._relay.client_left(finish=finish))
            why += ": its move is finished" if goes_on else ": motors stopped"
        if client:
            client.socket.close()
            _say(f"{client.name} {why}")

    # ---- the board

    def _open_board(self) -> None:
        """Open it, which stops it. Raises MountError."""
        session = Session.open(self._address)
        session.motion_log = None  # the clients' motions: their answers are relayed, not read
        try:
            if session.link.lockstep:
                raise BadValue("a live client needs its own pace: speed=max is for use in one process")
            identity = session.board.identity
            if self._session is None and hasattr(self, "identity"):
                check_same_board(self.identity, identity)
        except MountError:
            session.close()
            raise
        self.identity, self._session = identity, session
        self._reader = PortReader(session.link.port)
        self._relay = Relay(session.link.port.write)
        # At each opening: the board may have come back under another number, and another board may have its old one.
        names = [self._address, self.where]
        self._stop_listener = StopListener(names, self._stop_for_another_program, session.board.id)

    def _with_board(self, tell: Callable[[], object]) -> object:
        """Call a function that writes to the board, if there is one. Returns its result."""
        if self._session:
            try:
                return tell()
            except ConnectionLost as e:
                self._lose_board(e)
        return None

    def _receive_from_board(self) -> None:
        data = self._reader.end.recv(1 << 16)
        try:
            if not data:
                raise ConnectionLost(self._reader.lost)
            answers = self._relay.from_board(data)
        except MountError as e:
            self._lose_board(e)
            return
        if self._client:
            self._client.answer(answers)

    def _lose_board(self, why: object) -> None:
        _say(f"{why}: what moves is ended by the board's own keep-alive or run limit; waiting for the board")
        self._stop_listener.close()  # first: a later stop is meant for what is at the port then
        self._reader.close()
        if self._session:
            self._session.close()
        if self._client:
            self._client.socket.close()
        self._session = self._client = None
        self._relay = Relay(lambda _data: None)
        self._retry_at_s = time.monotonic() + _RETRY_S

    def _look_for_board(self) -> None:
        """Open the same board again if it is back. No motion resumes."""
        if time.monotonic() > self._retry_at_s:
            self._retry_at_s = math.inf
            with contextlib.suppress(MountError):
                self._open_board()
                _say("the board is back")
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
        elif self._session and not self._relay.moving:
            while self._confirming:
                self._confirming.pop().set()


def _stop(session: Session) -> None:
    """Stop, and confirm it. Raises MountError. The rest of an answer to a client may come late, before the own one."""
    end_s = time.monotonic() + _ANSWER_S
    while True:
        try:
            session.stop()
            return
        except NotAMount:
            if time.monotonic() > end_s:
                raise
            session.link.drain(_SILENCE_S)  # or what is left of that answer is taken for the next one, and so on


def serve(address: str | None, listening: socket.socket, allowed: Sequence[Network], *, finish: bool) -> None:
    """Serve the board at address (None: the one there is) until an exception, as of a signal. See Server."""
    with listening:
        server = Server(address, listening, allowed, finish=finish)
        try:
            print(server.identity)
            print(f"ready {server.where}", flush=True)
            while True:
                server.run_once()
        finally:
            server.close()


def networks(allowed: Sequence[str]) -> list[Network]:
    """The networks that --allow names. Raises BadValue."""
    try:
        return [ipaddress.ip_network(text, strict=False) for text in allowed]
    except ValueError as e:
        raise BadValue(f"--allow is an address or a network, for instance 192.168.1.0/24: {e}") from None


def _is_allowed(peer: str, allowed: Sequence[Network]) -> bool:
    address = ipaddress.ip_address(peer.partition("%")[0])
    address = getattr(address, "ipv4_mapped", None) or address
    return address.is_loopback or any(address in network for network in allowed)


def listen(host: str, port: int, allowed: Sequence[Network]) -> socket.socket:
    """A socket that listens at host and port (0: any that is free). Raises BadAddress, AllowNeeded, CannotListen."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as e:
        raise BadAddress(f"{host}: there is no such host to listen at") from e
    family, _, _, _, where = found[0]
    name = str(where[0])  # what is checked is what is bound: a host's name could resolve differently the second time
    if not allowed and not ipaddress.ip_address(name.partition("%")[0]).is_loopback:
        raise AllowNeeded(
            f"{host} is more than this computer, and whoever reaches it could drive the mount: say who may,"
            " --allow ADDRESS or --allow NETWORK/BITS, or listen on 127.0.0.1"
        )
    try:
        return socket.create_server((name, port), family=family)
    except OSError as e:
        why = os.strerror(e.errno or 0)
        if e.errno in (errno.EACCES, errno.EPERM):
            why = "this user may not use that port (below 1024 it takes an administrator)"
        elif e.errno == errno.EADDRINUSE:
            why = "another program listens there"
        raise CannotListen(f"cannot listen on {host}:{port}: {why}: take another port, as --tcp 5023") from e


def _say(line: str) -> None:
    with contextlib.suppress(OSError):  # a closed log must not end the service
        print(f"mirrormount: {line}", file=sys.stderr, flush=True)
