"""A setting is declared once, in mountfw/settings.py: the axis, the host and the wire have what it says."""

import itertools
import re

import pytest
from rig import Rig
from rig_encoder import encoded

from mirrormount.device import settings as host
from mountfw import settings as declared
from mountfw.encoder.settings import ENCODER_SETTINGS

ALL = [*declared.SETTINGS, *ENCODER_SETTINGS]
NAMES = [entry[1] for entry in ALL]


def test_no_name_and_no_mnemonic_is_declared_twice():
    assert len(NAMES) == len(set(NAMES)) >= 14
    assert len({entry[0] for entry in ALL}) == len(NAMES)


def test_the_host_has_the_settings_that_the_firmware_has():
    assert [(s.name, s.command.encode()) for s in host.SETTINGS.values()] == [(e[1], e[0]) for e in ALL]
    assert list(host.SETTINGS) == NAMES


@pytest.mark.parametrize("entry", ALL, ids=NAMES)
def test_a_setting_is_what_it_is_declared_to_be(entry):
    command, name, least, most, default, _ = entry
    assert re.fullmatch(rb"[A-Z]{2}", command) and re.fullmatch(r"[a-z_]+", name)
    assert -(1 << 30) < least < most < 1 << 30  # a board's integers are small ones
    assert declared.allowed(entry, default)
    of_encoder = entry in ENCODER_SETTINGS
    axis = (encoded(settings=b"") if of_encoder else Rig()).axis1
    assert declared.named(name, declared.entries_of(axis)) is entry
    assert getattr(axis, name) == default


@pytest.mark.parametrize("entry", ALL, ids=NAMES)
def test_the_host_allows_what_the_board_allows(entry):
    setting = host.SETTINGS[entry[1]]
    scale = 100 if entry[5] & declared.HUNDREDTHS else 1
    assert 10**setting.decimals == scale
    assert (round(setting.least * scale), round(setting.most * scale)) == (entry[2], entry[3])
    assert setting.default * scale == entry[4]
    if entry[3] - entry[2] < 20:  # where only some of the range is allowed
        taken = {n for n in range(entry[2] - 2, entry[3] + 20) if declared.allowed(entry, n)}
        assert taken == set(setting.among or range(entry[2], entry[3] + 1))


@pytest.mark.parametrize("name", NAMES)
def test_a_setting_has_words_for_a_person_and_a_group(name):
    setting = host.SETTINGS[name]
    assert 5 < len(setting.what) < 60 and setting.group
    for ending, unit in (("_us", "us"), ("_ms", "ms")):
        assert not name.endswith(ending) or re.search(rf", {unit}\b", setting.what)


def test_the_settings_of_a_group_stand_together():
    groups = [setting.group for setting in host.SETTINGS.values()]
    assert sum(a != b for a, b in itertools.pairwise(groups)) == len(set(groups)) - 1
