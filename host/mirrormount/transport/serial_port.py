"""A serial port, opened by pyserial. Imports errors, failures, port."""

import os
import time

import serial

from mirrormount.common.errors import BadAddress, ConnectionLost
from mirrormount.transport.failures import open_error
from mirrormount.transport.port import WRITE_S

_TICK_S = 0.02  # a serial read returns at least this often


class SerialPort:
    """A port that pyserial opens: a device's name, or one of pyserial's URLs. Raises BadAddress, CannotOpen."""

    lockstep = False

    def __init__(self, address: str) -> None:
        try:
            self._serial = serial.serial_for_url(address, baudrate=115200, timeout=_TICK_S, do_not_open=True)
            if "://" not in address:
                self._serial.exclusive = True if os.name == "posix" else None
            self._serial.write_timeout = WRITE_S
            self._serial.open()
        except ValueError as e:
            raise BadAddress(f"{address}: not a port's address") from e
        except (OSError, serial.SerialException) as e:
            raise open_error(address, e) from e

    def read(self, timeout_s: float) -> bytes:
        """Bytes that are there, or arrive within timeout_s; b"" if none. Raises ConnectionLost."""
        end = time.monotonic() + timeout_s
        try:
            while True:
                data = self._serial.read(1)
                if data:
                    return data + self._serial.read(self._serial.in_waiting or 0)
                if time.monotonic() >= end:
                    return b""
        except (OSError, serial.SerialException, TypeError) as e:  # TypeError: closed in another thread
            raise ConnectionLost(f"{self._serial.port} has gone") from e

    def write(self, data: bytes) -> None:
        """Send bytes. Raises ConnectionLost."""
        try:
            self._serial.write(data)
        except (OSError, serial.SerialException, TypeError) as e:  # TypeError: closed in another thread
            raise ConnectionLost(f"{self._serial.port} has gone, or takes nothing") from e

    def close(self) -> None:
        """Close the port."""
        self._serial.close()
