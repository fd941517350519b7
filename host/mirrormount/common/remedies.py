"""Cause and remedy of the errors that shell and panel show: the sentences of docs/errors.md, held to it by a test."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Remedy:
    """Why it happened, and what to do."""

    cause: str
    remedy: str


REMEDIES = {
    "6": Remedy(
        "A mnemonic that this firmware does not know, a query of something that cannot be asked, or the "
        "setting of something that can only be asked. ModemManager's AT ends here. Nothing moved.",
        "Look the command up in protocol.md. If it comes from ModemManager, install the udev file of bring-up.md.",
    ),
    "7": Remedy(
        "A value outside the command's range, or not a whole number where one is needed. The old value stays.",
        "The ranges are in protocol.md.",
    ),
    "9": Remedy(
        "An axis other than 1 to 4.",
        "This mount has axes 1 (y) and 2 (x).",
    ),
    "37": Remedy(
        "The command needs an axis before it.",
        "1PR5, not PR5.",
    ),
    "38": Remedy(
        "The command needs a value after it.",
        "1PR5, not 1PR.",
    ),
    "48": Remedy(
        "A line was addressed to another controller than 0 or 1 (2>1PR5). Nothing of it was done but ST and AB.",
        "Address 1, or none.",
    ),
    "60": Remedy(
        "A byte that cannot continue the message (a backspace, too), a message that was never finished, or eight "
        "zeros in a line. It may have been a damaged stop, so both motors were stopped.",
        "If it repeats: cable, baud rate, two programs on one port, a frame that is not padded to sddd sddd. "
        "End every frame with a line feed.",
    ),
    "61": Remedy(
        "A line of more than 128 characters that was good so far.",
        "Send it as two lines.",
    ),
    "62": Remedy(
        "Something moved under a keep-alive (XK) and no byte came for that long: the program died or froze, "
        "or the cable is out.",
        "Find out why the program fell silent; then just go on.",
    ),
    "63": Remedy(
        "What is on the flash does not match its checksum, or is not for this board. Settings are as made, "
        "positions unknown. On CircuitPython also: another program had its own in the non-volatile memory, or "
        "the power went while that was written anew.",
        "Set them again (mirrormount config import if there is a copy), then SM. If it comes back, the flash "
        "is worn or the board is.",
    ),
    "64": Remedy(
        "The firmware's loop raised an exception. It has stopped everything and goes on.",
        "Power the board off and on, and report it with the commands that led to it.",
    ),
    "65": Remedy(
        "The host did not read, the board's output buffer was full, and an answer did not fit. Told once "
        "until it is read; never for the echo of a frame.",
        "Read the answers, or ask less often.",
    ),
    "66": Remedy(
        "The loop did not come round for a second, so the watchdog reset the board: motors off, positions "
        "start anew. Queued at the start that follows.",
        "Report it with the commands that led to it (XH? ends in 3 then). If it repeats, look at what was "
        "changed in the firmware last.",
    ),
    "67": Remedy(
        "The board's file system is full or read-only. What was to be saved was not; what was there before "
        "still is. If a recorded position could not be taken back, nothing moves: it would be wrong after a "
        "power cut. On CircuitPython: the non-volatile memory refuses, or has no room.",
        "Free some space on the board (mpremote fs ls), or redeploy; then again.",
    ),
    "68": Remedy(
        "What the board had just sent came back to it: the port is in a terminal's default mode and echoes. The "
        "reply to a frame is that frame, so it would have driven again; both motors were stopped, and frames get "
        "no reply for a second.",
        "stty -F PORT raw -echo before anything is written to the port, or use a program that opens it raw "
        "(mirrormount does). On a port that does not echo: a frame was followed by its own first number alone on "
        "a line.",
    ),
    "n01": Remedy(
        "A target beyond ±1 000 000 steps, or a run that reached the edge of what can be counted.",
        "Check the number; define a nearer zero with DH.",
    ),
    "n04": Remedy(
        "The switch at the positive end is active, or its wire is broken.",
        "Drive the other way: that is always allowed. If the mount is not at its end, check the wire: an open "
        "circuit reads as active.",
    ),
    "n05": Remedy(
        "The switch at the negative end is active, or its wire is broken.",
        "As for n04: drive the other way, and check the wire.",
    ),
    "n06": Remedy(
        "A target beyond SR, or a run that has reached it, while ZH has bit 3 set. A refused move changes nothing.",
        "A nearer target, another SR, or ZH0.",
    ),
    "n07": Remedy(
        "A target beyond SL, or a run that has reached it, while ZH has bit 3 set. A refused move changes nothing.",
        "A nearer target, another SL, or ZH0.",
    ),
    "n08": Remedy(
        "Motion on axis 3 or 4, which the dialect has and this mount has not; or the axis's motor type was set to 0.",
        "Use axis 1 (y) or 2 (x); QM3 on the axis says that there is a motor.",
    ),
    "n10": Remedy(
        "More steps per second were asked for (VA) than pulses of length XP fit in. The value is kept, and the axis "
        "makes as many as are possible.",
        "VA? says how many. A shorter pulse allows more.",
    ),
    "n14": Remedy(
        "The axis moves, and the command would disturb that.",
        "Wait for MD? to be 1, or stop it.",
    ),
    "n35": Remedy(
        "A switch was declared fitted for which the board has no input; or a search (MT, OR) needs a switch that is "
        "not fitted (XL) or is ignored (ZH1); or a closed loop was asked for, and there is no encoder.",
        "Say what is fitted: mirrormount setup, or mirrormount config set x.switches 3 (XL). See the board's file "
        "in mountfw/boards for its inputs.",
    ),
    "n40": Remedy(
        "One run or one frame drove for as long as XM allows.",
        "Send the next one in time, or raise XM.",
    ),
    "n42": Remedy(
        "Both switches of an axis are active at once, which no mount can do: a wire or a plug.",
        "Check the switches. ZH1 on that axis ignores them meanwhile.",
    ),
    "n43": Remedy(
        "The emergency stop was pressed, or its wire is broken. Both motors are off and stay off, whatever is "
        "commanded.",
        "Find out why it was pressed. Close it, then mirrormount send '*RST' (Mount.reset()): the positions "
        "start anew.",
    ),
    "n45": Remedy(
        "The axis drove for as long as XT allows, and no switch opened.",
        "Is it that axis's switch, on that side, with its wires on? PH? while you press it tells. A long way "
        "needs a larger XT.",
    ),
    "n46": Remedy(
        "The axis drove off the switch for 20 steps, or off the one at the other end, and it did not close.",
        "A stuck switch or a broken wire; or the motor does not turn, or turns the other way (XI).",
    ),
    "NoBoardFound": Remedy(
        "No board with a known USB id, and no CircuitPython drive with mountfw on it, is there.",
        "Plug it in, try another cable (some only charge), or name its port. --port virtual:// needs no board.",
    ),
    "PortAbsent": Remedy(
        "There is no such port, or nothing listens at that address, or the program that serves the board "
        "there has lost it.",
        "mirrormount ports; plug the board in.",
    ),
    "PortBusy": Remedy(
        "Another program has the port open, or drives the served board.",
        "Close it: a serial monitor, an editor's REPL, another panel. The line names the process where the system "
        "tells it. mirrormount stop gets through all the same.",
    ),
    "NotAMount": Remedy(
        "Something else answers, or nothing does.",
        "Check that it is the right port. A board that hangs: unplug it and plug it in. An Arduino with the "
        "paper's sketch: --sketch.",
    ),
    "AtPrompt": Remedy(
        "The board is at its Python prompt: somebody pressed Ctrl-C, or the firmware could not start.",
        "Press Ctrl-D there, or unplug it and plug it in. If it comes back to the prompt, the prompt says "
        "why, for instance that the board has no board file.",
    ),
    "FirmwareMissing": Remedy(
        "The board's Python runs, but mountfw is not on the board.",
        "mirrormount deploy: bring-up.md.",
    ),
    "ConnectionLost": Remedy(
        "The port has gone (cable, power, the program that served it), the board has restarted, or this Mount "
        "was closed (its with block has ended). The board's keep-alive stops what was moving.",
        "Plug it in and open it again. Positions start anew after a restart.",
    ),
    "NoAnswer": Remedy(
        "The board did not answer in time, or a move did not end when it should have; then a stop has been sent.",
        "Unplug it and plug it in; if it repeats, report it.",
    ),
    "NotInControl": Remedy(
        "A program asked a supervised mount for a motion without having control: another client has it, or a stop"
        " or a lost board has ended it. Nothing was sent.",
        "Take control again when the cause is gone; on the panel, press Take control.",
    ),
    "SupervisorFault": Remedy(
        "The program that owns the mount failed. The motors were stopped; it connects to the board again by itself.",
        "Report it, with the traceback in that program's log.",
    ),
    "PanelFault": Remedy(
        "The panel's own program failed. The motors were stopped; it connects to the board again by itself.",
        "Report it, with the file that the line in the terminal names.",
    ),
}


def remedy_of(error: str) -> Remedy | None:
    """Cause and remedy of an error, by its number on the board ("104" is n04 on axis 1) or its type on the host."""
    return REMEDIES.get(error) or REMEDIES.get("n" + error[1:] if len(error) == 3 and error[0] in "12" else "")


def explain(codes: Iterable[int]) -> list[str]:
    """Lines with cause and remedy of errors of the board, each of them once."""
    known = [remedy for code in dict.fromkeys(codes) if (remedy := remedy_of(str(code)))]
    return [line for r in known for line in (f"  cause: {r.cause}", f"  remedy: {r.remedy}")]
