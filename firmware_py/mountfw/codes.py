"""Numbered errors, the reasons why moves end, and what a reset and a position are: one declaration each. Pure.

The numbers are the wire's. An error of one axis is 100 times the axis plus its number here. TB? sends an error's
message after the number and a comma: no other comma, because clients split the answer there.

The text after a declaration is for people: cause and remedy of an error, the meaning of a reason. A compiler drops
such a text, so it takes no memory of a board; the host and docs/errors.md (`tools/tables.py`) read it here.
"""

MESSAGES = {0: b"NO ERROR DETECTED"}
AXIS_MESSAGES = {}  # of one axis
REASONS = {}  # why a move ended, in words
REASON_ERRORS = {}  # the axis's errors of a reason: in the positive and the negative direction, or one for both


def _error(number, message):
    MESSAGES[number] = message
    return number


def _axis_error(number, message):
    AXIS_MESSAGES[number] = message
    return number


def _reason(number, words, *errors):
    REASONS[number] = words
    if errors:
        REASON_ERRORS[number] = errors
    return number


# ---- errors of the board

NO_SUCH_COMMAND = _error(6, b"COMMAND DOES NOT EXIST")
"""A mnemonic that this firmware does not know, a query of something that cannot be asked, or the setting of something
that can only be asked. ModemManager's `AT` ends here. Nothing moved.

Remedy: Look the command up in [protocol.md](protocol.md). If it comes from ModemManager, install the udev file of
[bring-up.md](bring-up.md).
"""

OUT_OF_RANGE = _error(7, b"PARAMETER OUT OF RANGE")
"""A value outside the command's range, or not a whole number where one is needed. The old value stays.

Remedy: The ranges are in [protocol.md](protocol.md).
"""

NO_SUCH_AXIS = _error(9, b"AXIS NUMBER OUT OF RANGE")
"""An axis other than 1 to 4.

Remedy: A mount has axes 1 (y) and 2 (x); axes 3 and 4 if its board file names them.
"""

AXIS_MISSING = _error(37, b"AXIS NUMBER MISSING")
"""The command needs an axis before it.

Remedy: `1PR5`, not `PR5`.
"""

VALUE_MISSING = _error(38, b"COMMAND PARAMETER MISSING")
"""The command needs a value after it.

Remedy: `1PR5`, not `1PR`.
"""

NO_SUCH_CONTROLLER = _error(48, b"CONTROLLER NUMBER OUT OF RANGE")
"""A line was addressed to another controller than 0 or 1 (`2>1PR5`). Nothing of it was done but `ST` and `AB`.

Remedy: Address 1, or none.
"""

MALFORMED = _error(60, b"MALFORMED INPUT: MOTORS STOPPED")
"""A byte that cannot continue the message (a backspace, too), a message that was never finished, or eight zeros in a
line. It may have been a damaged stop, so both motors were stopped.

Remedy: If it repeats: cable, baud rate, two programs on one port, a frame that is not padded to `sddd sddd`. End
every frame with a line feed. A port in a terminal's default mode returns what the board sends, which stops it, too:
`stty -F PORT raw -echo`, before anything is written to the port.
"""

LINE_TOO_LONG = _error(61, b"LINE TOO LONG: MOTORS STOPPED")
"""A line of more than 128 characters that was good so far.

Remedy: Send it as two lines.
"""

KEEP_ALIVE_LOST = _error(62, b"KEEP-ALIVE LOST: MOTORS STOPPED")
"""A motion had a keep-alive (`XK`) and no byte came for that long: the program died or froze, or the cable is out.

Remedy: Find out why the program fell silent; then just go on.
"""

SETTINGS_DAMAGED = _error(63, b"SETTINGS DAMAGED: DEFAULTS IN USE")
"""What is on the flash does not match its checksum, or is not for this board. Settings are as made, positions
unknown. On CircuitPython also: another program used the non-volatile memory, or the power went while it was written.

Remedy: Set them again (`mirrormount config import` if there is a copy), then `SM`. If it comes back, the flash is
worn or the board is.
"""

