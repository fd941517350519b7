"""An AS5600 on CircuitPython whose bus fails: the board starts all the same, and does not wait for it again."""

import importlib
import sys
from types import ModuleType

import pytest


class Bus:
    """busio.I2C, with one sensor that may fall silent. Its questions are counted."""

    pulled_up = True
    answers = True
    asked = 0

    def __init__(self, _scl, _sda, frequency):
        if not Bus.pulled_up:
            raise RuntimeError("No pull up found on SDA or SCL; check your wiring")

    def try_lock(self):
        return True

    def writeto_then_readfrom(self, _address, _register, answer):
        Bus.asked += 1
        if not Bus.answers:
            raise OSError(116)  # ETIMEDOUT, after a second
        answer[:] = b"\x20\x01\x00"


@pytest.fixture
def readers(monkeypatch):
    """ports/circuitpython_encoder.py on that bus."""
    Bus.pulled_up, Bus.answers, Bus.asked = True, True, 0
    module = ModuleType("busio")
    vars(module).update(I2C=Bus)
    monkeypatch.setitem(sys.modules, "busio", module)
    name = "mountfw.ports.circuitpython_encoder"
    monkeypatch.delitem(sys.modules, name, raising=False)
    yield importlib.import_module(name)
    sys.modules.pop(name, None)


def test_a_sensor_that_is_not_plugged_in_keeps_no_board_from_starting(readers, capsys):
    Bus.pulled_up = False
    reader = readers.reader(1, {"shaft": (26, 27)}, int)
    assert "No pull up" in capsys.readouterr().out
    assert [reader.counts() for _ in range(100)] == [0] * 100
    assert reader.gone and reader.angle() == -1


def test_a_sensor_that_is_gone_is_asked_no_more(readers):
    reader = readers.reader(1, {"shaft": (26, 27)}, int)
    assert reader.counts() == 256
    assert not reader.gone
    Bus.answers, Bus.asked = False, 0
    for _ in range(100):
        reader.counts()
    assert reader.gone
    assert Bus.asked == 3


@pytest.mark.parametrize("error", [OSError(0x105, "ESP_ERR_NOT_FOUND"), RuntimeError("All PCNT units in use")])
def test_a_board_without_a_free_counter_starts_and_says_that_the_encoder_is_not_fitted(
    readers, monkeypatch, capsys, error
):
    def none_left(*_pins):
        raise error

    module = ModuleType("rotaryio")
    vars(module).update(IncrementalEncoder=none_left)
    monkeypatch.setitem(sys.modules, "rotaryio", module)
    assert readers.reader(1, {"encoder": (8, 9)}, int) is None
    assert "axis 1: encoder not fitted" in capsys.readouterr().out
