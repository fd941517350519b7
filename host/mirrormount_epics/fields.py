"""The tables of fields of the record types `motor`, `mount`, `camera` and `loop`.

The record types, `mirrormount ioc --list`, docs/control-systems.md and the screen are made of it. The names are those
of EPICS's motor record (github.com/epics-modules/motor, motorRecord.dbd), so that its clients find what they look for.
"""

from collections.abc import Iterator
from dataclasses import dataclass

# ---- the form of a row

READ = "r"  # clients read it
WRITE = "w"  # a put sets it
ACT = "a"  # a put of it is an order: the record is processed, and a put-callback waits for the end of what it began

_TYPES = {"D": "DOUBLE", "S": "SHORT", "L": "LONG", "U": "ULONG", "F": "FLOAT", "O": "OUTLINK"}
_TEXT = "T"  # and its size in bytes, with the final zero


@dataclass(frozen=True)
class Field:
    """One field. kind: a letter of _TYPES, T and a size, or a menu's name. initial: its value at first.

    what: its meaning for a person; "" for one that only stands there because clients of the motor record read it, and
    has the same value always.
    """

    name: str
    kind: str
    access: str
    initial: str
    what: str

    @property
    def numeric(self) -> bool:
        """True for a real number."""
        return self.kind in "DF"


LOOP_NAME = "table:loop"  # no mount and no camera has a colon in its name
CAMERA_STATES = ("no picture", "no spot", "spot")
LOOP_STATES = ("ended", "holding", "correcting", "creeping through the gap", "waiting", "stopped")  # control/events.py
MENUS = {
    "motorDIR": ("Pos", "Neg"),
    "motorSET": ("Use", "Set"),
    "motorFOFF": ("Variable", "Frozen"),
    "motorSPMG": ("Stop", "Pause", "Move", "Go"),
    "motorUEIP": ("No", "Yes"),
    "motorTORQ": ("Disable", "Enable"),
    "motorCERT": ("unknown", "counted", "homed", "estimated", "measured"),
    "cameraVAL": CAMERA_STATES,
    "loopVAL": LOOP_STATES,
}


def _rows(text: str) -> tuple[Field, ...]:
    """Lines: NAME kind access [initial] | what it means."""
    fields = []
    for line in filter(None, map(str.strip, text.splitlines())):
        head, _, what = line.partition("|")
        name, kind, access, *initial = head.split()
        fields.append(Field(name, kind, access, initial[0] if initial else "", what.strip()))
    return tuple(fields)


# ---- the tables

