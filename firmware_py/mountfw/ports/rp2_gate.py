"""The gate of an RP2040: two interrupt handlers that turn the motors off without Python. docs/gate.md explains it.

The tap stands in front of the USB stack's handler and searches each packet for stops; the alarm ends each drive at its
deadline. Both force the drive pins low by the pins' output override, and neither can turn a motor on. The loop releases
the override when it has parsed the stop. Section numbers are those of the RP2040 data sheet.
"""

# ruff: noqa: F821 (ptr32 is known to viper)
# pyright: reportUndefinedVariable=false
from array import array

import machine
import micropython
import uctypes
from machine import PWM, Pin, mem32
from micropython import const

from mountfw import codes

# the answers of enter(), which XH? tells; _OFF: by the board file
_OFF, _OTHER_CHIP, _OTHER_VECTORS, _OTHER_ENDPOINT, _ALARM_TAKEN, _NOT_CUT, _NOT_RELEASED = 2, 11, 12, 13, 14, 15, 16

# ---- registers
_XOR = const(0x1000)  # aliases that flip, set, clear bits of a register, 2.1.2
_SET = const(0x2000)
_CLEAR = const(0x3000)
_CHIP_ID = const(0x40000000)  # SYSINFO, 2.20
_CONTROL = const(0x40014004)  # IO_BANK0, 2.19.6: GPIO0_CTRL; 8 bytes a pin, GPIO0_STATUS 4 before
_SIO = const(5)  # FUNCSEL, 1.4.3
_PWM = const(4)
_OUTOVER = const(0x300)
_OEOVER = const(0x3000)
_FLOATS = const(0x2000)  # of OEOVER
_OUT_TO_PAD = const(0x200)  # of STATUS
_OUT_SET = const(0xD0000014)  # SIO, 2.3.1.7
_OUT_CLEAR = const(0xD0000018)
_COUNTERS = const(0x40050008)  # PWM, 4.5.3: CH0_CTR, 20 bytes a slice; TOP is 2 words behind
_ARMED = const(0x40054020)  # TIMER, 4.6.5; bit 0 is alarm 0
_CLOCK = const(0x40054028)  # TIMERAWL
_TIMER = const(0x40054000)
_INTE = const(0x40054038)
_DPRAM = const(0x50100000)  # USB, 4.1.2.5
_ENDPOINT = const(0x50100014)  # control of endpoint 2, out: there MicroPython has the data of its serial port
_BUFFER = const(0x50100094)  # its buffer control
_BULK = const(0x2A)  # the upper six bits of the former: enabled, one buffer with an interrupt, bulk
_BUFF_STATUS = const(0x50110058)  # 4.1.4
_VTOR = const(0xE000ED08)  # 2.4.8
_VECTORS = const(0x20000000)  # where MicroPython has them
_ALARM_VECTOR = const(0x20000040)  # of interrupt 0, 2.3.2, and of 1, alarm 1: MicroPython uses neither
_USB_VECTOR = const(0x20000054)  # of interrupt 5
_ISER = const(0xE000E100)  # NVIC, 2.4.8; bit 0 is interrupt 0
_ICER = const(0xE000E180)
_ISPR = const(0xE000E200)
_IPR0 = const(0xE000E400)

# ---- the block that they share with Python: their code, then the state, words at these places
_END_CODE = const(0xD0)
_STATE = const(0x130)
_BLOCK = const(0x1B0)
_ZEROS = const(0)  # that came last, in a row
_STOPS = const(2)  # found, ever
_CUT_AT = const(3)  # when the first one after a release was found, us of the timer
_HELD = const(4)  # 1 from then on until the release
_PACKET_AT = const(5)  # when the last packet was looked at
_NEXT = const(6)  # the USB stack's handler, then five addresses
_NOTHING = const(0x34)  # a word for pins that an axis has not, in bytes
_AXES = const(0x40)  # in bytes; four axes, each:
_AXIS = const(0x10)
_PIN = const(0)  # CTRL of its pins, set aliases
_OTHER_PIN = const(1)
_ENDS_AT = const(2)  # us of the timer
_PHASE = const(3)
_IDLE = const(0)
_WAITING = const(1)
_ENDED = const(2)

_WRAP = const(0x3FFFFFFF)  # of MicroPython's ticks, and of the counts
_SILENCE_US = const(50_000)  # by then whatever has passed the tap is in stdin, or lost


