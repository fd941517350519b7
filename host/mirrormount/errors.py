"""Every error that a person can meet, with its cause and its remedy. A message is one line.

The docstring of an error is its cause and its remedy, in the words of docs/errors.md: the page is made from these
(`python3 tools/tables.py`). The board's numbered errors, with their causes and remedies, are declared in the firmware
(mountfw/codes.py). A compiler drops such a text, so a board does not hold it; it is read here, from the source, when
it is first shown.
"""

import functools
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from mountfw import codes as wire

if TYPE_CHECKING:
    import ast

REASONS = wire.REASONS


class MountError(Exception):
    """Base of all errors that this package raises. codes: the numbers of the board's errors that it is about."""

    codes: tuple[int, ...] = ()
    kinds: ClassVar[list[type["MountError"]]] = []  # all errors of the packages that are imported

    def __init_subclass__(cls) -> None:
        """Note an error where it is declared, so that no list of errors has to be kept."""
        MountError.kinds.append(cls)


class BadAddress(MountError):
    """The port's name is empty, or its form or options are not known.
    Remedy: `mirrormount ports` lists ports; `socket://HOST:PORT` and `virtual://` are the other forms.
    """


class BadValue(MountError, ValueError):
    """A number that no mount could take (text, 256, a fraction of a step). Nothing was sent.
    Remedy: Correct the number. Nothing is rounded or clamped for you.
    """


class NotSupported(MountError):
    """Frames are asked for axes 3 and 4; or the axis has no encoder.
    Remedy: Axes 3 and 4: `jog`. Encoder: name its pins in the board file.
    """


class CannotOpen(MountError):
    """The port could not be opened."""


class NoBoardFound(CannotOpen):
    """No board with a known USB id, and no CircuitPython drive with `mountfw` on it, is there.
    Remedy: Plug it in, try another cable (some only charge), or name its port. `--port virtual://` needs no board.
    """


class SeveralBoardsFound(CannotOpen):
    """More than one is.
    Remedy: Name one with `--port`; for `deploy`, the port or `--drive`.
    """


class PortAbsent(CannotOpen):
    """There is no such port, or nothing listens at that address, or the program that serves the board there has
    lost it.
    Remedy: `mirrormount ports`; plug the board in.
    """


class PortBusy(CannotOpen):
    """Another program has the port open, or drives the served board.
    Remedy: Close it: a serial monitor, an editor's REPL, another panel. The line names the process where the system
    tells it. `mirrormount stop` gets through all the same.
    """


class PermissionDenied(CannotOpen):
    """This user may not open serial ports.
    Remedy: Linux: `sudo usermod -aG dialout $USER` and log in again, or the udev file of
    [bring-up.md](bring-up.md).
    """


class NotAMount(MountError):
    """Something else answers, or nothing does.
    Remedy: Check that it is the right port. A board that hangs: unplug it and plug it in.
    """


class AtPrompt(NotAMount):
    """The board is at its Python prompt: somebody pressed Ctrl-C, or the firmware could not start.
    Remedy: Press Ctrl-D there, or unplug it and plug it in. If it comes back to the prompt, the prompt says why,
    for instance that the board has no board file.
    """


class FirmwareMissing(NotAMount):
    """The board's Python runs, but `mountfw` is not on the board.
    Remedy: `mirrormount deploy`: [bring-up.md](bring-up.md).
    """


class CannotListen(MountError):
    """`mirrormount serve` or `mirrormount panel` cannot listen where it should: the port is in use, or below 1024
    and this user is no administrator.
    Remedy: Another one, as the line says: `--tcp 127.0.0.1:5023` or `--http 8081`.
    """


class AllowNeeded(MountError):
    """`mirrormount serve` or `mirrormount ioc` should listen to more than this computer, and nobody has said who may
    drive the mount; or a board is served that this computer may not drive.
    Remedy: `--allow ADDRESS-OR-NETWORK` where the board is served; `ioc`: `--acf FILE` or `--read-only`. Or serve
    on 127.0.0.1 and go through `ssh -L`: [network.md](network.md).
    """


class ConnectionLost(MountError):
    """The port has gone (cable, power, the program that served it), the board has restarted, or this `Mount` was
    closed (its `with` block has ended). The board's keep-alive stops what was moving.
    Remedy: Plug it in and open it again. Positions start anew after a restart.
    """