MOTOR = _rows("""
    VAL D a | where it shall go, user coordinates: the nearest whole step is gone to; it stays as it was asked
    RBV D r | where it is, user coordinates: as the board counts
    DVAL D a | VAL in dial coordinates: VAL = DVAL (times -1 if DIR is Neg) + OFF
    DRBV D r | RBV in dial coordinates
    RVAL L a | the same in whole steps of the board
    RRBV L r | RBV in whole steps
    RLV D a | go by so much
    TWV D w 1 | size of a tweak
    TWF S a | 1: go forward by TWV
    TWR S a | 1: go back by TWV
    DIFF D r | DVAL - DRBV
    RDIF L r | RVAL - RRBV
    LVAL D r | the last VAL that was accepted
    DMOV S r 1 | 1: done; 0 before a put returns, and 1 only after RBV is told
    MOVN S r | 1: the board says that it moves
    MIP S r | 1: a motion is under way
    STOP S a | 1: end the motion of this axis; VAL becomes RBV. A pulse with less than 250 ms left is finished
    SPMG motorSPMG a Go | Stop, Pause (keeps the target), Move (one move, then Pause), Go. A stop by others sets Stop
    JOGF S a | 1: run forward at the board's run duty, until 0 or STOP
    JOGR S a | 1: run back
    HOMF S a | 1: find the home that the board's settings say
    HOMR S a | 1: the same
    HLM D w 999999 | high limit, user coordinates: the board's soft limit
    LLM D w -999999 | low limit, user coordinates
    DHLM D w 999999 | high limit, dial coordinates
    DLLM D w -999999 | low limit, dial coordinates
    LVIO S r | 1: the last target was beyond the limits, and was refused
    HLS S r | 1: at the end-stop in the direction of high user coordinates
    LLS S r | 1: at the other one
    RHLS S r | 1: at the board's positive end-stop
    RLLS S r | 1: at the board's negative end-stop
    OFF D a | user coordinates minus (directed) dial coordinates
    DIR motorDIR a | direction of the user coordinates
    FOFF motorFOFF w | what changes when a position is defined or DIR changes: OFF (Variable), or the board (Frozen)
    SET motorSET w | Set: a put of VAL, DVAL or RVAL defines the present position, and nothing moves
    SSET S w | 1: SET becomes Set
    SUSE S w | 1: SET becomes Use
    FOF S w | 1: FOFF becomes Frozen
    VOF S w | 1: FOFF becomes Variable
    SYNC S w | 1: VAL becomes RBV
    VELO D w 1 | EGU per second, rests between steps included
    VMAX D r 1 | the most that the board's pulses allow
    ACCL D r | seconds for which the backlash is taken up, once a move
    EGU T16 r steps | unit: steps, or mrad of the mirror where it is calibrated
    MRES D r 1 | EGU of one step
    RDBD D r 0.5 | half a step: a move ends within it
    SPDB D r 0.5 | the same
    PREC S w 3 | digits after the point, for displays
    MSTA U r 2 | bits of the motor's state, as in the motor record
    CDIR S r | 1: the board moves, or moved last, in its positive direction
    TDIR S r | the same for user coordinates
    CERT motorCERT r | how certain the position is (its own record has the alarm)
    WHY S r | the board's reason for the end of the last motion (docs/errors.md)
    ESTP T240 r | why the last order was refused or ended early; "" if it was not. Longer than 39: as .ESTP$
    VERS F r 7.3 |
    HOPR D r |
    LOPR D r |
    MISS S r |
    RCNT S r |
    ATHM S r |
    ERES D r 1 |
    SREV L r 200 |
    UREV D r 200 |
    RRES D r |
    UEIP motorUEIP r |
    URIP motorUEIP r |
    VBAS D r |
    S D r |
    SBAS D r |
    SMAX D r |
    BVEL D r 1 |
    BACC D r |
    BDST D r |
    HVEL D r 1 |
    JVEL D r 1 |
    JAR D r 1 |
    CNEN motorTORQ r Enable |
    DLY D r |
    RTRY S r |
    FRAC F r 1 |
    PCOF D r |
    ICOF D r |
    DCOF D r |
    CARD S r |
    OUT O r |
""")
MOUNT = _rows("""
    VAL S r | 1: the board is there
    STOP S a | 1: all motors of this board off, at once
    CONN S r | 1: the board is there
    MSG T240 r | what has happened last: who has stopped it, why the board is not there
    IDN T240 r | the board's identity
""")
CAMERA = _rows("""
    VAL cameraVAL r | what it shows: no picture, no spot, or a spot
    X D r NaN | the spot's place, px to the right of the centre of the top left pixel; nan if there is none
    Y D r NaN | the same, downwards
    SX D r NaN | standard error of X, px
    SY D r NaN | of Y
    W D r NaN | standard deviation of the beam along x, px
    H D r NaN | along y
    SHAPE D r NaN | the doubt about the place that the shape of the beam leaves, px
    MSG T240 r | why there is no spot, or no picture
""")
LOOP = _rows("""
    VAL loopVAL r | what it does
    HOLD S a | 1: hold the beam with the saved calibration; 0: end that, motors off
    GO S a | 1: go on, of a loop that stands still until a person says so
    WHY T240 r | why it does that, or does nothing
    ERR D r NaN | the largest error along x or y in any camera, um; nan if it is not known
    ANGLE D r NaN | how far the beam's angle is off, urad; nan if it is not known
""")
_STOPS = ("STOP",)  # access level 0: --read-only leaves them, for everybody may stop

# ---- record types


def record_types() -> dict[str, str]:
    """The definitions of the record types, as EPICS reads them (.dbd), by name; the menus stand in the first."""
    menus = "".join(f"menu({name}){{{_choices(name, words)}}}\n" for name, words in MENUS.items())
    tables = {"motor": MOTOR, "mount": MOUNT, "camera": CAMERA, "loop": LOOP}
    return {name: menus * (name == "motor") + _record_type(name, table) for name, table in tables.items()}


def _choices(name: str, words: tuple[str, ...]) -> str:
    return " ".join(f'choice({name}_{i},"{word}")' for i, word in enumerate(words))


def _record_type(name: str, table: tuple[Field, ...]) -> str:
    return f'recordtype({name}){{ include "dbCommon.dbd"\n' + "".join(map(_definition, table)) + "}\n"


