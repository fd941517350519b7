"""The settings of an axis that only one with an encoder has: one declaration each, as in settings.py. Pure.

An axis without an encoder has none of them: their queries say 0, and setting anything but 0 is refused with n35.
"""

from mountfw.settings import AT_REST, BITS, HUNDREDTHS

ENCODER_SETTINGS = []  # as SETTINGS; a closed loop needs counts of a step, so these come first


def _setting(mnemonic, name, least, most, default, flags=0):
    ENCODER_SETTINGS.append((mnemonic, name, least, most, default, flags))


_setting(b"XN", "counts_per_step", -10_000, 10_000, 0, AT_REST)
"""Encoder: counts of one step; 0: not measured

Negative: the encoder counts down while the motor runs in its own positive direction (whatever `XI` is). `mirrormount
setup` measures both. 0 ends the closed loop.
"""

_setting(b"MM", "closed_loop", 0, 1, 0, BITS | AT_REST)
"""Encoder: 1: closed loop, the position is measured; 0: open loop

1 is refused with n35 while `XN` is 0. 0: steps are timed and counted as if there were no encoder: the way to go on
without one that has failed.
"""

_setting(b"DB", "dead_band", 0, 10_000, 1)
"""Encoder: counts that a move may end beside its target

More than that are corrected, at most three times. With an AS5600 a move may end a sixteenth of a step too far: back
through the play of the gears the motor cannot go by less.
"""

_setting(b"CL", "correction_s", 0, 1000, 5, HUNDREDTHS)
"""Encoder: rest before a move's end is judged, s

After its last pulse, and after each correction: the motor coasts for some hundredths of a second.
"""

_setting(b"FE", "following_error", 0, 10_000, 0)
"""Encoder: counts that a step's drive may be wrong by

Looked at each `XP` of drive at duty `XD`, in any motion of the closed loop. 0: three quarters of `XN`. `ZH` with bit 1
(2) ignores it. With an `XP` of 60 ms or less only too few counts are wrong: in it the motor is still gaining speed.
"""

_setting(b"XG", "stall_ms", 0, 1000, 60)
"""Encoder: drive without a count that ends a move, ms

0: not checked.
"""

_setting(b"XA", "stall_duty", 0, 255, 0)
"""Encoder: duty of a search for the end by stall; 0: off

Where no switch is fitted in that direction, `MT` and `OR` then run so until the motor stalls, off it, and again. They
are refused with n35 where a stall is not checked (`XG0` or `ZZ1`).
"""

_setting(b"XZ", "zero_angle", 0, 4096, 0, AT_REST)
"""Encoder: an AS5600's angle at position 0, 1 … 4096; 0: none

`DH` and homing set it in the closed loop; `SM` saves it. After a power cut in a motion, when there is no record, the
position is then the one within half a turn of the screw from 0, and an estimate.
"""