class NoAnswer(MountError):
    """The board did not answer in time, or a move did not end when it should have; then a stop has been sent.
    Remedy: Unplug it and plug it in; if it repeats, report it.
    """


class BoardError(MountError):
    """The board refused a command, or reports an error of its own; `code` is its number.
    Remedy: See the error of that number.
    """

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f"the board says {code}: {text.lower()}")
        self.code = code
        self.codes = (code,)


class MoveEnded(MountError):
    """A move ended before it was done; `reason` and `steps` tell how and where.
    Remedy: See the reason, and the error if the line names one.
    """

    def __init__(
        self, axis: str, reason: int, steps: int, wanted: int | None, errors: list[str], codes: tuple[int, ...] = ()
    ) -> None:
        of = f" of {wanted}" if wanted is not None else ""
        because = f" ({'; '.join(errors)})" if errors else ""
        super().__init__(f"{axis}: {REASONS.get(reason, reason)} after {steps}{of} steps{because}")
        self.reason = reason
        self.steps = steps
        self.codes = codes


class SettingRefused(MountError):
    """The board does not take a setting: it moves, or the value does not go with the others (error n10, n35). The
    line names setting and error; all settings are as they were, but for those that the line names.
    Remedy: See the board's error of that number.
    """


class NotCalibrated(MountError):
    """An angle was asked for, and nobody has measured that axis in that direction, or the scale is that of another
    pulse or duty than the board has now; or a camera has no scale.
    Remedy: `mirrormount setup`, for a camera `mirrormount camera scale`, or write the lines that the message names
    into the file ([calibration.md](calibration.md)); or set the pulse and duty of the scale again.
    """


class NotKept(MountError):
    """This computer has no position of that name of this board, or knows of no Zero or change of settings to undo.
    Remedy: `mirrormount keep` lists the positions of a board. What another computer did is not known here.
    """


class PositionDoubtful(MountError):
    """The numbers of a kept position may not mean the same place any more: the board has restarted, or the axis was
    zeroed or homed, or its steps were changed since. Nothing was moved.
    Remedy: `mirrormount undo` if a Zero did it; look at the beam, and `mirrormount back NAME --yes` goes all the same
    ([presets.md](presets.md)).
    """


class BadFile(MountError):
    """A file of settings or of scales is not there, is not TOML, or says what cannot be; the line tells where. It
    was not changed.
    Remedy: Correct it, or move it away: `mirrormount setup` makes new scales, `mirrormount config export` a new
    file of settings.
    """


class ExtraMissing(MountError):
    """A part of mirrormount needs a package that is not installed: the panel needs NiceGUI, the demo Matplotlib.
    Remedy: What the line says: `pip install -e ".[panel]"` or `".[plot]"`, in the copy of the repository.
    """


class NotInControl(MountError):
    """A program asked a supervised mount for a motion without having control: another client has it, or a stop or a
    lost board has ended it. Nothing was sent.
    Remedy: Take control again when the cause is gone; on the panel, press `Take control`.
    """


class NotStoppable(MountError):
    """No stop would get in from outside: the program has as many files open as it may, the thread that takes the
    stops of other programs has ended, or the panel's web server hangs. What moves is stopped, and nothing is begun.
    Remedy: Close what takes so many files (connections, cameras) or allow more (`ulimit -n`); else start the program
    again.
    """


class SupervisorFault(MountError):
    """The program that owns the mount failed. The motors were stopped; it connects to the board again by itself.
    Remedy: Report it, with the traceback in that program's log.
    """


class PanelFault(MountError):
    """The panel's own program failed. The motors were stopped; it connects to the board again by itself.
    Remedy: Report it, with the file that the line in the terminal names.
    """


class EpicsFailed(MountError):
    """EPICS base, on which `mirrormount ioc` runs, does not start: a file of rules that it cannot read, or another
    version of it than was tried.
    Remedy: Correct the file; `pip install "epicscorelibs>=7.0.10,<7.1"`.
    """


class EncoderFault(MountError):
    """An encoder does not count as its motor turns. The motors are off, and nothing was changed.
    Remedy: Its plug, supply and wires ([bring-up.md](bring-up.md)). `config set x.closed_loop 0` goes on without it.
    """


class CheckFailed(MountError):
    """`mirrormount check` found something wrong: each line that begins with FAILED says what, and what to do.
    Remedy: What that line says.
    """


