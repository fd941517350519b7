"""A setting is declared once, in mountfw/settings.py: the axis, the host and the wire have what it says.

What is not made of the declaration is held to it here: its name and its mnemonic are new, and the lists that a person
writes have it.
"""

import ast
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from rig import Rig
from rig_encoder import encoded

from mirrormount.device import settings as host
from mirrormount.device.axis import Axis as HostAxis
from mirrormount.device.axis import Property
from mountfw import settings as declared
from mountfw.dialect import commands, encoder, newfocus
from mountfw.dialect.line import key
from mountfw.encoder.axis import EncodedAxis
from mountfw.settings import ENCODER_SETTINGS

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware_py" / "mountfw"
ALL = [*declared.SETTINGS, *ENCODER_SETTINGS]
NAMES = [entry[1] for entry in ALL]
MNEMONICS = [entry[0].decode() for entry in ALL]
OF_AN_AXIS = ("settings.py", "motion/actions.py", "motion/axis.py", "encoder/axis.py")  # files whose `self` is an axis
SET_BY_THE_AXIS = {"inverted", "soft_minimum", "soft_maximum", "closed_loop"}  # settings that its code assigns


def test_no_name_and_no_mnemonic_is_declared_twice():
    assert len(NAMES) == len(set(NAMES)) >= 14
    assert len(set(MNEMONICS)) == len(NAMES)


def test_no_mnemonic_is_that_of_a_command(monkeypatch):
    # the table of a board with an encoder, as it is without settings and without what stands in for an encoder's
    monkeypatch.setattr(commands, "_SETTINGS", {})
    monkeypatch.setattr(newfocus, "_ENCODER", ())
    monkeypatch.setattr(encoder, "ENCODER_SETTINGS", [])
    rows = encoded(settings=b"").app._commands._commands
    assert {key(b"XS"), key(b"XC"), key(b"SA")} <= set(rows)
    taken = [mnemonic for mnemonic in MNEMONICS if key(mnemonic.encode()) in rows]
    assert not taken, f"{', '.join(taken)} is taken"


def assigned(path: Path) -> Iterator[str]:
    """The attributes that a file of the firmware gives to an axis."""
    names = ("axis", "self") if path.relative_to(FIRMWARE).as_posix() in OF_AN_AXIS else ("axis",)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and ast.unparse(node.value) in names:
            yield node.attr


def test_no_name_is_that_of_another_attribute_of_the_axis():
    # a value would replace it: setattr(axis, name, value)
    made = {name for path in FIRMWARE.rglob("*.py") for name in assigned(path)}
    assert {"state", "next_at", "receiver", "next"} <= made
    assert made >= SET_BY_THE_AXIS
    taken = [name for name in NAMES if name in (made - SET_BY_THE_AXIS) | set(dir(EncodedAxis))]
    assert not taken, f"the firmware's axis has another {', '.join(taken)} (if not, add it to SET_BY_THE_AXIS)"


def test_no_name_is_that_of_another_attribute_of_the_hosts_axis():
    others = {name for kind in HostAxis.__mro__ for name, is_ in vars(kind).items() if not isinstance(is_, Property)}
    assert {"jog", "limits", "status"} <= others
    taken = [name for name in NAMES if name in others]
    assert not taken, f"mount.x has another {', '.join(taken)}"


def test_without_an_encoder_the_mnemonics_of_its_settings_are_answered():
    wanted = {"SN"} | {entry[0].decode() for entry in ENCODER_SETTINGS}
    assert set(newfocus._ENCODER) == wanted, "add it to _ENCODER of mountfw/dialect/newfocus.py"


def test_type_checkers_know_the_settings_of_an_encoder():
    known = EncodedAxis.__annotations__.keys() | vars(EncodedAxis).keys()
    missing = [entry[1] for entry in ENCODER_SETTINGS if entry[1] not in known]
    assert not missing, f"add {', '.join(missing)} to the attributes of EncodedAxis"


def mnemonics_in(row: str) -> list[str]:
    """The two letters of each command that a row of docs/protocol.md names in its first column."""
    page = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    (first,) = re.findall(rf"^\| (.*{row})", page, re.MULTILINE)
    return re.findall(r"\bn?([A-Z]{2})\b", first.partition(" | ")[0])


def test_the_rows_of_the_protocol_that_list_settings_list_all():
    of_encoder = [entry[0].decode() for entry in ENCODER_SETTINGS]
    found = mnemonics_in(r"of an encoder, \[below\]")
    assert sorted(found) == sorted(of_encoder), "docs/protocol.md: the row of an encoder's commands"
    at_rest = [entry[0].decode() for entry in ALL if entry[5] & declared.AT_REST]
    found = mnemonics_in("refused, n14; every other setting")
    assert sorted(found) == sorted([*at_rest, "DH"]), "docs/protocol.md: Who may interrupt whom, the settings with n14"


def test_the_host_has_the_settings_that_the_firmware_has():
    assert [(s.name, s.command.encode()) for s in host.SETTINGS.values()] == [(e[1], e[0]) for e in ALL]
    assert list(host.SETTINGS) == NAMES


@pytest.mark.parametrize("entry", ALL, ids=NAMES)
def test_a_setting_is_what_it_is_declared_to_be(entry):
    command, name, least, most, default, _ = entry
    assert re.fullmatch(rb"[A-Z]{2}", command), f"{command.decode()}: a mnemonic has exactly two capital letters"
    assert re.fullmatch(r"[a-z_]+", name), f"{name}: a name has small letters and underscores"
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
    assert setting.group, f"{name}: its words begin with a group"
    assert 5 < len(setting.what) < 60, f"{name}: the words after the group have 6 to 59 characters"
    for ending, unit in (("_us", "us"), ("_ms", "ms")):
        has_unit = re.search(rf", {unit}\b", setting.what)
        assert has_unit or not name.endswith(ending), f"{name}: its words have its unit: `, {unit}`"


def test_the_settings_of_a_group_stand_together():
    groups = [setting.group for setting in host.SETTINGS.values()]
    begun = [b for a, b in itertools.pairwise(["", *groups]) if a != b]
    assert len(begun) == len(set(begun)), f"a group is in two places: {', '.join(begun)}"
