"""`mirrormount panel`, and what it shares with the pages of `hold --page` and `camera show --page`.

A page comes in at a listening socket (Opening): the terminal prints its addresses, and a browser is led there. A link
with a secret goes to the browser in a file, because every user can read the arguments of a process. The panel has the
mounts of table.toml, one named board, or virtual ones; a mount that is not there is looked for. Ctrl-C and SIGTERM
stop the motors before the pages are closed.

NiceGUI, uvicorn and FastAPI are imported where a page is served, so that the help of the command is quick.
"""

import argparse
import contextlib
import html
import importlib.util
import ipaddress
import os
import secrets
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from mirrormount.cli.arguments import (
    Command,
    board_port,
    camera_options,
    camera_settings,
    patience_of,
    patience_option,
    virtual_address,
    virtual_camera,
    virtual_options,
    web_options,
)
from mirrormount.device import table_file
from mirrormount.device.table_file import MountEntry
from mirrormount.errors import BadAddress, BadValue, CannotListen, ExtraMissing, NoBoardFound
from mirrormount.supervise.supervisor import Supervisor, supervised
from mirrormount.supervise.worker import Worker
from mirrormount.terminal import install_command, printable
from mirrormount.transport.discovery import find
from mirrormount.transport.ports import TABLE_SCHEMES, Port
from mirrormount.values import digits
from mirrormount_beam.camera import Limits
from mirrormount_beam.cameras import open_camera, select
from mirrormount_beam.live import LiveCamera
from mirrormount_panel.auth import SHORT, SignIn, is_short, read_token

if TYPE_CHECKING:
    from mirrormount.supervise.connection import Address
    from mirrormount_beam.camera import Dark
    from mirrormount_panel.camera import CameraView

# ---- a link for the browser

_PAGE = """<!doctype html><meta charset=utf-8><title>mirrormount</title>
<meta http-equiv=refresh content="0; url={0}"><a href="{0}">the panel</a>
"""


@contextlib.contextmanager
def page_to(link: str) -> Iterator[str]:
    """The address of a page that leads to the link. Only this user can read it; it is removed at the end.

    A link without a fragment has no secret, and is returned as it is. Raises OSError.
    """
    if "#" not in link:
        yield link
        return
    descriptor, name = tempfile.mkstemp(prefix="mirrormount-", suffix=".html")  # mode 600
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as page:
            page.write(_PAGE.format(html.escape(link)))
        yield Path(name).as_uri()
    finally:
        Path(name).unlink(missing_ok=True)


# ---- where pages come in

_PORT = 8080
_TRIED = 20  # If no port was asked for, so many ports after it are tried.


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


# ---- the mounts of the panel


def of_table(entries: Mapping[str, MountEntry], patience_s: float) -> dict[str, Supervisor]:
    """A supervisor for each board, not open yet, under the names of its mounts."""
    names: dict[Supervisor, list[str]] = {}
    for name, (supervisor, _) in supervised(entries, patience_s).items():
        names.setdefault(supervisor, []).append(name)
    return {" and ".join(of_board): supervisor for supervisor, of_board in names.items()}


@contextlib.contextmanager
def virtual(args: argparse.Namespace, patience_s: float) -> Iterator[dict[str, Supervisor]]:
    """Two mounts of a virtual table. Raises BadValue."""
    from mirrormount_sim.table import VirtualTable, open_table

    def openers(table: VirtualTable, number: int) -> Callable[[], Port]:
        first = iter([table.ports[number]])
        return lambda: next(first, None) or table.replug(number)

    with contextlib.closing(open_table(virtual_address(args, "virtual-table", mounts="2", speed="1") or "")) as table:
        address = partial(openers, table)
        yield {
            name: Supervisor(address(number), patience_s=patience_s) for number, name in enumerate(("first", "second"))
        }


def open_all(supervisors: Mapping[str, Supervisor], until: contextlib.ExitStack) -> None:
    """Open them; until closes them. One of several that is not there is told, and looked for every second.

    Raises NoBoardFound if none is there.
    """
    for name, supervisor in supervisors.items():
        until.enter_context(contextlib.closing(supervisor.open(absent=len(supervisors) > 1)))
        trouble = supervisor.worker.connection.trouble
        if trouble:
            print(f"mirrormount: warning: {name}: {trouble}", file=sys.stderr)
    if not any(supervisor.worker.mount for supervisor in supervisors.values()):
        raise NoBoardFound(f"no mount of the table is there: {', '.join(supervisors)}")


def told(workers: Mapping[str, Worker]) -> str:
    """Which boards there are, a line for each."""
    lines = []
    for name, worker in workers.items():
        identity = worker.mount.identity if worker.mount else "not there yet"
        lines.append(f"{name}: {identity}" if name else identity)
    return "\n".join(lines)


# ---- the camera of the panel


@contextlib.contextmanager
def opened_camera(
    args: argparse.Namespace, address: str | None
) -> "Iterator[tuple[Address, CameraView[LiveCamera] | None]]":
    """Where the board is, and the camera; None without one. Raises MountError."""
    settings = camera_settings(args)
    if args.camera is None:
        if settings.given:
            raise BadValue(f"{', '.join(settings.given)}: of a camera; add --camera")
        yield address, None
        return
    if args.virtual:
        with _on_table(args) as found:
            yield found
        return
    from mirrormount_panel.camera import CameraView

    name: str = in_real_time(args.camera)
    live = LiveCamera(name, lambda: open_camera(name, settings=settings))
    with contextlib.closing(live):
        live.open()
        yield address, CameraView(live)


