"""The work of `mirrormount panel`: serves it, prints its addresses, opens the browser. Ctrl-C stops the motors."""

import argparse
import contextlib
import importlib.util
import ipaddress
import math
import os
import secrets
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING

from mirrormount.cli import panel_camera
from mirrormount.cli.browser_link import page_to
from mirrormount.cli.command import virtual_address
from mirrormount.common.errors import BadAddress, BadValue, CannotListen, ExtraMissing, NoBoardFound
from mirrormount.common.extras import install
from mirrormount.common.tokens import SHORT, is_short, read_token
from mirrormount.panel.sign_in import SignIn
from mirrormount.transport.find import find

if TYPE_CHECKING:
    from mirrormount.panel.camera_view import CameraView
    from mirrormount.supervise.reconnect import Address

_PORT = 8080
_PATIENCE_S = 0.1, 2.0
_TRIED = 20  # ports after it, if no other was asked for


@dataclass(frozen=True)
class Opening:
    """Where pages come in. addresses: to be opened, the best first. wide: from other computers, too."""

    listener: socket.socket
    addresses: list[str]
    wide: bool
    sign_in: SignIn

    def link(self, address: str, code: Callable[[], str]) -> str:
        """What to open at an address; with a code, where a sign-in is needed."""
        return address if self.sign_in.token is None else f"{address}enter#{code()}"


def serve_panel(args: argparse.Namespace) -> None:
    """Serve the panel until told to end. Raises MountError."""
    if any(importlib.util.find_spec(name) is None for name in ("nicegui", "segno")):
        raise ExtraMissing(f"the panel needs NiceGUI, which is not installed: {install('gui')}")
    patience_s = _patience(args.patience)
    address = _address(args)
    listener = _listen(args.host, args.http)
    try:
        wide = not ipaddress.ip_address(listener.getsockname()[0]).is_loopback
        token = read_token(args.token, args.token_file) or (secrets.token_urlsafe(16).encode() if wide else None)
        for warning in _warnings(args.token, token):
            print(f"mirrormount: warning: {warning}", file=sys.stderr)
        opening = Opening(listener, _links(listener), wide, SignIn(token))
        with panel_camera.opened(args, address) as (board, view):
            _serve(board, opening, patience_s, args.browser, view)
    finally:
        listener.close()


def _address(args: argparse.Namespace) -> str | None:
    """The board's address; a virtual one if that is asked for, or taken at a terminal where no board is found."""
    given = args.at or args.port
    virtual = virtual_address(args)
    if virtual:
        if args.at:
            raise BadValue("--virtual is a board of its own: leave the port out")
        return virtual
    if given is None and not find():
        if not _virtual_wanted():
            raise NoBoardFound(
                "no board found: plug one in, name its port, or take a virtual one: mirrormount panel --virtual"
            )
        return "virtual://"
    return given


def _virtual_wanted() -> bool:
    """Ask, if there is somebody to ask."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    try:
        answer = input("No board found. Open the panel with a virtual one? [y/N] ")
    except EOFError:  # Ctrl-D
        return False
    return answer.strip().lower() in ("y", "yes")


def _listen(host: str, port: str | None) -> socket.socket:
    """A listening socket. Without a port: 8080, or the next one that is free.

    Raises BadValue, BadAddress, CannotListen.
    """
    if port is not None and not (port.isascii() and port.isdecimal() and int(port) < 65536):
        raise BadValue(f"--http is a port number, 0 to 65535, not {port!r}")
    try:
        family, _, _, _, where = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as e:
        raise BadAddress(f"{host}: there is no such host to listen at") from e
    ports = range(_PORT, _PORT + _TRIED) if port is None else [int(port)]
    failures = []
    for number in ports:
        try:
            return socket.create_server((str(where[0]), number), family=family)
        except OSError as e:
            failures.append(os.strerror(e.errno or 0).lower())
    raise CannotListen(f"cannot listen on {host}:{ports[0]}: {failures[0]}; take another port: --http 0")


def _warnings(argument: str | None, token: bytes | None) -> list[str]:
    warnings = []
    if argument is not None:
        warnings.append("other users of this computer can see --token in the list of processes: use --token-file FILE")
    if is_short(token):
        warnings.append(SHORT)
    return warnings


def _links(listener: socket.socket) -> list[str]:
    """Addresses to be opened, the best first."""
    host, port = listener.getsockname()[:2]
    address = ipaddress.ip_address(host)
    hosts = _own_addresses(address.version) if address.is_unspecified else [host]
    return [f"http://{f'[{h}]' if ':' in h else h}:{port}/" for h in hosts]


def _own_addresses(version: int) -> list[str]:
    """This computer's addresses in its networks, and the loopback one."""
    import ifaddr  # NiceGUI depends on it

    ips = [ip for adapter in ifaddr.get_adapters() for ip in adapter.ips]
    found = [str(ip.ip) if ip.is_IPv4 else str(ip.ip[0]) for ip in ips if ip.is_IPv4 == (version == 4)]
    wide = [ip for ip in found if not (ipaddress.ip_address(ip).is_loopback or ipaddress.ip_address(ip).is_link_local)]
    return [*wide, "127.0.0.1"] if version == 4 else [*wide, "::1"]


def _patience(text: str) -> float:
    low, high = _PATIENCE_S
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not low <= seconds <= high:
        raise BadValue(f"--patience is {low:g} to {high:g} seconds, not {text!r}")
    return seconds


def _serve(board: "Address", opening: Opening, patience_s: float, browser: bool, view: "CameraView | None") -> None:
    from mirrormount.panel.server import make_server
    from mirrormount.supervise import Supervisor

    signal.signal(signal.SIGTERM, _end)  # while the web server runs, it ends that first
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup ignores it
        signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))
    with Supervisor(board, patience_s=patience_s) as supervisor, contextlib.ExitStack() as pages:
        worker = supervisor.worker
        sign_in, best, own = opening.sign_in, opening.addresses[0], opening.addresses[-1]
        sign_in.told = lambda client, _code: _tell_used(opening, client)
        phone = (lambda: opening.link(best, sign_in.new_code)) if opening.wide else None
        server = make_server(worker, sign_in, phone, view)
        _tell(worker.mount.identity if worker.mount else "", opening)
        if browser:  # in a thread: some do not return
            with contextlib.suppress(OSError):  # no room for the page of the link: the terminal has shown one
                link = pages.enter_context(page_to(opening.link(own, sign_in.new_code)))
                show = threading.Thread(target=webbrowser.open, args=(link,), daemon=True)
                server.when_ready(show.start)
        server.run([opening.listener])


def _end(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)


def _tell(identity: str, opening: Opening) -> None:
    print(identity)
    links = [opening.link(address, opening.sign_in.terminal_code) for address in opening.addresses]
    if opening.wide:
        import segno

        print("On a phone in the same network (whoever has this link can drive the mount; it works once):")
        if sys.stdout.isatty():
            segno.make(links[0], error="m").terminal(compact=True)
    for link in links:
        print(f"ready {link}", flush=True)


def _tell_used(opening: Opening, client: str) -> None:
    link = opening.link(opening.addresses[0], opening.sign_in.terminal_code)
    with contextlib.suppress(OSError):  # the terminal has gone
        print(f"the link was used by {client}; for another browser: {link}", flush=True)
