"""`mirrormount align --signal SOURCE`: bring the power of a fibre, or another signal, to its maximum."""

import argparse
import contextlib
from collections.abc import Callable, Iterator

from mirrormount.cli.arguments import camera_settings, patience_of, positive, virtual_address, whole
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue
from mirrormount.terminal import ended_in_order
from mirrormount.values import did_you_mean
from mirrormount_beam.cli.hold import check_numbers, told, virtual_table, write_numbers
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.control.maximise import Maximum, maximise
from mirrormount_beam.signals import Source, open_signal
from mirrormount_beam.table import Table, answer

Opened = Iterator[tuple[LoopTable, Source]]


def run_signal(args: argparse.Namespace) -> int:
    """Maximise; the exit status: 0 only if the maximum was reached. Raises MountError."""
    limit, baud = positive(args.limit, "--limit"), whole(args.baud, "--baud")
    check_numbers(args.json)
    found = Maximum()
    with ended_in_order(), contextlib.ExitStack() as stack:
        table, source = stack.enter_context(_virtual(args) if args.virtual else _real(args, baud))
        axes = _axes(args.axes, [actuator.name for actuator in table.actuators])
        tell = stack.enter_context(told(args, None))
        print(f"maximising {source.name} by {', '.join(axes)}, each at most {limit:g} steps from where it is")
        try:
            maximise(table, source.read, tell, axes=axes, limit_steps=limit, full_scale=source.full_scale, found=found)
        finally:
            if found.pulses:
                _tell(found, limit)
                write_numbers(args.json, found.to_json())
    return 0 if found.reached else 1


def _axes(text: str | None, names: list[str]) -> list[str]:
    """Those that are asked for. Raises BadValue."""
    asked = [name.strip() for name in text.split(",")] if text else names
    for name in asked:
        if name not in names:
            raise BadValue(f"--axes: there is no {name!r}; there are {', '.join(names)}{did_you_mean(name, names)}")
    return asked


def _tell(found: Maximum, limit: float) -> None:
    goal = "at its maximum" if found.reached else "NOT at its maximum"
    print(
        f"{goal}: the signal was {found.begin:.4g} at the begin, {found.best:.4g} at best, {found.end:.4g} at the end;"
        f" {found.pulses} pulses in {found.seconds:.0f} s"
    )
    print("ways by the motors' drive: " + ", ".join(f"{name} {way:+.2f} steps" for name, way in found.ways.items()))
    if found.bounded:
        print(f"{', '.join(found.bounded)}: came to the limit of {limit:g} steps (--limit)")


@contextlib.contextmanager
def _virtual(args: argparse.Namespace) -> Opened:
    """The virtual table with its fibre."""
    args.cameras = args.cameras or "2"
    with virtual_table(args) as (loop, table, mounts):
        first = next(iter(mounts.values()))
        if args.signal == "fibre":
            yield loop, Source("fibre", table.power)
        elif args.signal == "board":
            table.connect_fibre()

            def read(_name: str, question: Callable[[Mount], int]) -> int:
                return question(first)

            with open_signal("board", read, camera_settings(args), args.query) as source:
                yield loop, source
        else:
            raise BadValue("--signal of the virtual table is fibre, or board: the fibre at the first board's input")


@contextlib.contextmanager
def _real(args: argparse.Namespace, baud: int) -> Opened:
    """The mounts of the table's file, and the source."""
    virtual_address(args)  # --profile without --virtual is an error
    if args.signal == "fibre":
        raise BadValue("--signal fibre is the virtual table's: add --virtual")
    with Table.open(patience_of(args), with_cameras=False) as table, table.loop("align --signal") as loop:

        def ask(name: str, question: Callable[[Mount], int]) -> int:
            names = list(table.supervisors)
            if name and name not in names:
                there = f"{', '.join(names)}{did_you_mean(name, names)}"
                raise BadValue(f"--signal board:{name}: there is no such mount; there are {there}")
            return answer(table.supervisors[name or names[0]].ask(question))

        with open_signal(args.signal, ask, camera_settings(args), args.query, baud) as source:
            loop.take_control()
            yield loop, source
