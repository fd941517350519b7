"""The settings of an axis: one declaration each, and the form of the file that keeps them. Imports nothing of ours.

Everything that lists settings reads this file: the axis (its attributes and their defaults), the command set, the
store, the host's names and ranges, `mirrormount config`, the panel and docs/protocol.md, which
`.venv/bin/python tools/tables.py` writes.

The text after a declaration is for people: `group: words with the unit` (the settings of a group stand together; the
words have at most 59 characters), and below it what else protocol.md says.
A compiler drops such a text, so it takes no memory of a board; the host reads it from this source.
"""

# a Settings is a part of an axis
# pyright: reportAttributeAccessIssue=false
from binascii import crc32

MAX_STEPS = 999_999  # either way: `-1000000` would be a frame if it came back (wire/replies.py)
_REST_US = 1_000  # least rest after a pulse

# flags of a setting
HUNDREDTHS = 1  # kept in hundredths; the wire and the host have two decimals
BITS = 2  # a sum of bits: any of those in its greatest value; a switch, 0 or 1, is one
AT_REST = 4  # refused (n14) while the axis moves; other changes count from the next move on
# Only an axis with an encoder has it. On another axis its query says 0, and anything but 0 is refused with n35.
OF_ENCODER = 8
FROM_20 = 16  # 0, or 20 at least

SETTINGS = []  # (mnemonic, name, least, most, default, flags), as they are to be set: limits follow the direction
ENCODER_SETTINGS = []  # the same, those with OF_ENCODER; a closed loop needs counts of a step, so these come first


def _setting(mnemonic, name, least, most, default, flags=0):
    entries = ENCODER_SETTINGS if flags & OF_ENCODER else SETTINGS
    entries.append((mnemonic, name, least, most, default, flags))


_setting(b"XI", "inverted", 0, 1, 0, BITS | AT_REST)
"""Wiring: 1: the axis runs the other way

The spot stays where it is, so the position changes sign, and so do the soft limits.
"""

_setting(b"XL", "switches", 0, 7, 0, AT_REST)
"""Wiring: switches fitted: 1 positive + 2 negative + 4 home

Bit 0 is at the input named `stop_pos` in the board file, bit 1 at `stop_neg`; others are not read. Bit 2, a home
switch, is refused with n35: no board has one.
"""

_setting(b"QM", "motor_type", 0, 3, 3, AT_REST)
"""Wiring: 3: DC motor connected, 0: none

Lines that would move an axis without a motor are refused with n08.
"""

_setting(b"XP", "pulse_us", 200, 2_000_000, 200_000, AT_REST)
"""Pulse and speed: length of a step's pulse, us"""

_setting(b"XD", "step_duty", 1, 255, 255)
"""Pulse and speed: duty of a step, 1 … 255"""

_setting(b"VA", "velocity", 1, 200_000, 200, HUNDREDTHS)
"""Pulse and speed: steps per second

More than the pulses fit in is kept, with n10, and the axis makes as many as are possible: 1/(`XP` + 1 ms), rounded
down to a whole number if that is not 0. `VA?` answers the possible velocity
([why](design.md#smaller-ones-in-a-line-each)).
"""

_setting(b"AC", "acceleration", 1, 200_000, 100_000)
"""Pulse and speed: kept for other programs; pulses do not ramp"""

_setting(b"XV", "run_duty", 1, 255, 255)
"""Pulse and speed: duty of a run, 1 … 255"""

_setting(b"XJ", "start_duty", 0, 255, 0)
"""Pulse and speed: least duty that starts the motor; 0: not measured

`mirrormount setup` measures it. Nothing is changed by it: a run below it is made, and the host warns.
"""

_setting(b"XQ", "pwm_hz", 0, 20_000, 0, AT_REST | FROM_20)
"""Pulse and speed: PWM frequency, Hz; 0: the board file's

At a low duty a motor starts better at a low frequency. 1 to 19 are refused with 7. A new duty of a drive under way
shows when the running period is over. A board that cannot change it refuses all but 0 with n35
([which](bring-up.md#pwm-frequency-and-decay)).
"""

