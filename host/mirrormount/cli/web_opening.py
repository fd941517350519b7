"""Where pages of this program come in: a listening socket, its addresses, the token, what the terminal shows."""

import argparse
import contextlib
import ipaddress
import os
import secrets
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType

from mirrormount.cli.browser_link import page_to
from mirrormount.common.errors import BadAddress, BadValue, CannotListen
from mirrormount.common.validation import digits
from mirrormount.panel.sign_in import SignIn
from mirrormount.panel.tokens import SHORT, is_short, read_token

_PORT = 8080
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

    def tell(self, what: str, whoever: str) -> None:
        """Print what is served, and its links. whoever: what a person with the link can do."""
        self.sign_in.told = lambda client, _code: _tell_used(self, client)
        print(what)
        links = [self.link(address, self.sign_in.terminal_code) for address in self.addresses]
        if self.wide:
            import segno

            print(f"On a phone in the same network (whoever has this link {whoever}; it works once):")
            if sys.stdout.isatty():
                segno.make(links[0], error="m").terminal(compact=True)
        for link in links:
            print(f"ready {link}", flush=True)

    def browser(self, kept: contextlib.ExitStack) -> Callable[[], object]:
        """What opens the browser here; in a thread: some do not return. kept: holds the page of the link."""
        try:
            link = kept.enter_context(page_to(self.link(self.addresses[-1], self.sign_in.new_code)))
        except OSError:  # no room for the page of the link: the terminal has shown one
            return lambda: None
        return threading.Thread(target=webbrowser.open, args=(link,), daemon=True).start


@contextlib.contextmanager
def opened(args: argparse.Namespace) -> Iterator[Opening]:
    """What the arguments of arguments() ask for; closed at the end. Raises BadValue, BadAddress, CannotListen."""
    listener = _listen(args.host, args.http)
    with contextlib.closing(listener):
        wide = not ipaddress.ip_address(listener.getsockname()[0]).is_loopback
        token = read_token(args.token, args.token_file) or (secrets.token_urlsafe(16).encode() if wide else None)
        for warning in _warnings(args.token, token):
            print(f"mirrormount: warning: {warning}", file=sys.stderr)
        yield Opening(listener, _links(listener), wide, SignIn(token))


def end_by_signals() -> None:
    """SIGTERM and SIGHUP end the program in order; while a web server runs, they end that first."""
    signal.signal(signal.SIGTERM, _end)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup ignores it
        signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))


def _end(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)


def _listen(host: str, port: str | None) -> socket.socket:
    """A listening socket. Without a port: 8080, or the next one that is free.

    Raises BadValue, BadAddress, CannotListen.
    """
    try:
        ports = range(_PORT, _PORT + _TRIED) if port is None else [digits(port, 65535)]
    except BadValue:
        raise BadValue(f"--http is a port number, 0 to 65535, not {str(port)[:80]!r}") from None
    try:
        family, _, _, _, where = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as e:
        raise BadAddress(f"{host}: there is no such host to listen at") from e
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


def _tell_used(opening: Opening, client: str) -> None:
    link = opening.link(opening.addresses[0], opening.sign_in.terminal_code)
    with contextlib.suppress(OSError):  # the terminal has gone
        print(f"the link was used by {client}; for another browser: {link}", flush=True)
