"""The page that leads a browser to a link with a secret."""

import os
import stat
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest

from mirrormount_panel.cli import page_to

LINK = "http://127.0.0.1:8080/enter#kKq3-0d7LbX_u2mTzR9sWg"


def test_the_address_of_the_page_has_no_secret_and_the_page_is_this_users_alone():
    with page_to(LINK) as address:
        assert "kKq3" not in address
        page = Path(url2pathname(urlsplit(address).path))
        assert f"url={LINK}" in page.read_text()
        if os.name == "posix":
            assert stat.S_IMODE(page.stat().st_mode) == 0o600
    assert not page.exists()


def test_the_page_is_removed_after_an_error_too():
    with pytest.raises(KeyboardInterrupt), page_to(LINK) as address:  # noqa: PT012
        page = Path(url2pathname(urlsplit(address).path))
        raise KeyboardInterrupt
    assert not page.exists()


def test_a_link_without_a_secret_is_opened_as_it_is():
    with page_to("http://127.0.0.1:8080/") as address:
        assert address == "http://127.0.0.1:8080/"