class AxisGate:
    """The deadline of one axis's drive, kept by the timer. state: address of the gate's state; number: 0 ... 3."""

    def __init__(self, state, number):
        self._state = state
        self._axis = state + _AXES + _AXIS * number

    @micropython.viper
    def end_at(self, ends_at: int):
        """The drive ends at ends_at (ticks), whatever Python does then. Call it before or right after the drive."""
        self.ended()
        axis = ptr32(self._axis)
        clock = ptr32(_CLOCK)
        pend = ptr32(_ISPR)
        now = clock[0]
        axis[_ENDS_AT] = now + ((ends_at - now) << 2 >> 2)
        axis[_PHASE] = _WAITING
        pend[0] = 1  # the handler sets the timer

    @micropython.viper
    def clock(self) -> int:
        """Until when (ticks) the drive was on, if the loop knows of no end: now, or when a handler has cut it."""
        state = ptr32(self._state)
        axis = ptr32(self._axis)
        clock = ptr32(_CLOCK)
        now = clock[0]
        if state[_HELD] and now - state[_CUT_AT] > 0:
            now = state[_CUT_AT]
        if axis[_PHASE] == _ENDED and now - axis[_ENDS_AT] > 0:
            now = axis[_ENDS_AT]
        return now & _WRAP

    @micropython.viper
    def ended(self):
        """The loop has turned the drive off, or goes on with it: no deadline any more, and the pins are released."""
        axis = ptr32(self._axis)
        axis[_PHASE] = _IDLE
        control = ptr32(axis[_PIN] - _SET)
        if control[0] & _OUTOVER:
            state = ptr32(self._state)
            irq = machine.disable_irq()
            if not state[_HELD]:
                control = ptr32(axis[_PIN] - _SET + _CLEAR)
                control[0] = _OUTOVER
                control = ptr32(axis[_OTHER_PIN] - _SET + _CLEAR)
                control[0] = _OUTOVER
            machine.enable_irq(irq)


class Gate:
    """Tap and alarm on the drive pins: for each axis a tuple of one or two GPIO numbers. wanted: by the board file."""

    def __init__(self, pins, wanted):
        self._pins = pins
        self._numbers = [number for axis in pins for number in axis]
        self._wanted = wanted
        self._block = bytearray(_BLOCK)
        from mountfw.ports import rp2_handlers  # needed at the start only

        for place, code in ((0, rp2_handlers.TAP), (_END_CODE, rp2_handlers.END)):
            self._block[place : place + len(code)] = code
        self._code = uctypes.addressof(self._block)
        self._state = self._code + _STATE
        self._before = None
        self.axes = tuple([AxisGate(self._state, i) for i in range(len(pins))])

    def enter(self):
        """Test all that the gate needs, and put it in place. Returns GATE_IN_PLACE, or the reason why it stays out."""
        reason = _unlike() if self._wanted else _OFF
        if reason:
            return reason
        self._before = mem32[_USB_VECTOR], mem32[_ALARM_VECTOR], mem32[_IPR0]
        mem32[_IPR0] &= ~0xFF  # the alarm before every other interrupt
        mem32[_INTE + _SET] = 1
        reason = self._trial()
        if reason:
            self.leave()
            return reason
        self._prepare(_ENDPOINT, _BUFFER, _BUFF_STATUS, _DPRAM, self._before[0])
        mem32[_USB_VECTOR] = self._code | 1
        return codes.GATE_IN_PLACE

    def leave(self):
        """Out of the way, and everything as it was before enter(). The motors must be off."""
        if self._before is None:
            return
        irq = machine.disable_irq()
        mem32[_ICER] = 1
        mem32[_INTE + _CLEAR] = 1
        mem32[_ARMED] = 1
        mem32[_USB_VECTOR], mem32[_ALARM_VECTOR], mem32[_IPR0] = self._before
        mem32[self._state + 4 * _HELD] = 0
        for axis in self.axes:
            axis.ended()
        self._before = None
        machine.enable_irq(irq)

    # ---- for the loop

    @micropython.viper
    def release(self, parsed: int) -> int:
        """Release the pins, unless the tap has found another number of stops than were parsed. True if it did.

        The loop has turned all drives off before.
        """
        state = ptr32(self._state)
        agree = 0
        irq = machine.disable_irq()
        if (state[_STOPS] - parsed) & _WRAP == 0:
            agree = 1
            if state[_HELD]:
                state[_HELD] = 0
                for axis in self.axes:
                    axis.ended()
        machine.enable_irq(irq)
        return agree

    @micropython.viper
    def differs(self, parsed: int) -> int:
        """True if the tap has found another number of stops than were parsed, and no packet has come for a while.

        While nothing waits to be read or parsed, this means that bytes were lost: in a reset of the bus.
        """
        state = ptr32(self._state)
        clock = ptr32(_CLOCK)
        if (state[_STOPS] - parsed) & _WRAP == 0:
            return 0
        return 1 if clock[0] - state[_PACKET_AT] > _SILENCE_US else 0

    def recount(self, parsed, zeros):
        """Count on from here, if differs(): so many stops, and zeros in a row. As release(), then."""
        irq = machine.disable_irq()
        if self.differs(parsed):
            mem32[self._state + 4 * _STOPS] = parsed
            mem32[self._state + 4 * _ZEROS] = zeros
        machine.enable_irq(irq)
        return self.release(parsed)

    def _prepare(self, control, buffer, status, dpram, following):
        """Fill the state in; nothing is forced."""
        state = array("I", [0] * (_BLOCK - _STATE >> 2))
        for i, value in enumerate((following, control, buffer, status, dpram, _TIMER)):
            state[_NEXT + i] = value & 0xFFFFFFFF
        for i in range(4):
            pins = self._pins[i] if i < len(self._pins) else ()
            for j in (0, -1):
                state[(_AXES + _AXIS * i >> 2) - j] = _CONTROL + _SET + 8 * pins[j] if pins else self._state + _NOTHING
        self._block[_STATE:] = bytes(state)

    def _trial(self):
        """Let both handlers cut pins that are high inside but float outside. Returns the reason to stay out, or 0."""
        packet = array("I", (_BULK << 26, 1, 32, 0x21))  # registers, and one byte: `!`
        at = uctypes.addressof(packet)
        self._prepare(at, at + 4, at + 8, at + 12, self._code + _END_CODE | 1)
        all_high = len(self._numbers)
        try:
            for number in self._numbers:
                mem32[_CONTROL + _SET + 8 * number] = _FLOATS
                mem32[_OUT_SET] = 1 << number
            for code in (0, _END_CODE):
                mem32[_ALARM_VECTOR] = self._code + code | 1
                mem32[_ISER] = 1
                if self._high() != all_high:
                    return _NOT_RELEASED
                begun_us = mem32[_CLOCK]
                ends_at = begun_us + 100 & _WRAP
                if code:
                    for axis in self.axes:
                        axis.end_at(ends_at)
                    while mem32[_CLOCK] - begun_us < 200:
                        pass
                    if [axis.clock() for axis in self.axes] != [ends_at] * len(self.axes):
                        return _NOT_CUT
                else:
                    mem32[_ISPR] = 1
                if self._high():
                    return _NOT_CUT
                if not self.release(1):
                    return _NOT_CUT
                for axis in self.axes:
                    axis.ended()
            return 0 if self._high() == all_high else _NOT_RELEASED
        finally:
            for number in self._numbers:
                mem32[_OUT_CLEAR] = 1 << number
                mem32[_CONTROL + _CLEAR + 8 * number] = _OEOVER

    def _high(self):
        """How many pins would be high if they did not float."""
        return len([number for number in self._numbers if mem32[_CONTROL - 4 + 8 * number] & _OUT_TO_PAD])