def in_real_time(camera: str) -> str:
    """A camera's address; that of a virtual table which says nothing else runs by the wall clock."""
    table, mark, number = camera.partition("#")
    if table.partition("://")[0] in TABLE_SCHEMES and "speed=" not in table:
        table += ("&" if "?" in table else "?") + "speed=1"
    return table + mark + number


@contextlib.contextmanager
def _on_table(args: argparse.Namespace) -> "Iterator[tuple[Address, CameraView[LiveCamera] | None]]":
    """The mount of a virtual table, and one of its two cameras."""
    from mirrormount_panel.camera import CameraView
    from mirrormount_sim.table import open_table

    which = virtual_camera(args.camera)
    table = open_table(virtual_address(args, "virtual-table", mounts="1", speed="1") or "")
    with contextlib.closing(table):
        camera = table.cameras[which - 1]
        select(camera, camera_settings(args))
        live = LiveCamera(camera.name, lambda: camera)
        with contextlib.closing(live):
            live.open()
            ports = iter([table.ports[0]])
            yield lambda: next(ports, None) or table.replug(0), CameraView(live)


# ---- the panel


def serve_panel(args: argparse.Namespace) -> None:
    """Serve the panel until a signal ends it. Raises MountError."""
    if any(importlib.util.find_spec(name) is None for name in ("nicegui", "segno")):
        raise ExtraMissing(f"the panel needs NiceGUI, which is not installed: {install_command('panel')}")
    patience_s = patience_of(args)
    mounts = _mounts_of_table(args)
    address = None if mounts else _address(args)
    with opened(args) as opening, contextlib.ExitStack() as stack:
        view = None
        if mounts:
            supervisors = of_table(mounts, patience_s)
        elif args.mounts == "2":
            supervisors = stack.enter_context(virtual(args, patience_s))
        else:
            board, view = stack.enter_context(opened_camera(args, address))
            supervisors = {"": Supervisor(board, patience_s=patience_s)}
        _serve(supervisors, opening, args.browser, view)


def _mounts_of_table(args: argparse.Namespace) -> Mapping[str, MountEntry]:
    """The mounts of the table, where no port is named and no virtual board is asked for; one alone becomes args.at.

    Raises BadFile, BadValue.
    """
    if args.mounts and not args.virtual:
        raise BadValue("--mounts: of virtual boards; add --virtual")
    if args.mounts == "2" and args.camera is not None:
        raise BadValue("a click on a picture moves the spot by one mount: leave --mounts 2 or --camera out")
    mounts = {} if args.at or args.port or args.virtual else table_file.read().mounts
    if len(mounts) == 1:
        (args.at,) = mounts
        return {}
    if mounts and args.camera is not None:
        names = ", ".join(mounts)
        raise BadValue(f"a click on a picture moves the spot by one mount: name it (mirrormount panel NAME): {names}")
    return mounts


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


def _serve(
    supervisors: Mapping[str, Supervisor],
    opening: Opening,
    browser: bool,
    view: "CameraView[LiveCamera] | None",
) -> None:
    from mirrormount_panel.server import make_server

    end_by_signals()
    with contextlib.ExitStack() as pages:
        open_all(supervisors, pages)
        workers = {name: supervisor.worker for name, supervisor in supervisors.items()}
        phone = (lambda: opening.link(opening.addresses[0], opening.sign_in.new_code)) if opening.wide else None
        server = make_server(workers, opening.sign_in, phone, view)
        opening.tell(told(workers), f"can drive the mount{'s' if len(workers) > 1 else ''}")
        if browser:
            server.when_ready(opening.browser(pages))
        server.run([opening.listener])


# ---- the page of one camera

_BODY = """<main class="one"><section class="card">{}</section><section class="card"><p class="hint">
Green: the spot, and twice its size (standard deviation). Grey: what is above the threshold. Red: the trail. Dark: what
is not looked at. Below the picture: the grey values along the longer and the shorter axis of the beam, in pixels from
its place; the green lines are Gaussians of the same D4-sigma width and area. Below: the grey values of the row through
the spot, or through the brightest place, and what they have to exceed. The errors are standard errors.</p></section>
</main>"""


def serve_camera_page(args: argparse.Namespace, dark: "Dark | None") -> None:
    """Serve the page until a signal ends it. Raises MountError."""
    from mirrormount_panel.camera import CameraView, camera_html
    from mirrormount_panel.server import light_page, log_to_file, make_light_server

    name: str = in_real_time(args.camera)
    limits, settings = Limits(may_be_black=True), camera_settings(args)
    live = LiveCamera(name, lambda: open_camera(name, limits=limits, settings=settings), dark)
    with opened(args) as opening, contextlib.closing(live), contextlib.ExitStack() as kept:
        live.open()
        end_by_signals()
        log_to_file()
        title = printable(live.name)
        body = _BODY.format(camera_html(1, title, profile=True))
        server = make_light_server(light_page(title, body, "camera.js"), [CameraView(live)], opening.sign_in)
        opening.tell(title, "can see this camera")
        if args.browser:
            opening.browser(kept)()
        server.run([opening.listener])


# ---- the command


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, where to listen, and the token."""
    board_port(parser)
    virtual_options(parser, "a virtual board, with its screen; no hardware needed")
    parser.add_argument("--mounts", choices=("1", "2"), help="virtual: how many (1)")
    parser.add_argument("--encoder", choices=("motor", "shaft"), help="virtual: an encoder on each motor, or behind it")
    web_options(parser)
    patience_option(parser, "a page")
    parser.add_argument(
        "--camera",
        help="a camera's picture, and clicks that move the spot: index, device, part of a name; with --virtual: 1 or 2",
    )
    camera_options(parser)


COMMANDS = (
    Command("panel", "the web panel: drive one or more mounts from a browser, until Ctrl-C", serve_panel, arguments),
)