_setting(b"XY", "slow_decay", 0, 1, 0, BITS | AT_REST)
"""Pulse and speed: 1: slow decay, brakes in the PWM's pauses

0: fast decay, the motor coasts in them. At duty 255 there are no pauses, and at the end of a drive it coasts in either.
Refused as `XQ` is.
"""

_setting(b"XB", "take_up_us", 0, 2_000_000, 0)
"""Take-up: drive that takes up the backlash, us; 0: off

After a change of direction the motor turns so long, at duty `XD`, before the mirror does. Not counted as steps.
"""

_setting(b"ZH", "checking", 0, 1 | 2 | 8, 0, BITS | AT_REST)
"""Limits: 1 ignores end-stops + 8 checks soft limits

Bit 1 (2) ignores the following error of an axis with an encoder. Other bits are refused with 7.
"""

_setting(b"SL", "soft_minimum", -MAX_STEPS, MAX_STEPS, -MAX_STEPS)
"""Limits: negative soft limit, steps

Checked if `ZH` has bit 3: a target beyond it is refused (n07), a run ends at it (reason 5), the time through the
backlash included. In the closed loop the encoder tells where the run is: it is looked at each 10 ms, and then the motor
coasts.
"""

_setting(b"SR", "soft_maximum", -MAX_STEPS, MAX_STEPS, MAX_STEPS)
"""Limits: positive soft limit, steps

As `SL`; the error is n06.
"""

_setting(b"XM", "run_limit_ms", 1, 400_000, 10_000)
"""Limits: longest run, ms

One run or one frame drives no longer.
"""

_setting(b"XT", "search_limit_ms", 1, 400_000, 120_000)
"""Limits: longest search for a switch or an end, ms of drive

Of `MT` and `OR`. `PR` and `PA` have no limit of time: their steps bound them, and the soft limits.
"""

_setting(b"XN", "counts_per_step", -10_000, 10_000, 0, OF_ENCODER | AT_REST)
"""Encoder: counts of one step; 0: not measured

Negative: the encoder counts down while the motor runs in its own positive direction (whatever `XI` is). `mirrormount
setup` measures both. 0 ends the closed loop.
"""

_setting(b"MM", "closed_loop", 0, 1, 0, OF_ENCODER | BITS | AT_REST)
"""Encoder: 1: closed loop, the position is measured; 0: open loop

1 is refused with n35 while `XN` is 0. 0: steps are timed and counted as if there were no encoder: the way to go on
without one that has failed.
"""

_setting(b"DB", "dead_band", 0, 10_000, 1, OF_ENCODER)
"""Encoder: counts that a move may end beside its target

More than that are corrected, at most three times. With an AS5600 a move may end a sixteenth of a step too far: back
through the play of the gears the motor cannot go by less.
"""

_setting(b"CL", "correction_s", 0, 1000, 5, OF_ENCODER | HUNDREDTHS)
"""Encoder: rest before a move's end is judged, s

After its last pulse, and after each correction: the motor coasts for some hundredths of a second.
"""

_setting(b"FE", "following_error", 0, 10_000, 0, OF_ENCODER)
"""Encoder: counts that a step's drive may be wrong by

Looked at each `XP` of drive at duty `XD`, in any motion of the closed loop. 0: three quarters of `XN`. `ZH` with bit 1
(2) ignores it. With an `XP` of 60 ms or less only too few counts are wrong: in it the motor is still gaining speed.
"""

_setting(b"XG", "stall_ms", 0, 1000, 60, OF_ENCODER)
"""Encoder: drive without a count that ends a move, ms

0: not checked.
"""