def _unlike():
    """The reason why this board is not one on which the gate was tried, or 0."""
    if mem32[_CHIP_ID] & 0xFFFFFFF != 0x2927:  # manufacturer and part, without the revision
        return _OTHER_CHIP
    if mem32[_VTOR] != _VECTORS or not mem32[_USB_VECTOR] & 1:
        return _OTHER_VECTORS
    if mem32[_ALARM_VECTOR] != mem32[_ALARM_VECTOR + 4] or (mem32[_ISER] | mem32[_INTE]) & 3:
        return _ALARM_TAKEN
    endpoint = mem32[_ENDPOINT] & 0xFFFFFFFF
    if endpoint and endpoint >> 26 != _BULK:  # 0: the host has not come yet
        return _OTHER_ENDPOINT
    return 0


class DutyPin:
    """An output that can carry a duty, if pwm_hz is not 0. A change of its function leaves the gate's override alone.

    low() and high() go through the pin's function, at once: the PWM keeps its old duty to the end of its period.
    """

    def __init__(self, number, pwm_hz):
        pin = Pin(number, Pin.OUT, value=0)
        if pwm_hz:
            pwm = PWM(pin, freq=pwm_hz, duty_u16=0)
            self._duty_u16 = pwm.duty_u16
            self.set_hz = pwm.freq  # of both outputs of its slice
        self.number = number
        self._counter = _COUNTERS + 20 * (number >> 1 & 7)
        self._control = number << 1  # in words, from GPIO0_CTRL
        self._bit = 1 << number
        self.low()

    @micropython.viper
    def low(self):
        """Pin low."""
        out = ptr32(_OUT_CLEAR)
        out[0] = int(self._bit)
        control = ptr32(_CONTROL)
        flip = ptr32(_CONTROL + _XOR)
        at = int(self._control)
        flip[at] = (control[at] ^ _SIO) & 31

    @micropython.viper
    def high(self) -> int:
        """Pin high. Returns the time (ticks) right before."""
        out = ptr32(_OUT_SET)
        control = ptr32(_CONTROL)
        flip = ptr32(_CONTROL + _XOR)
        clock = ptr32(_CLOCK)
        at = int(self._control)
        bit = int(self._bit)
        now = clock[0]
        out[0] = bit
        flip[at] = (control[at] ^ _SIO) & 31
        return now & _WRAP

    @micropython.viper
    def level(self, duty_u16) -> int:
        """Pin at duty_u16, 0 ... 65535: at once, or where it has a duty already, from its next period on.

        Returns the time (ticks) right before.
        """
        self._duty_u16(duty_u16)
        control = ptr32(_CONTROL)
        flip = ptr32(_CONTROL + _XOR)
        clock = ptr32(_CLOCK)
        at = int(self._control)
        if control[at] & 31 != _PWM:
            pwm = ptr32(self._counter)
            pwm[0] = pwm[2]  # a period begins
        now = clock[0]
        flip[at] = (control[at] ^ _PWM) & 31
        return now & _WRAP
