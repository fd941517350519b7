"""Board files: which one is used, its values, its faults. Pure; imports boards. Needed while a board starts, only.

A motor must not turn because of a slip in a board file: a file that cannot be used is refused, with one line that
says why, before any pin is touched, and no other file takes its place. `mirrormount deploy` calls fault(), too.
"""

from mountfw.boards import AXES, DRIVES, axes

# The file for a board, by the names that the platforms give it: CircuitPython's board id, and MicroPython's
# MICROPY_HW_BOARD_NAME in small letters, with _ for what is neither letter nor digit. The file of a board that is not
# here has the board's name.
FILE_OF = {
    "raspberry_pi_pico": "pico",
    "raspberry_pi_pico_w": "pico_w",
    "raspberry_pi_pico2": "pico2",
    "raspberry_pi_pico2_w": "pico2_w",
    "raspberry_pi_pico_2_w": "pico2_w",
    "seeed_studio_xiao_rp2040": "seeed_xiao_rp2040",
    "seeeduino_xiao_rp2040": "seeed_xiao_rp2040",
    "adafruit_feather_esp32s3_4mbflash_2mbpsram": "adafruit_feather_esp32s3",
    "adafruit_feather_esp32s3_nopsram": "adafruit_feather_esp32s3",
}

# each bridge: its class in bridges.py, which pins of an axis are low while it has no drive and carry its duty, and
# which may carry it if the decay can be chosen
BRIDGES = {
    "enable": ("EnableBridge", ("en",), ("en", "pos")),
    "two-pwm": ("TwoPwmBridge", ("pos", "neg"), ("pos", "neg")),
}
STOPS = ("stop_pos", "stop_neg")
ENCODERS = ("encoder", "shaft")  # which an axis may have: A and B on the motor's shaft; SDA and SCL of an AS5600
REQUIRED = ("NAME", "BRIDGE", "AXIS_1", "AXIS_2", "PWM_HZ", "DEAD_TIME_US", "LED")
OPTIONAL = ("AXIS_3", "AXIS_4", "EMERGENCY_STOP", "POWER", "ONE_CHANNEL", "GATE", "LANE")

_PINS = DRIVES + STOPS

checked = None  # the board file that find_board() has returned last: it has no fault

_ANALOG = (26, 27, 28, 29)  # of RP2040 and RP2350 (data sheets: ADC; an RP2350B, which has others, is not tried)
_MOST_PWM_HZ = 200_000
_MOST_DEAD_TIME_US = 10_000


def find_board(title, name, listdir, rp2):
    """The board file, as a module: boards/this.py if there is one, else that of the board `name`, called title.

    None, after a printed line, if there is none or it cannot be used. listdir is os.listdir; rp2: is this an RP2040 or
    RP2350?
    """
    name = FILE_OF.get(name) or name
    path = __import__("mountfw.boards").boards.__path__
    files = listdir(path if isinstance(path, str) else path[0])
    for candidate in ("this", name):
        if candidate + ".py" in files or candidate + ".mpy" in files:
            return _load(candidate, rp2)
    print("mountfw: no board file for '%s': write mountfw/boards/%s.py (copy pico.py)" % (title, name))
    return None


def _load(name, rp2):
    global checked
    board = None
    try:
        board = getattr(__import__("mountfw.boards." + name).boards, name)
        wrong = fault(values(board), rp2)
    except Exception as e:
        wrong = "%s: %s" % (type(e).__name__, e)
    if not wrong:
        checked = board
        return board
    print("mountfw: boards/%s.py cannot be used, so no pin is driven: %s" % (name, wrong))
    return None


def led_of(board, radio):
    """The LED of a board file, or None. With a radio chip "LED" is the chip's, too slow to switch in the loop."""
    return None if radio and board.LED == "LED" else board.LED


def gate_pins(board):
    """The pins of each axis of a board file that are low while it has no drive: those that carry its duty."""
    return [tuple([pins[name] for name in BRIDGES[board.BRIDGE][1]]) for pins in axes(board)]


def tunable(board, pins):
    """May an axis with these pins of a board file have a PWM frequency and a decay of its own, on an RP2040 or RP2350?

    Not where another axis has a pin at the same slice: its two outputs have one frequency.
    """
    names = BRIDGES[board.BRIDGE][2]
    own = [_pwm_output(pins[name]) >> 1 for name in names]
    for other in axes(board):
        for name in names:
            if other is not pins and _pwm_output(other[name]) >> 1 in own:
                return False
    return True


def values(board):
    """The constants of a board file: name to value, without imported modules and names with an underscore."""
    module = type(__import__("mountfw"))
    found = board.__dict__  # dir() would take a Pico 25 ms
    return {name: value for name, value in found.items() if name[0] != "_" and not isinstance(value, module)}


def fault(values, rp2=True):
    """The first fault in the constants of a board file (name to value), in words; "" if there is none.

    rp2: is it for an RP2040 or RP2350?
    """
    for name in sorted(values):
        if name not in REQUIRED and name not in OPTIONAL:
            return "%s is no name that a board file may have" % name
    for name in REQUIRED:
        if name not in values:
            return "%s is missing" % name
    return _fault_of_constants(values) or _fault_of_axes(values, rp2) or _fault_of_pins(values, rp2)


