"""The mounts of `mirrormount panel`: those of table.toml, or two virtual ones. One that is not there is looked for."""

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial

from mirrormount.cli.command import virtual_address
from mirrormount.common.errors import NoBoardFound
from mirrormount.device.table_file import MountEntry
from mirrormount.supervise.of_table import supervised
from mirrormount.supervise.supervisor import Supervisor
from mirrormount.supervise.worker import Worker
from mirrormount.transport.port import Port


def of_table(entries: Mapping[str, MountEntry], patience_s: float) -> dict[str, Supervisor]:
    """A supervisor for each board, not open yet, under the names of its mounts."""
    names: dict[Supervisor, list[str]] = {}
    for name, (supervisor, _) in supervised(entries, patience_s).items():
        names.setdefault(supervisor, []).append(name)
    return {" and ".join(of_board): supervisor for supervisor, of_board in names.items()}


@contextlib.contextmanager
def virtual(args: argparse.Namespace, patience_s: float) -> Iterator[dict[str, Supervisor]]:
    """Two mounts of a virtual table. Raises BadValue."""
    from mirrormount.virtual.table import VirtualTable, open_table

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