_setting(b"XA", "stall_duty", 0, 255, 0, OF_ENCODER)
"""Encoder: duty of a search for the end by stall; 0: off

At most 100 where the motor gets the whole 6 V: more may break the gears, and the host warns.
Where no switch is fitted in that direction, `MT` and `OR` then run so until the motor stalls, off it, and again. They
are refused with n35 where a stall is not checked (`XG0` or `ZZ1`).
"""

_setting(b"XZ", "zero_angle", 0, 4096, 0, OF_ENCODER | AT_REST)
"""Encoder: an AS5600's angle at position 0, 1 … 4096; 0: none

`DH` and homing set it in the closed loop; `SM` saves it. After a power cut in a motion, when there is no record, the
position is then the one within half a turn of the screw from 0, and an estimate.
"""


class Settings:
    """The settings as attributes of an axis, which has a position, two end-stops, and an apply() that is called after a
    change.

    The annotations are for type checkers: a compiler drops them.
    """

    # attributes: made by tools/tables.py
    inverted: int
    switches: int
    motor_type: int
    pulse_us: int
    step_duty: int
    velocity: int
    acceleration: int
    run_duty: int
    start_duty: int
    pwm_hz: int
    slow_decay: int
    take_up_us: int
    checking: int
    soft_minimum: int
    soft_maximum: int
    run_limit_ms: int
    search_limit_ms: int
    # end

    def load(self, values):
        """Reset to defaults, then apply these (name, value) pairs."""
        inverted = self.inverted
        for entry in SETTINGS:
            setattr(self, entry[1], entry[4])
        for name, value in values:
            setattr(self, name, value)
        if self.inverted != inverted:
            self.position.mirror()
        self.apply()

    def set(self, name, value):
        """Change the setting of this name to an allowed value."""
        if name == "inverted" and value != self.inverted:
            self.position.mirror()  # and the soft limits stay where they are
            self.soft_minimum, self.soft_maximum = -self.soft_maximum, -self.soft_minimum
        setattr(self, name, value)
        self.apply()

    def has_parts_for(self, name, value):
        """False if the setting of this name needs what the board has not: a switch's input, a PWM that can change."""
        if name == "switches":
            return not value & ~(self.positive_stop.has_input | self.negative_stop.has_input << 1)
        return not value or self.drive.bridge.made_hz > 0 or (name != "pwm_hz" and name != "slow_decay")

    def possible_velocity(self):
        """Hundredths of a step per second: `velocity`, or less if that leaves no room for pulses and rests.

        Then rounded down to whole steps if it is one at least: drivers of the dialect read whole numbers.
        """
        most = 100_000_000 // (self.pulse_us + _REST_US)
        if self.velocity <= most:
            return self.velocity
        return most // 100 * 100 or most


def entries_of(axis):
    """The settings that an axis has: these, and with an encoder those of ENCODER_SETTINGS."""
    return getattr(axis, "entries", SETTINGS)


def named(name, entries=SETTINGS):
    """The setting of this name, as in SETTINGS; None if there is none."""
    for entry in entries:
        if entry[1] == name:
            return entry
    return None


def allowed(entry, value):
    """True if this setting (an item of SETTINGS) may have this value."""
    if entry[5] & FROM_20 and 0 < value < 20:
        return False
    return entry[2] <= value <= entry[3] and not (entry[5] & BITS and value & ~entry[3])


# ---- the file that keeps them on a board, which `mirrormount flash` can make, too

FILE = "mountfw.settings"


def saved_line(number, name, value):
    """The line of a setting of axis `number`."""
    return "%d %s %d\n" % (number, name, value)


def seal(text):
    """Text as the bytes of a file: a checksum is its last line."""
    data = text.encode()
    return data + b"%08x\n" % (crc32(data) & 0xFFFFFFFF)


def unseal(data):
    """The lines of such a file; None if it is damaged."""
    text = data[:-9]
    if len(data) < 9 or data[-9:] != b"%08x\n" % (crc32(text) & 0xFFFFFFFF):
        return None
    try:
        return text.decode().split("\n")[:-1]
    except ValueError:  # somebody else's file
        return None
