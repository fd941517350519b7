"""The firmware that was deployed must answer; else what was there before comes back."""

import pytest
from deployed import THEIRS, contents, listed

import mountfw
from mirrormount import errors
from mirrormount.deploy.firmware import firmware
from mirrormount.deploy.micropython import deploy
from mirrormount.deploy.on_board import MANIFEST
from mirrormount.deploy.prompt import Options


def broken(monkeypatch, line: str) -> None:
    """The firmware that deploy has is one whose app.py begins with this line."""
    files = firmware(None)
    files["mountfw/app.py"] = line.encode() + b"\n" + files["mountfw/app.py"]
    monkeypatch.setattr("mirrormount.deploy.micropython.firmware", lambda _mpy: dict(files))


def test_a_new_firmware_that_fails_gives_way_to_the_old_one_and_its_last_line_is_told(deployed, monkeypatch):
    before = contents(deployed.root)
    broken(monkeypatch, "raise RuntimeError('no such thing')")
    with pytest.raises(errors.FirmwareFailed) as e:
        deploy(Options(port=deployed.port))
    assert str(e.value) == (
        "the firmware on the board does not start; it says: RuntimeError: no such thing; the firmware that was there"
        " before is back and answers"
    )
    assert contents(deployed.root) == before
    assert deployed.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"


@pytest.mark.full
def test_a_first_deploy_that_fails_leaves_nothing_that_fails_at_each_boot(boot, monkeypatch):
    board = boot()
    broken(monkeypatch, "import no_such_module")
    with pytest.raises(errors.FirmwareFailed, match=r"no module named 'no_such_module'.*no main\.py, as before"):
        deploy(Options(port=board.port))
    assert contents(board.root) == {}


@pytest.mark.full
def test_a_program_of_somebody_else_is_back_when_the_firmware_fails(boot, tmp_path, monkeypatch):
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "main.py").write_text(THEIRS)
    board = boot()
    broken(monkeypatch, "import no_such_module")
    with pytest.raises(errors.FirmwareFailed, match=r"the main\.py that was there before is back"):
        deploy(Options(port=board.port, replace_main=True))
    assert contents(board.root) == {"main.py": THEIRS.encode()}


@pytest.mark.full
def test_a_firmware_that_starts_and_never_answers_gives_way_too(deployed, monkeypatch):
    before = contents(deployed.root)
    broken(monkeypatch, "import time\nwhile True: time.sleep_ms(50)")
    monkeypatch.setattr("mirrormount.deploy.micropython._BACK_S", 4.0)
    with pytest.raises(errors.FirmwareFailed, match="does not answer; the firmware that was there before is back"):
        deploy(Options(port=deployed.port))
    assert contents(deployed.root) == before


@pytest.mark.full
def test_a_deploy_that_was_ended_before_a_firmware_answered_is_settled_by_the_next(deployed, monkeypatch):
    def end(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        broken(patch, "import no_such_module")
        patch.setattr("mirrormount.deploy.micropython.try_it", end)
        with pytest.raises(KeyboardInterrupt):
            deploy(Options(port=deployed.port))
    assert deployed.deploy().returncode == 0
    files = {f"mountfw/{path}" for path in contents(deployed.root / "mountfw")}
    assert files == listed(deployed.root) - {"main.py"} | {MANIFEST}
