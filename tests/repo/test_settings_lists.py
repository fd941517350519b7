"""The settings of an axis are listed by the firmware, the host, the panel and the documentation: all say the same."""

import re
from pathlib import Path

import pytest

from mirrormount.device import settings as host
from mirrormount.panel.card_of_settings import GROUPS
from mountfw.motion.axis_settings import Parameters
from mountfw.motion.endstop import EndStop
from mountfw.store import SETTINGS, allowed

ROOT = Path(__file__).parent.parent.parent
FIRMWARE = {entry[0].decode(): entry[1:] for entry in SETTINGS}
HUNDREDTHS = {"VA"}  # kept so by the firmware; the wire and the host have decimals


def made() -> Parameters:
    parameters = Parameters(EndStop(None), EndStop(None))
    parameters.factory()
    return parameters


def number(text: str) -> int:
    return int(text.replace(" ", "").replace("\N{MINUS SIGN}", "-"))


def documented() -> dict[str, list[str]]:
    """The rows of protocol.md's two tables of commands: mnemonic to the other cells."""
    rows = {}
    for line in (ROOT / "docs" / "protocol.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        for name in re.findall(r"`n([A-Z]{2})v`", cells[0]) if line.startswith("| `") else ():
            rows[name] = cells[1:]
    return rows


def test_firmware_and_host_have_the_same_settings_by_the_same_names():
    assert {(s.command, name) for name, s in host.SETTINGS.items()} == {(c, e[0]) for c, e in FIRMWARE.items()}


@pytest.mark.parametrize("name", host.SETTINGS)
def test_a_setting_has_one_range(name):
    setting = host.SETTINGS[name]
    _, least, most, _ = FIRMWARE[setting.command]
    scale = 100 if setting.command in HUNDREDTHS else 1
    assert (round(setting.least * scale), round(setting.most * scale)) == (least, most)
    assert setting.decimals == (2 if scale == 100 else 0)
    if most - least < 20:  # where only some of the range is allowed
        taken = {n for n in range(least - 2, most + 20) if allowed(name, n)}
        assert taken == set(setting.among or range(least, most + 1))


def test_the_panel_shows_every_setting_once():
    shown = [name for _, names in GROUPS for name in names]
    assert sorted(shown) == sorted(host.SETTINGS)


def test_every_setting_is_documented():
    assert set(FIRMWARE) <= set(documented())


@pytest.mark.parametrize("command", [command for command in FIRMWARE if command.startswith("X")])
def test_range_and_default_of_a_setting_are_documented(command):
    attribute, least, most, _ = FIRMWARE[command]
    _, span, default = documented()[command]
    assert [number(text) for text in re.split(r"…|,", span)] == [least, most]
    assert number(default) == getattr(made(), attribute)


def test_what_a_setting_is_as_made_is_allowed():
    for attribute, *_ in FIRMWARE.values():
        assert allowed(attribute, getattr(made(), attribute)), attribute


def test_the_documented_range_and_default_of_the_velocity_are_the_firmwares():
    _, least, most, _ = FIRMWARE["VA"]
    (text,) = documented()["VA"]
    assert text.startswith(f"steps per second, {least / 100:g} … {most // 100}, kept in hundredths; default ")
    assert f"default {made().velocity // 100}." in text
