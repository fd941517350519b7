"""Errors and reasons are declared once, with their words: the documents have them, and no board's memory does."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from mirrormount import errors
from mirrormount.deploy.firmware import firmware
from mirrormount.errors import doc_texts
from mirrormount_beam import errors as errors_module
from mountfw import codes

ROOT = Path(__file__).parents[2]
MPY = 6 | 2 << 8  # version 6.2
DECLARED = [("codes", "_error"), ("codes", "_axis_error"), ("codes", "_reason"), ("settings", "_setting")]


@pytest.fixture(scope="module")
def tables():
    """tools/tables.py as a module."""
    spec = importlib.util.spec_from_file_location("mirrormount_tools_tables", ROOT / "tools" / "tables.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tables_of_the_documents_are_what_the_code_declares(tables, capsys):
    assert tables.main(["--check"]) == 0, capsys.readouterr().out


def test_a_table_that_says_another_thing_is_found(tables, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    for name in (*tables.WRITTEN, *tables.COPIED):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text())
    page = tmp_path / "docs" / "errors.md"
    page.write_text(page.read_text().replace("Address 1, or none.", "Address 2."))
    assert tables.main(["--check"]) == 1
    assert capsys.readouterr().out.startswith("docs/errors.md ")
    assert "Address 2." in page.read_text()
    assert tables.main([]) == 0
    assert page.read_text() == (ROOT / "docs" / "errors.md").read_text()


def test_every_error_of_the_board_has_a_message_a_cause_and_a_remedy():
    numbers = {str(n) for n in codes.MESSAGES if n} | {f"n{n:02d}" for n in codes.AXIS_MESSAGES}
    assert set(errors.board_remedies()) == numbers
    for number in numbers:
        shown = errors.remedy_of(number.replace("n", "2"))
        assert shown and shown.cause and shown.remedy
        assert "`" not in "".join(shown) and "](" not in "".join(shown)


def test_a_number_below_100_is_the_boards_and_above_it_an_axiss():
    assert errors.remedy_of("6") != errors.remedy_of("106") == errors.remedy_of("206")
    assert errors.remedy_of("399") is errors.remedy_of("") is errors.remedy_of("nine") is None


def test_every_error_of_the_host_has_a_cause_and_a_remedy():
    kinds = {
        name
        for name, kind in (vars(errors) | vars(errors_module)).items()
        if isinstance(kind, type)
        and issubclass(kind, errors.MountError)
        and kind not in (errors.MountError, errors.CannotOpen)
    }
    assert set(errors.host_remedies()) == kinds
    assert all(cause and remedy for cause, remedy in errors.host_remedies().values())


def test_every_reason_has_words_and_a_meaning():
    assert list(codes.REASONS) == list(range(len(codes.REASONS))), "reasons are numbered from 0 on, without a gap"
    assert [vars(codes)[name] for name in doc_texts("codes", "_reason")] == list(codes.REASONS)
    assert all(codes.REASONS.values())


def test_the_words_for_people_do_not_go_to_a_board():
    compiled = b"".join(content for path, content in firmware(MPY).items() if path.endswith(".mpy"))
    source = b"".join(firmware(None).values())
    for message in codes.MESSAGES.values():
        assert message in compiled
    for module, maker in DECLARED:
        found = doc_texts(module, maker)
        assert len(found) > 10
        for text in found.values():
            words = text.split("\n")[0].encode()
            assert words in source
            assert words not in compiled


def test_the_words_are_read_when_they_are_first_shown():
    code = (
        "import sys; from mirrormount.cli import main; import mirrormount.device.mount, mirrormount.errors;"
        "main.parser([*main.MODULES]); from mirrormount import errors; print(errors.doc_texts.cache_info().misses)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "0\n"