def _definition(field: Field) -> str:
    special = {READ: "special(SPC_NOMOD)", WRITE: "special(SPC_MOD)", ACT: "special(SPC_MOD) pp(TRUE)"}[field.access]
    body = [f'prompt("{field.name}")', f"asl(ASL{0 if field.name in _STOPS else 1})", special]
    if field.kind[0] == _TEXT and field.kind[1:].isdigit():
        kind = "STRING"
        body.append(f"size({field.kind[1:]})")
    elif field.kind in _TYPES:
        kind = _TYPES[field.kind]
    else:
        kind = "MENU"
        body.append(f"menu({field.kind})")
    if field.initial:
        body.append(f'initial("{field.initial}")')
    return f"field({field.name},DBF_{kind}){{{' '.join(body)}}}\n"


# ---- records

_ALARM = {
    "unknown": "MINOR",
    "estimated": "MINOR",
    "no picture": "INVALID",
    "no spot": "INVALID",
    "waiting": "MINOR",
    "stopped": "MAJOR",
}
_MBBI = ("ZR", "ON", "TW", "TH", "FR", "FV")  # the first states of EPICS's mbbi
_NO_PUTS = 'field(DISP,"1")'  # of any client: what these records show is never what somebody has put
_LINKED = {  # ordinary records: name, field, unit, digits; nan is the alarm UDF, INVALID of an ai
    "camera": (
        ("x", "X", "px", 2),
        ("y", "Y", "px", 2),
        ("sigma-x", "SX", "px", 3),
        ("sigma-y", "SY", "px", 3),
        ("width", "W", "px", 2),
        ("height", "H", "px", 2),
        ("shape", "SHAPE", "px", 2),
    ),
    "loop": (("error", "ERR", "um", 1), ("angle", "ANGLE", "urad", 1)),
}


def records(mount: str, axes: tuple[str, ...]) -> str:
    """The records of a mount, as EPICS loads them (.db). mount: prefix and name; axes: those that it has."""
    lines = [f'record(mount,"{mount}"){{field(DESC,"mirror mount")}}']
    for axis in axes:
        name = f"{mount}:{axis}"
        lines.append(f'record(motor,"{name}"){{field(DESC,"mirror mount, axis {axis}")}}')
        lines.append(_states(f"{name}:certainty", f"{name}.CERT", MENUS["motorCERT"]))
    return "\n".join(lines) + "\n"


def linked_records(kind: str, name: str) -> str:
    """The record of a camera or of the loop, and ordinary ones of its fields. kind: its record type."""
    device_time = 'field(TSE,"-2")'  # the time that is set on the record, which is that of an image's exposure
    lines = [f'record({kind},"{name}"){{{device_time * (kind == "camera")}}}']
    lines.append(_states(f"{name}:state", f"{name}.VAL", MENUS[f"{kind}VAL"]))
    for label, field, unit, digits in _LINKED[kind]:
        rest = f'{_NO_PUTS}field(EGU,"{unit}")field(PREC,"{digits}"){device_time}'
        lines.append(f'record(ai,"{name}:{label}"){{field(INP,"{name}.{field} CP"){rest}}}')
    return "\n".join(lines) + "\n"


def _states(name: str, source: str, words: tuple[str, ...]) -> str:
    states = "".join(
        f'field({state}ST,"{word}")field({state}VL,"{i}")field({state}SV,"{_ALARM.get(word, "NO_ALARM")}")'
        for i, (state, word) in enumerate(zip(_MBBI, words, strict=False))
    )
    return f'record(mbbi,"{name}"){{field(INP,"{source} CP"){_NO_PUTS}{states}}}'


def listed(mounts: dict[str, tuple[str, ...]], linked: dict[str, str]) -> Iterator[str]:
    """Lines that tell every record and field.

    mounts: names with their prefix, and their axes. linked: names of cameras and of the loop, and their record types.
    """
    for mount, axes in mounts.items():
        yield f"{mount}  a mount"
        yield from (f"{mount}:{axis}  a motor; its position's certainty is {mount}:{axis}:certainty" for axis in axes)
    for name, kind in linked.items():
        labels = ", ".join(f"{name}:{label}" for label in ("state", *(row[0] for row in _LINKED[kind])))
        yield f"{name}  a {kind}; as ordinary records: {labels}"
    tables = {"motor": MOTOR, "mount": MOUNT}
    tables |= {kind: table for kind, table in (("camera", CAMERA), ("loop", LOOP)) if kind in linked.values()}
    for title, table in ((f"of a {kind}", table) for kind, table in tables.items()):
        yield f"fields {title} (r: read, w: write, a: act):"
        yield from (f"  .{field.name:<5}{field.access}  {field.what}" for field in table if field.what)
        only = [field.name for field in table if not field.what]
        if only:
            yield f"  there for clients that read them, always the same: {' '.join(only)}"