class SetupEnded(MountError):
    """`mirrormount setup` cannot go on: the motors are exchanged, nothing moves, the input has ended, or something
    could not be saved. The line says what was saved and what was not.
    Remedy: What the line says, then `mirrormount setup` again.
    """


class EmulatorMissing(MountError):
    """The machine of a virtual board cannot be started: no MicroPython VM, no Node.js, no `adafruit_motor`, no image
    for an RP2040, or what came in place of the official image is not that image (a portal that wants a login, damage).
    Remedy: The line says what to install, or name an image with `--image FILE`; `--machine cpython` needs nothing.
    """


class DeployError(MountError):
    """The firmware was not put on the board, or not taken off it: a motor moves, no MicroPython is there, the flash
    is full, a `main.py` or `code.py` of somebody else is in the way, or what runs afterwards is not what was sent.
    The line says which. The board has what it had before, unless the line says otherwise.
    Remedy: What the line says. Deploying again repairs a deploy that was cut.
    """


class MpremoteError(DeployError):
    """mpremote, which does the work on the board, failed: the board was unplugged, or another program has its port.
    The line is mpremote's last one.
    Remedy: Deploy again. A board that hangs: unplug it and plug it in.
    """


class FirmwareFailed(DeployError):
    """The new firmware did not answer after a deploy. The line has the last line of its error, and says what the
    board has now: on MicroPython the firmware that was there before, on CircuitPython the new files.
    Remedy: Report the line; with `--pins`, check that file. On CircuitPython deploy another version, or undeploy.
    """


class WrongImage(DeployError):
    """`mirrormount flash`: the image is cut or damaged, is for another chip than the board has, holds no MicroPython or
    one older than 1.22, or has no place for files. Nothing was written.
    Remedy: The image for this board from micropython.org/download, fetched again. A Pico or Pico W (RP2040) and a
    Pico 2 or Pico 2 W (RP2350) take different ones.
    """


class ImageMissing(DeployError):
    """`mirrormount flash` has no image: `--offline` was said, it could not be fetched, what came has not the SHA-256
    that is known here, or for this chip none is known; or esptool is not installed. Nothing was written.
    Remedy: Put the file that the line names where it says, or name an image with `--image FILE`.
    """


class NoBootloader(DeployError):
    """`mirrormount flash`: the board was not sent to its boot loader, because nobody said yes, or it went and its drive
    did not appear. What is on the board is as it was.
    Remedy: Hold BOOTSEL while plugging in, then `mirrormount flash`. Without a desktop the drive has to be mounted:
    `udisksctl mount -b /dev/disk/by-label/RPI-RP2`. To get back to what is on the board, plug it in without BOOTSEL.
    """


class NotSeenAgain(DeployError):
    """`mirrormount flash` has copied the image, the drive has gone, and no new port of a MicroPython board came, or
    several.
    Remedy: Plug the board in again, then `mirrormount deploy PORT` (`mirrormount ports`); or flash it once more.
    """


class WrongDrive(DeployError):
    """The drive is not that of a CircuitPython board (no `boot_out.txt` of CircuitPython, or the drive of a
    bootloader), its CircuitPython is older than 9.1, or it and the port that was named are not of one board. For
    `flash`: it is not that of the boot loader of an RP2040 or RP2350. Nothing was written.
    Remedy: What the line says: install CircuitPython or a newer one, or name the right drive with `--drive`.
    """


class DriveReadOnly(DeployError):
    """The drive cannot be written to: its `boot.py` keeps it for the board (`storage.remount`), the system has
    mounted it read-only, or for another user.
    Remedy: Start the board in safe mode ([circuitpython.md](circuitpython.md)), unplug it and plug it in (a boot
    loader's drive: with BOOTSEL held), or mount it for this user.
    """


class DriveFull(DeployError):
    """The drive has no room for the firmware or the image, counted in whole clusters. The line says whether anything
    was changed.
    Remedy: Remove files of your own from the drive, then deploy again. A boot loader's drive: plug it in again.
    """


class DriveFailed(DeployError):
    """The drive has gone, gives an error, does not give back what was written to it, or (a boot loader's) does not take
    the image. The line says what the board is left with.
    Remedy: Plug it in and deploy again; after `flash` with BOOTSEL held, for the boot loader is in ROM and outlives
    every cut. If it repeats: another cable; then let CircuitPython make the drive anew
    ([circuitpython.md](circuitpython.md)).
    """


