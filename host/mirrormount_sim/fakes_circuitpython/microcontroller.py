"""microcontroller on the virtual CircuitPython board: an RP2040's. Every write is checked for range."""

import _chip
import _seam
from watchdog import WatchDogMode


class ResetReason:
    POWER_ON = "POWER_ON"
    SOFTWARE = "SOFTWARE"
    WATCHDOG = "WATCHDOG"


class HardReset(BaseException):
    """Everything starts again, boot.py first."""


class _Cpu:
    uid = bytearray(b"\xe6\x61\x64\x08\x43\x2f\x5a\x21")
    reset_reason = ResetReason.POWER_ON


class _Pins:
    """microcontroller.pin: GPIO0 and so on."""


cpu = _Cpu()
pin = _Pins()
for _number in _chip.gpio:
    setattr(pin, "GPIO%d" % _number, _chip.gpio[_number])


def delay_us(delay):
    if not isinstance(delay, int) or delay < 0:
        raise ValueError("delay must be >= 0")
    s = _seam.seam
    until = s.t + delay
    while s.t < until:
        s.tick(min(until - s.t, 50))


def reset():
    cpu.reset_reason = ResetReason.SOFTWARE
    raise HardReset


class _Watchdog:
    """Here it is only when it is fed too late that it is seen to have bitten."""

    def __init__(self):
        self._timeout_s = 5
        self._mode = None
        self._fed_at = 0

    @property
    def timeout(self):
        return float(self._timeout_s)

    @timeout.setter
    def timeout(self, seconds):
        if not 0 <= seconds <= 8:
            raise ValueError("timeout must be <= 8")
        self._timeout_s = seconds

    @property
    def mode(self):
        return self._mode

    @mode.setter
    def mode(self, mode):
        if mode == WatchDogMode.RAISE:
            raise NotImplementedError("RAISE mode")  # as CircuitPython itself does
        if mode not in (None, WatchDogMode.RESET):
            raise TypeError("mode must be of type WatchDogMode")
        self._mode = mode
        self._fed_at = _seam.seam.t

    def feed(self):
        s = _seam.seam
        s.tick(1)
        if self._mode and s.t - self._fed_at > self._timeout_s * 1_000_000:
            self._mode = None
            cpu.reset_reason = ResetReason.WATCHDOG
            raise HardReset
        self._fed_at = s.t


watchdog = _Watchdog()


class _Nvm:
    """One flash sector in a file. Erased bytes can be programmed; any other write erases the whole sector."""

    def __init__(self, path, size=4096):
        self._path = path
        try:
            with open(path, "rb") as f:
                self._data = bytearray(f.read())
        except OSError:
            self._data = bytearray(b"\xff" * size)

    def __len__(self):
        return len(self._data)

    def __getitem__(self, key):
        return self._data[key] if isinstance(key, int) else bytearray(self._data[key])

    def __setitem__(self, key, value):
        if isinstance(key, int):
            if not 0 <= value <= 255:
                raise ValueError("bytes must be 0-255")
            key, value = slice(key, key + 1), bytes((value,))
        before = self._data[key]
        if len(before) != len(value):
            raise ValueError("Slice and value different lengths.")
        erased = all(c == 0xFF for c in before)
        _seam.seam.tick(700 if erased else 45_000)  # about a page's program, a sector's erase
        self._data[key] = value
        with open(self._path, "wb") as f:
            f.write(self._data)


nvm = _Nvm("nvm.bin")
