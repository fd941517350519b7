"""`mirrormount virtual`: a virtual board for any client, by virtual_board.py."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, profile_options


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, what it keeps, and where clients reach it."""
    parser.add_argument(
        "--machine",
        choices=("cpython", "micropython", "rp2040", "circuitpython"),
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
    parser.add_argument(
        "--no-flash-cache",
        dest="flash_cache",
        action="store_false",
        help="rp2040: make all of the flash as fast as RAM (a real board's is slower)",
    )
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
    parser.add_argument(
        "--truth", type=Path, metavar="FILE", help="write the screws' true turns to FILE at each end of a motion"
    )
    parser.add_argument("--speed", choices=("1", "max"), default="1", help="max is for virtual://?speed=max only")


def run(args: argparse.Namespace) -> None:
    """Serve the board until a signal ends it. Raises MountError."""
    from mirrormount.cli.virtual_board import serve_board

    serve_board(args)


COMMANDS = (Command("virtual", "serve a virtual board until Ctrl-C", run, arguments),)
