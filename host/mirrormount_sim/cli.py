"""`mirrormount virtual`, a virtual board for any client, and `mirrormount demo`, the paper's square on one."""

import argparse
import os
import signal
import sys
from pathlib import Path
from types import FrameType

from mirrormount.cli.arguments import DEFAULT_PROFILE, Command, profile_options
from mirrormount.errors import BadAddress, BadValue, MountError
from mirrormount.values import digits
from mirrormount_sim import MACHINES
from mirrormount_sim.ports import Port, PtyPort, TcpPort


def virtual_arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, what it keeps, and where clients reach it."""
    parser.add_argument(
        "--machine",
        choices=MACHINES,
        default="cpython",
        help="what runs the firmware (circuitpython: its port for those boards, on fake modules)",
    )
    parser.add_argument(
        "--files", type=Path, metavar="FOLDER", help="the board's file system (cpython, circuitpython: what it saves)"
    )
    parser.add_argument(
        "--image", type=Path, metavar="FILE", help="rp2040: the MicroPython or CircuitPython image, .uf2 or .bin"
    )
    parser.add_argument("--flash", type=Path, metavar="FILE", help="rp2040: keeps the flash from run to run")
    parser.add_argument("--link", type=Path, metavar="PATH", help="make PATH a symlink to the board's pty")
    parser.add_argument("--tcp", metavar="PORT", help="listen on this loopback port (0: any that is free)")
    parser.add_argument(
        "--edges", type=Path, metavar="FILE", help="write every pin edge to FILE, one JSON object a line"
    )
    parser.add_argument("--bench", choices=("paper", "switches"), default="paper", help="with or without end-stops")
    parser.add_argument("--board", choices=("pico", "pico_drv8833"), default="pico", help="which H-bridge")
    profile_options(parser)
    parser.add_argument("--supply", metavar="SHARE", help="the motors' voltage, of the nominal one (1)")
    parser.add_argument(
        "--encoder",
        choices=("motor", "shaft"),
        help="a magnetic disc on each motor's rear shaft, or an AS5600 on each gearbox's shaft",
    )
    parser.add_argument(
        "--fault",
        default="",
        metavar="NAME[@S],…",
        help="of both encoders (m1:NAME: of one), S seconds after power-up:"
        " lost, swapped, broken, noise, hand (turns the knob), jammed",
    )
    parser.add_argument("--emi", action="store_true", help="a motor that starts disturbs the USB cable")
    parser.add_argument(
        "--truth", type=Path, metavar="FILE", help="write the screws' true turns to FILE at each end of a motion"
    )


def run_virtual(args: argparse.Namespace) -> None:
    """Serve the board until a signal ends it. Raises BadAddress, BadValue, MountError."""
    from mirrormount_sim.board import Options, make_simulation, orders_of, profile_named, seed_of
    from mirrormount_sim.clocks import Lockstep, serve
    from mirrormount_sim.simulation import BoardGone

    signal.signal(signal.SIGTERM, _end)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, _end)  # its terminal was closed
    for name in ("link", "edges", "files", "image", "flash", "truth"):
        if getattr(args, name) == Path(""):
            raise BadAddress(f"--{name} needs a file's name")
    ports = _ports(args)
    try:
        names = ("machine", "bench", "board", "edges", "files", "image", "flash", "encoder", "truth", "emi")
        given = {name: getattr(args, name) for name in names}
        profile = profile_named(args.profile or DEFAULT_PROFILE, args.supply)
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


def demo_arguments(parser: argparse.ArgumentParser) -> None:
    """The picture's file, and which virtual board."""
    parser.add_argument("--output", type=Path, default=Path("square.png"), metavar="FILE", help="the picture")
    parser.add_argument("--port", default="virtual://?speed=max", help="a virtual:// address with other options")
    parser.add_argument("--machine", choices=MACHINES, help="what runs the firmware")


def run_demo(args: argparse.Namespace) -> None:
    """Drive the square, print the tables, draw the picture. Raises DemoFailed if a figure is not the paper's."""
    from mirrormount_sim.demo import demonstrate

    machine = f"{'&' if '?' in args.port else '?'}machine={args.machine}" if args.machine else ""
    demonstrate(args.port + machine, args.output)


COMMANDS = (
    Command("virtual", "serve a virtual board until Ctrl-C", run_virtual, virtual_arguments),
    Command("demo", "the paper's square on a virtual board, measured and drawn", run_demo, demo_arguments),
)
