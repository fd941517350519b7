"""The fast lane of an RP2040: native code between a byte and the pins. docs/gate.md explains it.

read() waits for bytes, reads them, cuts at a stop and drives at a frame before any Python runs. lane.py books what it
did. Section numbers are those of the RP2040 data sheet.
"""

# ruff: noqa: F821 (ptr8 and ptr32 are known to viper)
# pyright: reportUndefinedVariable=false, reportArgumentType=false
# pyright: reportPossiblyUnboundVariable=false, reportOperatorIssue=false
from array import array

import micropython
from micropython import const

from mountfw import codes
from mountfw.ports.lane import Lane
from mountfw.ports.micropython_console import byte_in, interrupts, ipoll_in, pack, readinto
from mountfw.wire.receiver import EIGHTH_ZERO, STOP, ZEROS

# ---- registers
_XOR = const(0x1000)  # alias that flips bits of a register, 2.1.2
_CONTROL = const(0x40014004)  # IO_BANK0, 2.19.6: GPIO0_CTRL, 8 bytes a pin
_SIO = const(5)  # FUNCSEL, 1.4.3
_PWM = const(4)
_OUT = const(0xD0000010)  # SIO, 2.3.1.7
_OUT_SET = const(0xD0000014)
_OUT_CLEAR = const(0xD0000018)
_CLOCK = const(0x40054028)  # TIMERAWL, 4.6.5
_COUNTERS = const(0x40050008)  # PWM, 4.5.3: CH0_CTR, and CH0_CC and CH0_TOP after it; 20 bytes a slice
_WRAP = const(0x3FFFFFFF)  # of MicroPython's ticks

# ---- the words of a bridge
_ENABLE = const(0)  # bits of its pins
_POS = const(1)
_NEG = const(2)
_FUNCTION = const(3)  # address of the enable's CTRL
_DEAD_US = const(4)
_WAY = const(5)  # that its legs have: 1 or 2, 0: none
_CARRIER = const(6)  # bit of the pin that carries the duty: the enable; with slow decay `pos`
_CARRIES = const(7)  # address of its CTRL
_COUNTER = const(8)  # address of its slice's CTR
_SHIFT = const(9)  # of its level in CC
_CHOICES = const(10)  # from here on these four for fast decay, and for slow

_CLOCK_US = const(32)  # a drive's last stretch, in which only the clock is read: more than a look for a byte takes
_WAITING = const(0)  # the words of a Lane's log
_FIRST = const(4)  # from here on: packed frame, time of axis 1, of axis 2


@micropython.viper
def _cut(words: ptr32, us: int) -> int:
    """No drive from this time (ticks) on, which must be near or over. Returns the time."""
    off = ptr32(_OUT_CLEAR)
    function = ptr32(words[_FUNCTION])
    flip = ptr32(words[_FUNCTION] + _XOR)
    clock = ptr32(_CLOCK)
    enable = words[_ENABLE]
    while (us - clock[0]) << 2 > 0:  # of 30 bits
        pass
    off[0] = enable
    flip[0] = (function[0] ^ _SIO) & 31
    return clock[0] & _WRAP


