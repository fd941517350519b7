"""`mirrormount panel`: serves the panel, says where, and opens the browser. Until Ctrl-C, which stops the motors."""

import argparse
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
from dataclasses import dataclass
from types import FrameType
from urllib.parse import quote

from mirrormount.errors import BadAddress, BadValue, CannotListen, ExtraMissing, NoBoardFound
from mirrormount.link import find
from mirrormount.tokens import check_token

_PORT = 8080
_PATIENCE_S = 0.1, 2.0
_TRIED = 20  # ports after it, if no other was asked for


@dataclass(frozen=True)
class Opening:
    """Where pages come in. links: what to open, the best first. wide: from other computers, too."""

    listener: socket.socket
    token: bytes | None
    links: list[str]
    wide: bool


def run(args: argparse.Namespace) -> None:
    """Serve the panel until told to end. Raises MountError."""
    if any(importlib.util.find_spec(name) is None for name in ("nicegui", "segno")):
        raise ExtraMissing('the panel needs NiceGUI: pip install "mirrormount[gui]"')
    patience_s = _patience(args.patience)
    address = _address(args)
    listener = _listen(args.host, args.http)
    try:
        wide = not ipaddress.ip_address(listener.getsockname()[0]).is_loopback
        token = args.token if args.token is not None else os.environ.get("MIRRORMOUNT_TOKEN") or None
        if token is None and wide:
            token = secrets.token_urlsafe(16)
        checked = check_token(token)
        _serve(address, Opening(listener, checked, _links(listener, token), wide), patience_s, args.browser)
    finally:
        listener.close()


def _address(args: argparse.Namespace) -> str | None:
    """The board's address; a virtual one if that is asked for, or taken at a terminal where no board is found."""
    given = args.at or args.port
    if args.virtual:
        if args.at:
            raise BadValue("--virtual is a board of its own: leave the port out")
        return "virtual://"
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


def _links(listener: socket.socket, token: str | None) -> list[str]:
    """What to open, the best first."""
    host, port = listener.getsockname()[:2]
    query = "" if token is None else f"?token={quote(token, safe='')}"
    address = ipaddress.ip_address(host)
    hosts = _own_addresses(address.version) if address.is_unspecified else [host]
    return [f"http://{f'[{h}]' if ':' in h else h}:{port}/{query}" for h in hosts]


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


def _serve(address: str | None, opening: Opening, patience_s: float, browser: bool) -> None:
    from mirrormount.panel.desk import Desk
    from mirrormount.panel.pilot import Pilot
    from mirrormount.panel.server import make_server

    desk = Desk(silent_s=patience_s)
    pilot = Pilot(address, desk)
    signal.signal(signal.SIGTERM, _end)  # while the web server runs, it ends that first
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup ignores it
        signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))
    try:
        pilot.open()
        server = make_server(desk, pilot, opening.token, opening.links[0] if opening.wide else None)
        _tell(pilot.mount.identity if pilot.mount else "", opening)
        if browser:  # in a thread: some do not return
            show = threading.Thread(target=webbrowser.open, args=(opening.links[-1],), daemon=True)
            server.when_ready(show.start)
        server.run([opening.listener])
    finally:
        pilot.close()


def _end(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)


def _tell(identity: str, opening: Opening) -> None:
    print(identity)
    if opening.wide:
        import segno

        print("On a phone in the same network (whoever has this link can drive the mount):")
        if sys.stdout.isatty():
            segno.make(opening.links[0], error="m").terminal(compact=True)
    for link in opening.links:
        print(f"ready {link}", flush=True)