INTERNAL_FAULT = _error(64, b"INTERNAL FAULT: MOTORS STOPPED")
"""The firmware's loop raised an exception. It has stopped everything and goes on.

Remedy: Power the board off and on, and report it with the commands that led to it.
"""

ANSWER_DROPPED = _error(65, b"AN ANSWER WAS DROPPED")
"""The host did not read, the board's output buffer was full, and an answer did not fit. Told once until it is read;
never for the echo of a frame.

Remedy: Read the answers, or ask less often.
"""

WATCHDOG_RESET = _error(66, b"FIRMWARE HAD HUNG: BOARD WAS RESET")
"""The loop did not come round for a second (CircuitPython: 4 s), so the watchdog reset the board: motors off, positions
start anew. Queued at the start that follows.

Remedy: Report it with the commands that led to it (`XH?` has the cause 3 then), and what was changed in the firmware.
"""

NOT_SAVED = _error(67, b"COULD NOT BE SAVED")
"""The board's file system is full or read-only. What was to be saved was not; what was there before still is. If a
recorded position could not be taken back, nothing moves: it would be wrong after a power cut. On CircuitPython: the
non-volatile memory refuses, or has no room.

Remedy: Free some space on the board (`mpremote fs ls`), or redeploy; then again.
"""

SETTINGS_LEFT_OUT = _error(69, b"SETTINGS WITHOUT AN AXIS LEFT OUT")
"""The flash has settings that no axis has: of a newer firmware, an encoder or an axis. All others are in use.

Remedy: Put that firmware or board file back, or save what is left (`SM`).
"""

# ---- errors of one axis

NO_POWER_PIN = _error(70, b"NO POWER PIN")
"""`XW?` was asked of a board whose file names no analog input, `POWER`.

Remedy: Connect a photodiode's amplifier (at most 3.3 V) and name its pin in the board file: [signal.md](signal.md).
"""

AXIS_OUT_OF_RANGE = _axis_error(1, b"OUT OF RANGE")
"""A target beyond ±999 999 steps (in counts ±9 999 998, or 250 s of one drive), a move by more, or a run to that edge.

Remedy: Check the number; define a nearer zero with `DH`; go a long way in counts by several moves.
"""

AXIS_POSITIVE_STOP = _axis_error(4, b"POSITIVE END-STOP REACHED")
"""The switch at the positive end is active, or its wire is broken.

Remedy: Drive the other way: that is always allowed. If the mount is not at its end, check the wire: open is active.
"""

AXIS_NEGATIVE_STOP = _axis_error(5, b"NEGATIVE END-STOP REACHED")
"""The switch at the negative end is active, or its wire is broken.

Remedy: As for n04: drive the other way, and check the wire.
"""

AXIS_POSITIVE_SOFT = _axis_error(6, b"POSITIVE SOFT LIMIT")
"""A target beyond `SR`, or a run that has reached it, while `ZH` has bit 3 set. A refused move changes nothing.

Remedy: A nearer target, another `SR`, or `ZH0`.
"""

AXIS_NEGATIVE_SOFT = _axis_error(7, b"NEGATIVE SOFT LIMIT")
"""A target beyond `SL`, or a run that has reached it, while `ZH` has bit 3 set. A refused move changes nothing.

Remedy: A nearer target, another `SL`, or `ZH0`.
"""

AXIS_NOT_CONNECTED = _axis_error(8, b"MOTOR NOT CONNECTED")
"""Motion on axis 3 or 4, which the dialect has and this mount has not; or the axis's motor type was set to 0.

Remedy: Use axis 1 (y) or 2 (x); `QM3` on the axis says that there is a motor.
"""