class LibraryMissing(DeployError):
    """`adafruit-circuitpython-motor`, two files of which go to a CircuitPython board, is not installed here.
    Remedy: `pip install -e ".[circuitpython]"` in the copy of the repository, or `pip install --no-deps
    adafruit-circuitpython-motor`: its files are copied, not run.
    """


class NotSeenRunning(DeployError):
    """The files are on the drive and were read back, but the board did not answer with the hash of what was sent:
    no port of it was seen, another program has it, or the firmware does not start. The line says which.
    Remedy: Press reset and deploy again: without changes that only asks. If the firmware does not start, its
    console says why.
    """


class CannotWrite(MountError):
    """The demo's picture, or the file of pin edges, of a flash, of settings, scales or a calibration cannot be written:
    no such folder, no room, or a link stands in its place, which is not followed. Standard output, too.
    Remedy: Another place, or room on the disk.
    """


class DemoFailed(MountError):
    """The demo's figures are not the paper's.
    Remedy: On an unchanged copy this is a defect: report it with the table.
    """


@functools.cache
def doc_texts(module: str, maker: str) -> dict[str, str]:
    """{name: text}, in their order, of the declarations in a module of mountfw that a call of maker makes.

    Such a declaration is `NAME = maker(...)`, or `maker(...)` with the name as its first argument that is a str.
    """
    import ast
    import importlib.resources
    import inspect
    import itertools

    source = importlib.resources.files("mountfw").joinpath(f"{module}.py").read_text("utf-8")
    found: dict[str, str] = {}
    for statement, after in itertools.pairwise(ast.parse(source).body):
        name = _declared(statement, maker)
        if name and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            found[name] = inspect.cleandoc(str(after.value.value))
    return found


def _declared(statement: "ast.stmt", maker: str) -> str:
    """The name that a statement declares with a call of maker; "" if it does not."""
    import ast

    match statement:
        case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(func=ast.Name(id=called))):
            return name if called == maker else ""
        case ast.Expr(value=ast.Call(func=ast.Name(id=called), args=arguments)) if called == maker:
            return next(a.value for a in arguments if isinstance(a, ast.Constant) and isinstance(a.value, str))
    return ""


def one_line(text: str) -> str:
    """A text without its line ends."""
    return " ".join(text.split())


def plain_text(markdown: str) -> str:
    """A text without the marks of its links and of code."""
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", markdown).replace("`", "")


class Remedy(NamedTuple):
    """Why it happened, and the remedy."""

    cause: str
    remedy: str


def declared_remedy(text: str) -> Remedy | None:
    """Cause and remedy of a declaration's text, in the Markdown of docs/errors.md; None if it has no remedy."""
    cause, found, remedy = text.partition("Remedy: ")
    return Remedy(one_line(cause), one_line(remedy)) if found else None


@functools.cache
def board_remedies() -> dict[str, Remedy]:
    """{number: Remedy} of the board's numbered errors; "n04" is number 4 of an axis."""
    known: dict[str, Remedy] = {}
    for maker, form in (("_error", "{}"), ("_axis_error", "n{:02d}")):
        for name, text in doc_texts("codes", maker).items():
            remedy = declared_remedy(text)
            if remedy:
                known[form.format(vars(wire)[name])] = remedy
    return known


@functools.cache
def host_remedies() -> dict[str, Remedy]:
    """{name: Remedy} of the errors of the host's packages that are imported, in the order of their declaration."""
    declarations = ((kind.__name__, declared_remedy(kind.__doc__ or "")) for kind in MountError.kinds)
    return {name: remedy for name, remedy in declarations if remedy}


def remedy_of(error: str) -> Remedy | None:
    """Cause and remedy of an error, without marks: by its number on the board ("104" is n04 on axis 1) or its name."""
    of_axis = "n" + error[1:] if len(error) == 3 and error.isdecimal() else ""
    known = board_remedies() | host_remedies()
    found = known.get(error) or known.get(of_axis)
    return Remedy(plain_text(found.cause), plain_text(found.remedy)) if found else None


def explain(codes: Iterable[int]) -> list[str]:
    """Lines with cause and remedy of errors of the board, each of them once."""
    known = [remedy for code in dict.fromkeys(codes) if (remedy := remedy_of(str(code)))]
    return [line for r in known for line in (f"  cause: {r.cause}", f"  remedy: {r.remedy}")]