def _fault_of_constants(values):
    if values["BRIDGE"] not in BRIDGES:
        return "BRIDGE is %r, not one of %s" % (values["BRIDGE"], ", ".join(sorted(BRIDGES)))
    if not isinstance(values["NAME"], bytes):
        return "NAME is %r, not bytes" % (values["NAME"],)
    for name, least, most in (("PWM_HZ", 10, _MOST_PWM_HZ), ("DEAD_TIME_US", 0, _MOST_DEAD_TIME_US)):
        if type(values[name]) is not int or not least <= values[name] <= most:
            return "%s is %r, not a whole number within %d ... %d" % (name, values[name], least, most)
    for name in ("ONE_CHANNEL", "GATE", "LANE"):
        if type(values.get(name, False)) is not bool:
            return "%s is neither True nor False" % name
    if not (values["LED"] is None or isinstance(values["LED"], str) or _is_pin(values["LED"])):
        return "LED is %r, neither a pin's number nor its name nor None" % (values["LED"],)
    return ""


def _fault_of_axes(values, rp2):
    before = "AXIS_1"
    for axis in AXES:
        if axis in values:
            if before not in values:
                return "%s is there, but %s is missing: axes are numbered without a gap" % (axis, before)
            wrong = _fault_of_axis(axis, values, rp2)
            if wrong:
                return wrong
        before = axis
    return ""


def _fault_of_axis(axis, values, rp2):
    pins = values[axis]
    if not isinstance(pins, dict):
        return "%s is no dictionary of pins" % axis
    for name in sorted(pins):
        if name not in _PINS and name not in ENCODERS:
            return "%s: %r is not one of %s" % (axis, name, ", ".join(_PINS + ENCODERS))
    for name in _PINS:
        if name not in pins:
            return "%s: %s is missing" % (axis, name)
        may_be_none = name in STOPS or (name == "en" and values["BRIDGE"] != "enable")
        if not (_is_pin(pins[name]) or (pins[name] is None and may_be_none)):
            return "%s: %s is %r, not a pin's number" % (axis, name, pins[name])
    if values["BRIDGE"] != "enable" and pins["en"] is not None:
        return "%s: en is %r, but a %s bridge has none: None" % (axis, pins["en"], values["BRIDGE"])
    return _fault_of_encoder(axis, pins, rp2)


def _fault_of_encoder(axis, pins, rp2):
    """An encoder is two pins; on an RP2040 or RP2350 neighbours, for its PIO, and for I2C the first one even."""
    fitted = [name for name in ENCODERS if name in pins]
    if len(fitted) > 1:
        return "%s: has both an encoder and a shaft: one of them" % axis
    for name in fitted:
        pair = pins[name]
        if not isinstance(pair, tuple) or len(pair) != 2 or not (_is_pin(pair[0]) and _is_pin(pair[1])):
            return "%s: %s is %r, not two pins' numbers" % (axis, name, pair)
        if rp2 and pair[1] != pair[0] + 1:
            return "%s: %s: pin %d must be followed by pin %d" % (axis, name, pair[0], pair[0] + 1)
        if rp2 and name == "shaft" and pair[0] & 1:
            return "%s: shaft: SDA is an even pin, not %d (data sheet, functions of the pins)" % (axis, pair[0])
    return ""


def _fault_of_pins(values, rp2):
    """No pin may be used twice; and on an RP2040 or RP2350, no PWM output."""
    stop = values.get("EMERGENCY_STOP")
    if stop is not None and not _is_pin(stop):
        return "EMERGENCY_STOP is %r, neither a pin's number nor None" % (stop,)
    power = values.get("POWER")
    if power is not None and not (_is_pin(power) and (not rp2 or power in _ANALOG)):
        return "POWER is %r, neither an analog input's number%s nor None" % (power, ", 26 to 29," if rp2 else "")
    used = {}
    carriers = {}
    fitted = [axis for axis in AXES if axis in values]
    places = [("LED", "", values["LED"]), ("EMERGENCY_STOP", "", stop), ("POWER", "", power)]
    places += [(axis, name, values[axis][name]) for axis in fitted for name in _PINS]
    places += [(axis, name, pin) for axis in fitted for name in ENCODERS for pin in values[axis].get(name, ())]
    carrying = BRIDGES[values["BRIDGE"]][1]
    for axis, name, pin in places:
        if pin is None:
            continue
        if pin in used:
            return "pin %s is used twice, at %s and at %s" % (pin, _place(*used[pin]), _place(axis, name))
        used[pin] = axis, name
        if rp2 and name in carrying:
            carrier = _pwm_output(pin)
            if carrier in carriers:
                return "pins %d and %d share one PWM output, so both motors would turn" % (carriers[carrier], pin)
            carriers[carrier] = pin
    buses = {}
    for axis in AXES:
        for sda in values.get(axis, {}).get("shaft", ())[:1]:
            if rp2 and sda >> 1 & 1 in buses:
                return "%s: shaft: its bus is that of %s, and both sensors have one address" % (
                    axis,
                    buses[sda >> 1 & 1],
                )
            buses[sda >> 1 & 1] = axis
    return ""


def _place(axis, name):
    return "%s: %s" % (axis, name) if name else axis


def _is_pin(value):
    return type(value) is int and 0 <= value < 64


def _pwm_output(gpio):
    """Which of the chip's PWM outputs GPIO `gpio` carries (RP2040 data sheet 4.5.2, RP2350 data sheet 12.5.2)."""
    return (gpio & 15) if gpio < 32 else 16 + (gpio & 7)