AXIS_TOO_FAST = _axis_error(10, b"VELOCITY TOO HIGH")
"""More steps per second (`VA`) than pulses of length `XP` fit in. The value is kept; as many are made as are possible.

Remedy: `VA?` says how many. A shorter pulse allows more.
"""

AXIS_MOVING = _axis_error(14, b"MOTION IN PROGRESS")
"""The axis moves, and the command would disturb that.

Remedy: Wait until it is at rest (`MD?` is 1), or stop it.
"""

AXIS_NOT_FITTED = _axis_error(35, b"NOT FITTED OR SWITCHED OFF")
"""A switch was declared fitted for which the board has no input; or a PWM frequency or a decay was set (`XQ`, `XY`)
where it cannot be changed; or a search (`MT`, `OR`) needs a switch that is not fitted (`XL`) or is ignored (`ZH1`); or
a closed loop was asked for, and there is no encoder, or the counts of a step (`XN`) are not set.

Remedy: Say what is fitted, on that axis: `mirrormount setup`, or `mirrormount config set x.switches 3` (`XL`). The
board's file has its inputs. In the closed loop a search may end where the motor stalls: `stall_duty` (`XA`).
"""

AXIS_RUN_LIMIT = _axis_error(40, b"RUN LIMIT REACHED")
"""One run or one frame drove for as long as `XM` allows.

Remedy: Send the next one in time, or raise `XM`.
"""

AXIS_BOTH_STOPS = _axis_error(42, b"BOTH END-STOPS ACTIVE")
"""Both switches of an axis are active at once, which no mount can do: a wire or a plug.

Remedy: Check the switches. `ZH1` on that axis ignores them meanwhile.
"""

AXIS_EMERGENCY_STOP = _axis_error(43, b"EMERGENCY STOP")
"""The emergency stop was pressed, or its wire is broken. Both motors are off and stay off, whatever is commanded.

Remedy: Find out why it was pressed. Close it, then `mirrormount send '*RST'` (`Mount.reset()`): positions start anew.
"""

AXIS_FOLLOWING = _axis_error(44, b"FOLLOWING ERROR")
"""An axis with an encoder was driven for one step's time, and its counts were wrong by more than `FE` allows; or a step
did not come to its counts in three times its time. The motor is off.

Remedy: Is the supply far from what it was when `XN` was measured, or the step's pulse (`XP`) another one, or does the
mount bind? `mirrormount setup` measures `XN` anew; a larger `FE` allows more; `ZH2` on that axis ignores it.
"""

AXIS_NOT_FOUND = _axis_error(45, b"HOMING: SWITCH NOT FOUND")
"""The axis drove for as long as `XT` allows, and no switch opened; or, in a search by stall (`XA`), it met no end.

Remedy: A long way, or a low supply, needs a larger `XT`. With a switch: is it that axis's, on that side, with its wires
on? `PH?` while you press it tells.
"""

AXIS_NOT_RELEASED = _axis_error(46, b"HOMING: SWITCH NOT RELEASED")
"""The axis drove off the switch for 20 steps, or off the one at the other end, and it did not close.

Remedy: A stuck switch or a broken wire; or the motor does not turn, or turns the other way (`XI`).
"""

AXIS_STALLED = _axis_error(47, b"MOTOR STALLED")
"""An axis with an encoder had drive and no count for `XG`: the end of the travel, a hand that holds the shaft, a motor
without power, or a wire of the encoder. The motor is off.

Remedy: Drive the other way. If no count comes there either (`XC?`): the motor's plug, its supply, the encoder's wires.
In the open loop (`mirrormount config set x.closed_loop 0`, or `MM0` on that axis) it goes on without the encoder.
"""

AXIS_WRONG_WAY = _axis_error(48, b"COUNTS THE WRONG WAY")
"""The encoder counted against the drive: its wires A and B or the motor's leads were swapped after `XN` was measured;
or something turns the shaft. The motor is off.

Remedy: `mirrormount setup` measures which way it counts (or change the sign of `XN`), unless the motor turns the wrong
way: then exchange its leads, or `XI`.
"""

