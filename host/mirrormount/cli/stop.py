"""`mirrormount stop`: both motors off, also when another program has the port."""

from mirrormount.common.errors import MountError, NoAnswer, NoBoardFound, PortBusy
from mirrormount.device.mount import Mount
from mirrormount.transport import stop_socket
from mirrormount.transport.stop_socket import STOPPED


def run(address: str | None) -> None:
    """Stop the mount at address; without one, every mount that this user has open, and the one that is plugged in.

    Raises MountError if one of them did not stop, or cannot be known to have; the others are stopped all the same.
    With several of those, the message has all of them.
    """
    owners = stop_socket.owners(address)
    problems: list[MountError] = []
    if not address and (why := stop_socket.why_none()):
        problems.append(NoAnswer(f"no program that has a port open can be asked for a stop: {why}"))
    for owner, answer in zip(owners, stop_socket.ask_all(owners), strict=True):
        if isinstance(answer, MountError):
            problems.append(answer)
        else:
            how = "stopped" if answer == STOPPED else "stop sent; the board was too busy to confirm it"
            print(f"{how} (by {owner}, which has the port)")
    if not owners or address is None:
        try:
            Mount.open(address).close()  # opening stops, and says so if it could not
        except PortBusy as e:
            why = stop_socket.why_none() or "without --port it goes to every program of this user that takes one"
            how = "" if address is None else f": {why}"
            problems.append(PortBusy(f"{e}; that program takes no stop from here{how}"))
        except MountError as e:
            if not owners or not isinstance(e, NoBoardFound):
                problems.append(e)
        else:
            print("stopped")
    if len(problems) > 1:
        raise MountError("; ".join(str(problem) for problem in problems))
    if problems:
        raise problems[0]
