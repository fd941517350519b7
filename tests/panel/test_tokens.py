"""Tokens: where they come from, which are too short, and how fast they can be guessed."""

import secrets

import pytest

from mirrormount import errors
from mirrormount_panel.auth import Guesses, is_short, read_token, same


def test_a_token_is_given_or_in_a_file_or_in_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_TOKEN", "of-the-environment")
    file = tmp_path / "token"
    file.write_text("of-the-file\r\nand more\n")
    assert read_token("given") == b"given"
    assert read_token(None, file) == b"of-the-file"
    assert read_token(None) == b"of-the-environment"
    monkeypatch.delenv("MIRRORMOUNT_TOKEN")
    assert read_token(None) is None


@pytest.mark.parametrize("content", [b"", b"\n", b"t\xc3\xb6ken\n", b"x" * 300, b"two words \n"])
def test_a_file_that_holds_no_token_is_refused(tmp_path, content):
    file = tmp_path / "token"
    file.write_bytes(content)
    with pytest.raises(errors.BadValue):
        read_token(None, file)


def test_a_file_that_is_not_there_or_one_too_many_is_refused(tmp_path):
    with pytest.raises(errors.BadValue, match="cannot be read"):
        read_token(None, tmp_path / "none")
    with pytest.raises(errors.BadValue, match="one of them"):
        read_token("given", tmp_path / "none")


@pytest.mark.parametrize("token", [b"x", b"mirror", b"correct horse", b"0123456789" * 3, b"ab" * 60])
def test_what_can_be_guessed_is_short(token):
    assert is_short(token)


def test_what_the_secrets_module_makes_is_not_short():
    assert not is_short(None)
    for token in (secrets.token_urlsafe(), secrets.token_hex(16), secrets.token_urlsafe(16)):
        assert not is_short(token.encode())
    assert not is_short(b"bCjmDKcAVyJgeJtuYwPdSQ")  # of 128 bits, without a digit


def test_guesses_are_slowed_down_for_their_own_address_only():
    now = [100.0]
    guesses = Guesses(lambda: now[0])
    for _ in range(5):
        assert guesses.wait_s("192.0.2.1") == 0
        guesses.wrong("192.0.2.1")
    assert guesses.wait_s("192.0.2.1") == 1
    assert guesses.wait_s("192.0.2.2") == 0
    now[0] += 1
    assert guesses.wait_s("192.0.2.1") == 0
    guesses.wrong("192.0.2.1")
    assert guesses.wait_s("192.0.2.1") == 1
    now[0] += 60
    assert guesses.wait_s("192.0.2.1") == 0


def test_addresses_that_guess_do_not_fill_the_memory():
    guesses = Guesses()
    for n in range(3000):
        guesses.wrong(f"192.0.2.{n}")
    assert len(guesses._wrong) == 1000


def test_tokens_are_compared_whole():
    assert same(b"secret", b"secret")
    assert not same(b"secre", b"secret") and not same(b"", b"secret")