@micropython.viper
def _drive(words: ptr32, duty: int) -> int:
    """Drive a bridge at duty, -255 ... 255 but not 0. Returns the time (ticks) right before. As in bridges.py."""
    on = ptr32(_OUT_SET)
    off = ptr32(_OUT_CLEAR)
    clock = ptr32(_CLOCK)
    function = ptr32(words[_FUNCTION])
    flip = ptr32(words[_FUNCTION] + _XOR)
    carries = ptr32(words[_CARRIES])
    turn = ptr32(words[_CARRIES] + _XOR)
    slow = words[_CARRIER] ^ words[_ENABLE]
    way = 1 if duty > 0 else 2
    duty = duty if duty > 0 else 0 - duty
    if way != words[_WAY]:
        off[0] = words[_ENABLE]  # before a leg changes
        flip[0] = (function[0] ^ _SIO) & 31
        off[0] = words[_NEG] if way == 1 else words[_POS]
        on[0] = words[_POS] if way == 1 else words[_NEG]
        turn[0] = (carries[0] ^ _SIO) & 31
        words[_WAY] = way
        now = clock[0]
        while clock[0] - now <= words[_DEAD_US]:
            pass
    if slow and way == 2:
        duty = 255 - duty
    now = clock[0]
    if duty == 0:
        off[0] = words[_CARRIER]
        turn[0] = (carries[0] ^ _SIO) & 31
    elif duty == 255:
        on[0] = words[_CARRIER]
        turn[0] = (carries[0] ^ _SIO) & 31
    else:
        pwm = ptr32(words[_COUNTER])
        level = duty * (pwm[2] + 1) // 255
        pwm[1] = (pwm[1] & (0xFFFF << (16 - words[_SHIFT]))) | level << words[_SHIFT]
        out = ptr32(_OUT)
        if (carries[0] & 31) ^ _PWM or (slow and out[0] & words[_ENABLE] == 0):
            pwm[0] = pwm[2]  # a period begins: else a new level waits for that. It does while the drive goes on
        now = clock[0]
        turn[0] = (carries[0] ^ _PWM) & 31
    if slow:
        now = clock[0]
        on[0] = words[_ENABLE]
    return now & _WRAP


class EnableBridge:
    """As bridges.py's, on outputs of this port."""

    def __init__(self, enable, pos, neg, dead_time_us, _pause_us, _ticks_us):
        self.cut = enable.low
        self.made_hz = 0
        self._enable, self._pos = enable, pos
        words = [1 << enable.number, 1 << pos.number, 1 << neg.number, _CONTROL + 8 * enable.number, dead_time_us]
        words += [0] * 5
        for pin in (enable.number, pos.number):
            words += [1 << pin, _CONTROL + 8 * pin, _COUNTERS + 20 * (pin >> 1 & 7), 16 * (pin & 1)]
        self.words = array("I", words)
        self._choose(0)

    def tune(self, hz, slow):
        """From the next drive on: PWM frequency, and slow decay (1) or fast (0). Nothing may drive."""
        self.release()
        self._enable.set_hz(hz)
        self._pos.set_hz(hz)
        self._choose(slow)

    @micropython.viper
    def _choose(self, slow: int):
        words = ptr32(self.words)
        i = 0
        while i < 4:
            words[_CARRIER + i] = words[_CHOICES + 4 * slow + i]
            i += 1

    @micropython.viper
    def cut_at(self, us: int) -> int:
        """Wait for this time (ticks), which must be near, and cut. Returns the time; -1, not cut: a byte waits."""
        clock = ptr32(_CLOCK)
        while (us - _CLOCK_US - clock[0]) << 2 > 0:
            for _ in ipoll_in(0):
                return -1
        return int(_cut(self.words, us))

    @micropython.viper
    def release(self):
        """No drive, coasting; both legs low."""
        words = ptr32(self.words)
        off = ptr32(_OUT_CLEAR)
        function = ptr32(words[_FUNCTION])
        flip = ptr32(words[_FUNCTION] + _XOR)
        carries = ptr32(words[_CARRIES])
        turn = ptr32(words[_CARRIES] + _XOR)
        off[0] = words[_ENABLE] | words[_POS] | words[_NEG]
        flip[0] = (function[0] ^ _SIO) & 31
        turn[0] = (carries[0] ^ _SIO) & 31
        words[_WAY] = 0

    def drive(self, duty):
        """Drive at duty, -255 ... 255 but not 0. Returns the time."""
        return _drive(self.words, duty)