AXIS_ENCODER_LOST = _axis_error(49, b"ENCODER LOST")
"""The encoder does not answer, sees no magnet, or its two signals change in a way that no shaft can turn. The motor is
off; the position is an estimate from here on.

Remedy: Its plug and its supply; the distance of the magnet; motor wires close to those of the encoder. In the open loop
(`mirrormount config set x.closed_loop 0`, or `MM0` on that axis) it goes on without the encoder.
"""

AXIS_DEAD_BAND = _axis_error(50, b"DEAD BAND NOT REACHED")
"""Three corrections after a move, and it still stands more than `DB` counts beside its target. The position says where.

Remedy: Send the move again, or a larger `DB`. If it happens often: something pushes the shaft, or `XN` is wrong.
"""

AXIS_RECORD_DIFFERS = _axis_error(51, b"ENCODER DISAGREES WITH THE RECORD")
"""At the start the encoder on the screw stood elsewhere than where the recorded position was: somebody turned the
screw while the board was off. The position is corrected by up to half a turn, and an estimate.

Remedy: Was the knob turned by more than half a turn? Then find a known place and define it (`DH`), or home (`OR`).
"""

# ---- why a move ended

NONE_YET = _reason(0, "none yet")
"""nothing has moved since the board was switched on"""

DONE = _reason(1, "done")
"""all of it was done"""

STOPPED = _reason(2, "stopped")
"""`ST`, eight zeros, a frame of zeros, or malformed input"""

ABORTED = _reason(3, "aborted")
"""`!` or `AB`"""

END_STOP = _reason(4, "end-stop reached", AXIS_POSITIVE_STOP, AXIS_NEGATIVE_STOP)
"""see n04, n05"""

SOFT_LIMIT = _reason(5, "soft limit reached", AXIS_POSITIVE_SOFT, AXIS_NEGATIVE_SOFT)
"""see n06, n07"""

RUN_LIMIT = _reason(6, "run limit reached", AXIS_RUN_LIMIT)
"""see n40, n01"""

KEEP_ALIVE = _reason(7, "keep-alive lost")
"""see 62"""

SUPERSEDED = _reason(8, "superseded by another command")
"""a frame took over"""

FAULT = _reason(9, "fault")
"""see 64, n42"""

EMERGENCY_STOP = _reason(10, "emergency stop", AXIS_EMERGENCY_STOP)
"""see n43"""

CLOSED_LOOP_FAILED = _reason(11, "closed loop failed", AXIS_DEAD_BAND)
"""see n50"""

HOMING_FAILED = _reason(12, "homing failed")
"""see n45, n46, and n04, n05: the switch at the other end"""

STALLED = _reason(13, "motor stalled", AXIS_STALLED)
"""see n47"""

WRONG_WAY = _reason(14, "counts the wrong way", AXIS_WRONG_WAY)
"""see n48"""

FOLLOWING = _reason(15, "following error", AXIS_FOLLOWING)
"""see n44"""

ENCODER_LOST = _reason(16, "encoder lost", AXIS_ENCODER_LOST)
"""see n49"""

# why the board was reset last
POWER = 1  # or its reset pin
ASKED = 2  # by software: deploy, machine.reset()
WATCHDOG = 3

# the port's gate in XH?; 0: it has none, others: not in place (docs/gate.md has the numbers)
GATE_IN_PLACE = 1

# what a position is worth
UNKNOWN = 0
COUNTED = 1
HOMED = 2
ESTIMATED = 3
MEASURED = 4
CERTAINTY = ("unknown", "counted", "homed", "estimated", "measured")  # in words, by number


def message(code):
    """The message (bytes) of error code, without the axis."""
    return MESSAGES[code] if code < 100 else AXIS_MESSAGES[code % 100]
