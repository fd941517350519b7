"""After a deploy on a MicroPython board: the new firmware must answer, else the files that were there come back."""

import contextlib
import re
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from mirrormount.common.errors import CannotOpen, ConnectionLost, DeployError, FirmwareFailed, MountError, NoAnswer
from mirrormount.common.printable import printable
from mirrormount.common.progress import Progress
from mirrormount.deploy import prompt
from mirrormount.deploy.handshake import ask, check
from mirrormount.deploy.mpremote import Mpremote
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port

_BACK_S = 60.0  # how long a board may take to come back from its reset: about 1 s, an emulated one more
_START_S = 15.0  # how long a firmware that fails may take to fail
_BANNER = re.compile(r"^(MicroPython |Type \"help|>>>|Adafruit CircuitPython )", re.MULTILINE)


@dataclass(frozen=True)
class Before:
    """What a board had before a deploy."""

    has_main: bool
    main_is_ours: bool


def before(there: Mapping) -> Before:
    """From a board's survey."""
    main = there["files"].get("main.py")
    return Before(main is not None, main is not None and main == there["manifest"].get("main.py"))


def try_it(board: Mpremote, port: str, wanted: Collection[str], had: Before, progress: Progress) -> tuple[str, int]:
    """Wait for what was deployed; when it does not answer, have back what was there before.

    wanted: what XF? may answer. Returns "board, mountfw version" and its number of axes. Raises FirmwareFailed.
    """
    try:
        return come_back(port, wanted)
    except DeployError as e:
        why = str(e)
    progress.phase(f"{why}; putting back the files that were there")
    raise FirmwareFailed(f"{why}; {_put_back(board, port, had)}")


def settle(board: Mpremote, port: str, wanted: Collection[str]) -> str:
    """The new firmware has answered: remove what was kept of the one before. Returns "", or what is to be told.

    Raises FirmwareFailed.
    """
    try:
        with board.reset_if_interrupted():
            board.forget()
        told = ""
    except DeployError as e:
        told = f"; the files of the firmware before could not be removed yet ({e}): the next deploy does it"
        with contextlib.suppress(MountError):
            board.reset()
    try:
        come_back(port, wanted)
    except DeployError as e:
        raise FirmwareFailed(f"the new firmware has answered once, and not after its next restart: {e}") from e
    return told


def _put_back(board: Mpremote, port: str, had: Before) -> str:
    """Bring back the files, and tell what the board has now."""
    try:
        with board.reset_if_interrupted():
            done = board.revert()
    except DeployError as e:
        return f"the files that were there are kept on the board, but could not be put back ({e}): deploy again"
    if not done:
        return "nothing was changed by this deploy, so there is nothing to put back"
    if not had.has_main:
        return "it was taken off again: the board has no main.py, as before"
    if not had.main_is_ours:
        return "it was taken off again: the main.py that was there before is back"
    try:
        come_back(port, None)
    except DeployError as e:
        return f"the firmware that was there before is back, but does not answer either ({e})"
    return "the firmware that was there before is back and answers"


def come_back(port: str, wanted: Collection[str] | None) -> tuple[str, int]:
    """Wait for the board to answer as a mount again. Returns "board, mountfw version" and its number of axes.

    wanted: what XF? may answer; None: anything. Its port may go and come back meanwhile. Raises DeployError.
    """
    end = time.monotonic() + _BACK_S
    why = "does not answer"
    while time.monotonic() < end:
        try:
            link = Link(open_port(port))
        except CannotOpen:
            time.sleep(0.05)
            continue
        try:
            link.drain(0.1)
            heard = ask(link, b"*IDN?\n")
            if heard.startswith("mirrormount,"):
                _, name, _, version = (heard.splitlines()[0] + ",,,").split(",")[:4]
                # that may be the answer to an earlier question, so ask another; an older firmware may not know it
                axes = check(link, wanted)[0] if wanted is not None else 0
                return printable(f"{name}, mountfw {version.strip()}"), axes
            if prompt.SIGN.decode() in heard:
                said = _last_words(link)
                if said is not None:
                    why = f"does not start; it says: {said}" if said else "does not start, and does not say why"
                    break
        except (ConnectionLost, NoAnswer):
            continue
        finally:
            link.close()
    raise DeployError(f"the firmware on the board {why}")


def _last_words(link: Link) -> str | None:
    """Start the program once more at a prompt, to read why it ends: the last line before the prompt that follows.

    None if no prompt follows: it may have started this time.
    """
    prompt.run_again(link)
    heard = b""
    end = time.monotonic() + _START_S
    while time.monotonic() < end:
        heard += link.drain(0.02, 0.2)
        started = heard.partition(b"soft reboot")[2]
        if started.rstrip().endswith(prompt.SIGN):
            text = _BANNER.split(started.decode("utf-8", "replace").replace("\r\n", "\n"))[0]
            lines = [line.strip() for line in text.splitlines() if line.strip()]
            return printable(lines[-1]) if lines else ""
        if not started and len(heard) > 1 << 16:
            return ""
    return None
