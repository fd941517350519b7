"""The rig on the CircuitPython port: its real clock, console and pins, on the fakes of CircuitPython's modules.

Runs under CPython and under MicroPython. use(FAKES_DIR) makes it the rig of all tests that follow. Files, watchdog,
hash and health stay the rig's own.
"""

import sys

import rig

ON_CPYTHON = sys.implementation.name == "cpython"
MODULES = "_chip board digitalio watchdog microcontroller pwmio select storage supervisor time usb_cdc"


def use(fakes):
    """Take the fakes from this folder (…/fakes; the others are beside it), and the rig's port from here."""
    if ON_CPYTHON:
        import types

        stub = types.ModuleType("micropython")
        stub.heap_lock = stub.heap_unlock = lambda: 0
        sys.modules["micropython"] = stub
    sys.path[:0] = [fakes + "_circuitpython", fakes]
    import _seam

    _seam.seam = _seam.Seam(None, None, rig.START_US)
    for name in MODULES.split():
        sys.modules.pop(name, None)
        if ON_CPYTHON:
            _load(name, fakes + "_circuitpython/" + name + ".py")
        else:
            __import__(name)
    del sys.path[:2]
    rig.Port = _port_class(_seam)


def _load(name, file):
    import importlib.util

    spec = importlib.util.spec_from_file_location(name, file)
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])


def _new_port():
    """The port's modules as after a restart, with every pin free."""
    chip, usb_cdc = sys.modules["_chip"], sys.modules["usb_cdc"]
    chip.in_boot_py = True
    chip.reset()
    usb_cdc.enable(console=True, data=True)
    usb_cdc.plug_in()
    for name in list(sys.modules):
        if name.startswith("mountfw.ports.circuitpython"):
            del sys.modules[name]
    return __import__("mountfw.ports.circuitpython").ports.circuitpython


def _port_class(_seam):
    class Seam(_seam.Seam):
        """The rig's time, input and pins in the place of the simulation's."""

        def __init__(self, port):
            super().__init__(None, None, rig.START_US)
            self._port = port

        def tick(self, us):
            self.t += us
            if self.latched:
                self._show_latched()

        def wait(self, until):
            port = self._port
            at = port.next_us()
            turn = max(self.t, port.horizon_us)
            if self.latched:
                at = min(at, self.latched[0][0])
            self.t = min(at, until, turn)
            self._show_latched()
            return self.t >= turn

        def edge(self, pin, duty, _hz=0):
            port = self._port
            if port.pins.get(pin) != duty:
                locks = self._unlock()
                port.pins[pin] = duty
                port.edges.append((self.t - rig.START_US, pin, duty))
                self._lock(locks)

        def sent(self, c):
            locks = self._unlock()
            self._port.sent.append(c)
            self._lock(locks)

        def received(self):
            return self._port.next_us() <= self.t

        def waiting(self):
            return 1 if self.received() else 0

        def take(self):
            port = self._port
            port.taken += 1
            return port.inbox[port.taken - 1][1]

    class Port(rig.Port):
        """Verbs of ports/circuitpython.py; notes as rig.Port keeps them."""

        ENABLE_IS_LATE = True
        TUNABLE = False

        def __init__(self, files=None):
            self.seam = Seam(self)
            super().__init__(files)
            _seam.seam = self.seam
            self.seam.levels = self.switches
            self.hardware = hw = _new_port()
            self.ticks_us, self.ticks_ms, self.pause_us = hw.ticks_us, hw.ticks_ms, hw.pause_us
            self.any, self.drain, self.pack = hw.any, hw.drain, hw.pack
            self.writable, self.write = hw.writable, hw.write
            self.reader, self.on_rise, self.uninterrupted = hw.reader, hw.on_rise, hw.uninterrupted
            self.TwoPwmBridge = hw.TwoPwmBridge

        def output(self, number, pwm_hz=0):
            self.pins[number] = 0
            return self.hardware.output(number, pwm_hz)

        @property
        def us(self):
            return self.seam.t

        @us.setter
        def us(self, t):
            self.seam.t = t

        @property
        def locked(self):
            return self.seam.locks > 0

        @locked.setter
        def locked(self, locked):
            self.seam.locks = 1 if locked else 0

        @property
        def reading(self):
            return self.seam.collects

        @reading.setter
        def reading(self, reading):
            self.seam.collects = reading

    return Port
