"""Numbered errors, the queue that holds them, and the reasons why moves end. Pure.

The numbers are the wire's (docs/errors.md tells cause and remedy of each). An error of one
axis is 100 times the axis plus its number here.
"""

NO_SUCH_COMMAND = 6
OUT_OF_RANGE = 7
NO_SUCH_AXIS = 9
AXIS_MISSING = 37
VALUE_MISSING = 38
NO_SUCH_CONTROLLER = 48
MALFORMED = 60
LINE_TOO_LONG = 61
KEEP_ALIVE_LOST = 62
SETTINGS_DAMAGED = 63
INTERNAL_FAULT = 64
ANSWER_DROPPED = 65
WATCHDOG_RESET = 66
NOT_SAVED = 67
OWN_REPLY = 68

# of one axis
AXIS_OUT_OF_RANGE = 1
AXIS_POSITIVE_STOP = 4
AXIS_NEGATIVE_STOP = 5
AXIS_POSITIVE_SOFT = 6
AXIS_NEGATIVE_SOFT = 7
AXIS_NOT_CONNECTED = 8
AXIS_TOO_FAST = 10
AXIS_MOVING = 14
AXIS_NOT_FITTED = 35
AXIS_RUN_LIMIT = 40
AXIS_BOTH_STOPS = 42
AXIS_EMERGENCY_STOP = 43
AXIS_NOT_FOUND = 45
AXIS_NOT_RELEASED = 46

# what TB? says after the number and a comma: no other comma, because clients split the answer there
MESSAGES = {
    0: b"NO ERROR DETECTED",
    6: b"COMMAND DOES NOT EXIST",
    7: b"PARAMETER OUT OF RANGE",
    9: b"AXIS NUMBER OUT OF RANGE",
    37: b"AXIS NUMBER MISSING",
    38: b"COMMAND PARAMETER MISSING",
    48: b"CONTROLLER NUMBER OUT OF RANGE",
    60: b"MALFORMED INPUT: MOTORS STOPPED",
    61: b"LINE TOO LONG: MOTORS STOPPED",
    62: b"KEEP-ALIVE LOST: MOTORS STOPPED",
    63: b"SETTINGS DAMAGED: DEFAULTS IN USE",
    64: b"INTERNAL FAULT: MOTORS STOPPED",
    65: b"AN ANSWER WAS DROPPED",
    66: b"FIRMWARE HAD HUNG: BOARD WAS RESET",
    67: b"COULD NOT BE SAVED",
    68: b"OWN REPLY RECEIVED: MOTORS STOPPED",
}

AXIS_MESSAGES = {
    1: b"OUT OF RANGE",
    4: b"POSITIVE END-STOP REACHED",
    5: b"NEGATIVE END-STOP REACHED",
    6: b"POSITIVE SOFT LIMIT",
    7: b"NEGATIVE SOFT LIMIT",
    8: b"MOTOR NOT CONNECTED",
    10: b"VELOCITY TOO HIGH",
    14: b"MOTION IN PROGRESS",
    35: b"NOT FITTED OR SWITCHED OFF",
    40: b"RUN LIMIT REACHED",
    42: b"BOTH END-STOPS ACTIVE",
    43: b"EMERGENCY STOP",
    45: b"HOMING: SWITCH NOT FOUND",
    46: b"HOMING: SWITCH NOT RELEASED",
}

# why a move ended
NONE_YET = 0
DONE = 1
STOPPED = 2
ABORTED = 3
END_STOP = 4
SOFT_LIMIT = 5
RUN_LIMIT = 6
KEEP_ALIVE = 7
SUPERSEDED = 8
FAULT = 9
EMERGENCY_STOP = 10
HOMING_FAILED = 12

# why the board was reset last
POWER = 1  # or its reset pin
ASKED = 2  # by software: deploy, machine.reset()
WATCHDOG = 3

# what a position is worth
UNKNOWN = 0
COUNTED = 1
HOMED = 2
ESTIMATED = 3


def message(code):
    """What error code says (bytes), without the axis."""
    if code < 100:
        return MESSAGES[code]
    return AXIS_MESSAGES[code % 100]