class lane(Lane):  # in lower case, for it is a verb of this port
    """A Lane with a native read() on the input of its Receiver, and a native sum() (docs/gate.md)."""

    def __init__(self, controller, receiver, frame, replies, commands, board):
        super().__init__(controller, receiver, frame, replies, commands)
        from mountfw.board_file import gate_pins  # needed at the start only

        self._cuts = array("I", [0])
        for pins in gate_pins(board):
            for pin in pins:
                self._cuts[0] |= 1 << pin
                self._cuts.append(_CONTROL + 8 * pin)
        self._cuts.append(0)
        self._axis1, self._axis2 = self.axes
        self._drive1, self._drive2 = self._axis1.drive, self._axis2.drive
        self._most = 0  # frames that the log may hold
        if getattr(board, "LANE", True) and isinstance(self._drive1.bridge, EnableBridge):
            self._most = (len(self.log) - _FIRST) // 3
            self._words1, self._words2 = self._drive1.bridge.words, self._drive2.bridge.words
        self._ring = receiver.ring
        self.interrupts = interrupts()
        self._pure = super().sum

    @micropython.viper
    def read(self, most: int, wait_ms: int) -> int:
        """As app.Input.read()."""
        readin = readinto  # a stop in a sleep does not wait for what is looked up before
        poll = ipoll_in
        buffer = byte_in
        byte = ptr8(buffer)
        turn = self.interrupts
        cuts = ptr32(self._cuts)
        receiver = self.receiver
        unparsed = int(receiver.unparsed)
        clock = ptr32(_CLOCK)
        came = cut = mask = left_us = soon = stop = 0
        for _ in poll(wait_ms if wait_ms > 0 else 0):
            came = 1
            break
        since = clock[0]
        waits = came
        if came:
            came = 0
            for _ in turn:  # before the bytes behind a Ctrl-C are read
                came = 1
                break
            if not came:  # it was raised at the last look
                self.interrupts = interrupts()
                return -1
            if unparsed < 64:  # there is room for one more
                readin(buffer)
                waits = 2
                c = byte[0]
                if c == 0x21 or c == 3:
                    cut = 1
        elif wait_ms < 0:
            return -1
        while True:
            if cut:  # every axis, and in this place: a call takes 25 us
                cut = 0
                off = ptr32(_OUT_CLEAR)
                off[0] = cuts[0]
                pin = ptr32(int(cuts) + 4)
                while pin[0]:
                    function = ptr32(pin[0])
                    flip = ptr32(pin[0] + _XOR)
                    flip[0] = (function[0] ^ _SIO) & 31
                    pin = ptr32(int(pin) + 4)
            if mask == 0:  # a stop in the first byte does not wait for this
                if wait_ms >= 0:
                    self.woke_at = since & _WRAP
                    if not came and unparsed < 8:
                        return -1
                ring = ptr8(self._ring)
                mask = int(receiver.mask)
                began = at = int(receiver.write)
                zeros = int(receiver.zeros)
            while most and unparsed <= mask and stop == 0:  # a stop may wait behind any number of frames
                if not waits:
                    soon = 2 if left_us and unparsed == 0 and clock[0] - since < left_us else 0  # the next frame comes
                    for _ in poll(soon):
                        waits = 1
                        break
                    if not waits:
                        break
                if waits == 1:
                    readin(buffer)
                waits = 0
                c = byte[0]
                most -= 1
                zeros = zeros + 1 if c == 0x30 else 0
                if zeros == 8 or c == 0x21 or c == 3:
                    cut = 1
                    stop = int(STOP)
                    if zeros:
                        zeros = 0
                        c = int(EIGHTH_ZERO)
                        stop = int(ZEROS)
                elif c > 0x7F:
                    c = 0x7F
                ring[at] = c
                at = (at + 1) & mask
                unparsed += 1
            if cut:
                continue
            if stop or unparsed < 8 or wait_ms < 0:
                break
            if int(self._obeyed(at - unparsed, mask)) == 0:
                break
            unparsed -= 8
            receiver.ahead = 0
            came = 1
            if left_us == 0:
                left_us = int(self.linger()) if int(self.last) else 1
            most += 8
        if at != began:
            receiver.received_at = (clock[0] - 1000 * soon) & _WRAP
        elif not came:
            return -1
        receiver.write = at
        receiver.unparsed = unparsed
        receiver.zeros = zeros
        if stop:
            receiver.stops_ahead = int(receiver.stops_ahead) + 1
        return stop

    @micropython.viper
    def sum(self, axis, i: int):
        """As Lane.sum()."""
        position = axis.position
        step = int(position.step)
        if int(position.closed) or int(position.gap):
            self._pure(axis, i)
            return
        which = int(self.which)
        log = ptr32(self.log)
        last = log[_WAITING] - 1
        now_us = int(self.until)
        millisteps = int(position.millisteps)
        part = int(position.part)
        k = 1000 if step < 1000000 else 1  # the product must fit
        thousandth = step * k // 1000
        on_us = -1
        made = counted = 0
        while i < last:
            place = _FIRST + 3 * i
            i += 1
            n = log[place] if which else log[place] >> 10
            way = -1 if n & 0x200 else 1
            n &= 0xFF
            if n:
                place += 1 + which
                on_us = (log[place + 3] - log[place]) << 2 >> 2
                left_us = (now_us - log[place]) << 2 >> 2
                if left_us < on_us:
                    on_us = left_us
                if on_us < 0:
                    on_us = 0
                n *= on_us
                counted |= n
                part += n
                n = part // step
                part -= n * step
                made = way * n
                n *= 1000
                if part:
                    n += (part * k + (thousandth >> 1)) // thousandth
                    part = 0
                millisteps += way * n
        if on_us >= 0:
            position.millisteps = millisteps
            position.made = made
            position.part = part
            axis.drive.on_us = on_us
            if counted and int(position.certainty):
                position.certainty = int(codes.ESTIMATED)

    @micropython.viper
    def _obeyed(self, at: int, mask: int) -> int:
        """Drive at the frame in the ring from place `at` on, if it may. Returns 1 if it did."""
        log = ptr32(self.log)
        n = log[_WAITING]
        if n == int(self._most):
            return 0
        packed = int(pack(self._ring, at, mask))
        if packed < 0 or packed & 0x3FCFF == 0:
            return 0
        drive1 = self._drive1
        drive2 = self._drive2
        if n == 0:  # what cannot change in one look()
            c = int(drive1.inhibited) | int(drive1.on_flash) | int(drive1.watched) | int(drive2.watched)
            if c | int(self.receiver.state) | int(self.commands.busy):  # a message before it is not done
                return 0
        if int(drive1.emergency):  # that is one switch for both
            return 0
        n1 = packed >> 10 & 0xFF
        n2 = packed & 0xFF
        at1 = at2 = 0  # what goes off goes first
        i = _FIRST + 3 * n
        clock = ptr32(_CLOCK)
        now = clock[0] & _WRAP  # what takes more bits may be an object, which takes memory
        if n1 == 0 and (log[i - 3] >> 10 & 0xFF if n else int(self._axis1.state)):
            at1 = int(_cut(self._words1, now))
        if n2 == 0 and (log[i - 3] & 0xFF if n else int(self._axis2.state)):
            at2 = int(_cut(self._words2, now))
        if n1:
            at1 = int(_drive(self._words1, 0 - n1 if (packed >> 19) ^ int(drive1.inverted) else n1))
        if n2:
            at2 = int(_drive(self._words2, 0 - n2 if (packed >> 9 & 1) ^ int(drive2.inverted) else n2))
        if int(drive1.emergency):  # meanwhile, by an interrupt: booking ends the moves
            drive1.bridge.cut()
            drive2.bridge.cut()
        log[i] = packed
        log[i + 1] = at1
        log[i + 2] = at2
        log[_WAITING] = n + 1
        return 1
