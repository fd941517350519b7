"""A virtual board for any client, until Ctrl-C or SIGTERM."""

import argparse
import os
import signal
import sys
from pathlib import Path
from types import FrameType

from mirrormount.common.errors import BadAddress, BadValue, MountError
from mirrormount.common.validation import digits
from mirrormount.virtual.board import Options, make_simulation
from mirrormount.virtual.lockstep import Lockstep
from mirrormount.virtual.ports import Port
from mirrormount.virtual.profile import SMOOTH
from mirrormount.virtual.pty_port import PtyPort
from mirrormount.virtual.query import orders_of, profile_named, seed_of
from mirrormount.virtual.realtime import serve
from mirrormount.virtual.simulation import BoardGone
from mirrormount.virtual.tcp_port import TcpPort


def serve_board(args: argparse.Namespace) -> None:
    """Serve until told to end. Raises BadAddress, BadValue, MountError."""
    if args.speed == "max":
        raise BadValue("a live host needs its own pace: --speed max is for virtual://?speed=max, in one process")
    signal.signal(signal.SIGTERM, _end)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, _end)  # its terminal was closed
    for name in ("link", "edges", "files", "image", "flash", "truth"):
        if getattr(args, name) == Path(""):
            raise BadAddress(f"--{name} needs a file's name")
    ports = _ports(args)
    try:
        names = ("machine", "bench", "board", "edges", "files", "image", "flash", "flash_cache", "encoder", "truth")
        given = {name: getattr(args, name) for name in names}
        profile = profile_named(args.profile or SMOOTH.name, args.supply)
        mechanics = {"profile": profile, "seed": seed_of(args.seed or "1"), "orders": orders_of(args.fault)}
        simulation = make_simulation(Options(**given, **mechanics))
        try:
            if args.machine == "cpython":  # who reads `ready` may ask at once: a board must answer within 2 s
                Lockstep(simulation).boot()
            print("ready " + " ".join(port.address for port in ports), flush=True)
            serve(simulation, ports, lambda: False)
        except BoardGone as e:
            raise MountError(f"the virtual board's firmware has ended unexpectedly{e.why}") from None
        except (KeyboardInterrupt, SystemExit):
            pass
        finally:
            simulation.close()
    finally:
        for port in ports:
            port.close()


def _ports(args: argparse.Namespace) -> list[Port]:
    ports: list[Port] = []
    tcp = args.tcp
    if tcp is None and args.link is None and os.name != "posix":
        tcp = "0"
    if tcp is not None:
        try:
            number = digits(tcp, 65535)
        except BadValue:
            raise BadValue(f"--tcp is a port number, 0 to 65535, not {tcp[:80]!r}") from None
        try:
            ports.append(TcpPort(number))
        except OSError as e:
            raise BadAddress(f"cannot listen on 127.0.0.1:{tcp}: {os.strerror(e.errno or 0)}") from e
    if args.link is not None or not ports:
        if os.name != "posix":
            raise BadValue("this system has no pseudo-terminals: use --tcp")
        if args.link is not None and args.link.exists():
            in_use = "leads to a terminal in use: another board's, or a new one since a board there was killed"
            found = in_use if args.link.is_symlink() else "exists and is not a symlink"
            raise BadAddress(f"{args.link} {found}; remove it, or take another name")
        try:
            ports.append(PtyPort(args.link))
        except OSError as e:
            raise BadAddress(f"cannot make {args.link}: {os.strerror(e.errno or 0)}") from e
    return ports


def _end(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)
