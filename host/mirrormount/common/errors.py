"""What can go wrong, as one tree. Each message is one line; docs/errors.md has cause and remedy."""

from mountfw import codes as wire


class MountError(Exception):
    """Whatever this package raises on purpose. codes: the numbers of the board's errors that it is about."""

    codes: tuple[int, ...] = ()


class BadAddress(MountError):
    """The port's address cannot be understood."""


class BadValue(MountError, ValueError):
    """A value that no mount could take; nothing was sent."""


class NotSupported(MountError):
    """The firmware at the other end cannot do this."""


class CannotOpen(MountError):
    """The port could not be opened."""


class NoBoardFound(CannotOpen):
    """No board with a known USB id is plugged in."""


class SeveralBoardsFound(CannotOpen):
    """More than one is: it takes a name."""


class PortAbsent(CannotOpen):
    """There is no such port."""


class PortBusy(CannotOpen):
    """Another program has the port."""


class PermissionDenied(CannotOpen):
    """This user may not open the port."""


class NotAMount(MountError):
    """What answers at the port is not this firmware."""


class AtPrompt(NotAMount):
    """MicroPython answers, with mountfw on board but not running."""


class FirmwareMissing(NotAMount):
    """MicroPython answers, without mountfw."""


class CannotListen(MountError):
    """The board cannot be served at this network address."""


class TokenNeeded(MountError):
    """A network wider than this computer, and no token, or not the right one."""


class ConnectionLost(MountError):
    """The port has gone. The board's keep-alive stops what was moving."""


class NoAnswer(MountError):
    """The board did not answer in time."""


class BoardError(MountError):
    """The board refused, or reports an error of its own. code is its number (docs/errors.md)."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f"the board says {code}: {text.lower()}")
        self.code = code
        self.codes = (code,)


REASONS = {
    wire.NONE_YET: "none yet",
    wire.DONE: "done",
    wire.STOPPED: "stopped",
    wire.ABORTED: "aborted",
    wire.END_STOP: "end-stop reached",
    wire.SOFT_LIMIT: "soft limit reached",
    wire.RUN_LIMIT: "run limit reached",
    wire.KEEP_ALIVE: "keep-alive lost",
    wire.SUPERSEDED: "superseded by another command",
    wire.FAULT: "fault",
    wire.EMERGENCY_STOP: "emergency stop",
    11: "closed loop failed",
    wire.HOMING_FAILED: "homing failed",
}


class MoveEnded(MountError):
    """A move ended before it was done. reason is the board's number, steps what was made of it."""

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
    """The board does not take a setting; all settings are as they were."""


class NotCalibrated(MountError):
    """An angle was asked for, and there is no scale for the step that the board makes now."""


class BadFile(MountError):
    """A file of settings or of scales cannot be read, or says what cannot be."""


class ExtraMissing(MountError):
    """This part of mirrormount needs a package that was not installed with it."""


class NotInControl(MountError):
    """Another client of the mount's supervisor has control, or a stop has ended it; nothing was sent."""


class SupervisorFault(MountError):
    """The program that owns the mount failed; the motors were stopped."""


class PanelFault(MountError):
    """The panel's own program failed; the motors were stopped."""


class CheckFailed(MountError):
    """The self-test found something wrong."""


class SetupEnded(MountError):
    """`mirrormount setup` ended before its end; the message says what was saved."""


class EmulatorMissing(MountError):
    """The rp2040 machine cannot be started: something that it is made of is missing."""


class DeployError(MountError):
    """The firmware was not put on the board, or not taken off it."""


class MpremoteError(DeployError):
    """A call of mpremote failed."""


class FirmwareFailed(DeployError):
    """The new firmware did not answer after a deploy; the message says what the board has now."""


class WrongDrive(DeployError):
    """Not the drive of a CircuitPython board, or its CircuitPython is too old."""


class DriveReadOnly(DeployError):
    """The drive of a CircuitPython board cannot be written to."""


class DriveFull(DeployError):
    """The drive of a CircuitPython board has no room for the firmware."""


class DriveFailed(DeployError):
    """The drive of a CircuitPython board has gone, or does not keep what is written to it."""


class LibraryMissing(DeployError):
    """Adafruit's motor library, which goes to CircuitPython boards, is not installed."""


class NotSeenRunning(DeployError):
    """The files are on the drive, but the board was not heard to run them."""


class CannotWrite(MountError):
    """A file could not be written."""


class DemoFailed(MountError):
    """The demo's figures are not the paper's."""
