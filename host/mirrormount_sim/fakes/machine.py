"""machine on the virtual board: pins and PWM of an RP2040. Every write is checked for range."""

import _as5600
import _seam

_LED = 25
_NAMED = {"LED": _LED}


PWRON_RESET = 1
WDT_RESET = 3
_cause = PWRON_RESET


def reset_cause():
    return _cause


def reset():
    """Pins become inputs, what was received is lost, and everything starts again."""
    global _cause
    _cause = WDT_RESET
    if WDT.armed is None:
        _memory[_SCRATCH4] = 0
    WDT.armed = None
    _seam.seam.forget()
    for number in list(Pin._gpio):
        Pin(number, Pin.IN)
    raise SystemExit


def unique_id():
    return b"\xe6\x61\x64\x08\x43\x2f\x5a\x21"


class Pin:
    """One GPIO. Its level depends on its function: the output register, or the PWM behind it."""

    IN = 0
    OUT = 1
    OPEN_DRAIN = 2
    ALT = 3
    PULL_UP = 1
    PULL_DOWN = 2
    ALT_PWM = 4
    IRQ_RISING = 8

    _gpio = {}  # number: [mode, output level, shown duty, pull]

    def __init__(self, id, mode=-1, pull=-1, *, value=None, alt=-1):
        number = id.number if isinstance(id, Pin) else _NAMED.get(id, id)
        if not isinstance(number, int) or not 0 <= number <= 29:
            raise ValueError("invalid pin")
        self.number = number
        Pin._gpio.setdefault(number, [Pin.IN, 0, 0, 0])
        if mode != -1:
            self.init(mode, pull, value=value, alt=alt)

    def init(self, mode=-1, pull=-1, *, value=None, alt=-1):
        _seam.seam.tick(5)
        gpio = Pin._gpio[self.number]
        if mode not in (Pin.IN, Pin.OUT, Pin.ALT):
            raise ValueError("the virtual board has no pin mode %r" % (mode,))
        if mode == Pin.ALT and alt != Pin.ALT_PWM:
            raise ValueError("invalid pin af: %r" % (alt,))
        if value is not None:
            gpio[1] = _level(value)
        gpio[0] = mode
        gpio[3] = pull
        self._show()

    def low(self):
        self.value(0)

    def high(self):
        self.value(1)

    def irq(self, handler, trigger, *, hard=False):
        """Called between two instants of the board's time, when the level has risen."""
        if trigger != Pin.IRQ_RISING or not hard:
            raise ValueError("the virtual board has hard interrupts on a rising edge only")
        _seam.seam.handlers[self.number] = lambda: handler(self)

    def value(self, level=None):
        s = _seam.seam
        s.tick(1)
        gpio = Pin._gpio[self.number]
        if level is not None:
            gpio[1] = _level(level)
            self._show()
            return None
        if gpio[0] != Pin.IN:
            return 1 if gpio[2] else 0
        return s.levels.get(self.number, 1 if gpio[3] == Pin.PULL_UP else 0)

    def _show(self):
        gpio = Pin._gpio[self.number]
        _seam.seam.unlatch(self.number)
        if gpio[0] == Pin.ALT:
            PWM._outputs[self.number].show()
            return
        self._shows(gpio[1] * 65535 if gpio[0] == Pin.OUT else 0)

    def _shows(self, duty, hz=0):
        gpio = Pin._gpio[self.number]
        if duty != gpio[2]:
            gpio[2] = duty
            _seam.seam.edge(self.number, duty, hz)


def _level(value):
    if value not in (0, 1):
        raise ValueError("a pin's level is 0 or 1, not %r" % (value,))
    return int(value)


class ADC:
    """An analog input: the simulation tells its value as a level, 0 ... 65535."""

    def __init__(self, pin):
        if pin.number not in (26, 27, 28, 29):
            raise ValueError("Pin doesn't have ADC capabilities")
        self._number = pin.number

    def read_u16(self):
        _seam.seam.tick(4)
        return _seam.seam.levels.get(self._number, 0)


class PWM:
    """An output of a slice. Making one gives the pin the PWM function, as on the RP2040.

    The slice counts all the time. A new duty shows when the running period is over, or when the counter is set to its
    top, which begins one.
    """

    _outputs = {}  # GPIO number: its PWM
    _slices = {}  # number: [frequency, when a period began]

    def __init__(self, pin, freq=0, *, duty_u16=-1):
        self._pin = pin
        self._slice = PWM._slices.setdefault(pin.number >> 1 & 7, [freq, _seam.seam.t])
        self._duty = self._next = 0
        self._at = 0  # from when on the latter is the duty
        self.freq(freq)
        PWM._outputs[pin.number] = self
        if duty_u16 != -1:
            self.duty_u16(duty_u16)
            self.begin()
        pin.init(Pin.ALT, alt=Pin.ALT_PWM)

    def freq(self, hz):
        if not 8 <= hz <= 62_500_000:
            raise ValueError("freq out of range")
        self._slice[0] = hz

    def duty_u16(self, duty):
        s = _seam.seam
        s.tick(5)
        if not 0 <= duty <= 65535:
            raise ValueError("duty_u16 must be 0 to 65535, not %r" % (duty,))
        self._settle()
        period_us = max(1, 1_000_000 // self._slice[0])
        self._next = duty
        self._at = s.t + period_us - (s.t - self._slice[1]) % period_us
        if Pin._gpio[self._pin.number][0] == Pin.ALT:
            self._pin._show()

    def begin(self):
        """A period of the slice begins."""
        self._at = _seam.seam.t
        if Pin._gpio[self._pin.number][0] == Pin.ALT:
            self._pin._show()

    def show(self):
        """The pin has the PWM function."""
        self._settle()
        self._pin._shows(self._duty, self._slice[0])
        if self._next != self._duty:
            Pin._gpio[self._pin.number][2] = self._next
            _seam.seam.latch(self._at, self._pin.number, self._next, self._slice[0])

    def _settle(self):
        if _seam.seam.t >= self._at:
            self._duty = self._next


class WDT:
    """The watchdog. Here it is only when it is fed too late that it is seen to have bitten."""

    armed = None  # the one that is running

    def __init__(self, timeout=5000):
        if not 1 <= timeout <= 8388:
            raise ValueError("timeout exceeds 8388")
        self._timeout_us = timeout * 1000
        WDT.armed = self
        self._fed_at = _seam.seam.t
        _memory[_SCRATCH4] = _TIMED_OUT

    def feed(self):
        s = _seam.seam
        s.tick(1)
        if WDT.armed is self and s.t - self._fed_at > self._timeout_us:
            reset()
        self._fed_at = s.t


_WATCHDOG = 0x40058000
_SCRATCH4 = _WATCHDOG + 0x1C
_TIMED_OUT = 0x6AB73121
_memory = {_SCRATCH4: 0}
_COUNTERS = 0x40050008
_TOP = 31249


def _is_of_pwm(address):
    return 0 <= address - _COUNTERS < 160 and (address - _COUNTERS) % 20 == 0


class _Mem32:
    """The registers of the watchdog and of the PWM's counters, as far as the firmware knows them."""

    def __getitem__(self, address):
        return _TOP if _is_of_pwm(address - 8) else _memory[address]

    def __setitem__(self, address, value):
        if _is_of_pwm(address) and value == _TOP:
            number = (address - _COUNTERS) // 20
            PWM._slices[number][1] = _seam.seam.t
            for gpio in PWM._outputs:
                if gpio >> 1 & 7 == number:
                    PWM._outputs[gpio].begin()
        elif (address, value) == (_WATCHDOG + 0x3000, 1 << 30):
            WDT.armed = None
        elif address == _SCRATCH4:
            _memory[_SCRATCH4] = value
        else:
            raise ValueError("the virtual board has no such register: %x" % address)


mem32 = _Mem32()


class I2C:
    """A bus with at most an AS5600 on it."""

    def __init__(self, id, *, scl, sda, freq=400_000, timeout=50_000):
        if (scl.number, id) != (sda.number + 1, sda.number >> 1 & 1):
            raise ValueError("bad SCL or SDA pin")
        self._sda = sda.number

    def readfrom_mem_into(self, address, register, buffer):
        _as5600.read(self._sda, address, register, buffer)
