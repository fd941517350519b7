"""In a notebook: an interrupted cell stops the mount, and what is shown is what was last known, never a question."""

import html

import pytest
from served import ServedBoard

from mirrormount import errors
from mirrormount.device.mount import Mount


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


@pytest.fixture
def interrupted(mount, monkeypatch):
    """The second time that something waits, Ctrl-C comes."""
    sleep, waits = mount.link.sleep, []

    def wait(seconds: float) -> None:
        waits.append(seconds)
        sleep(seconds)
        if len(waits) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(mount.link, "sleep", wait)
    return mount


@pytest.mark.parametrize(
    "cell",
    [
        lambda mount: mount.x.step(5),
        lambda mount: mount.x.move_to(-5),
        lambda mount: (mount.x.step(5, wait=False), mount.x.wait()),
        lambda mount: (mount.x.jog(0.5), mount.sleep(5)),
        lambda mount: (mount.drive(100, 100), mount.sleep(5)),
    ],
    ids=["step", "move_to", "wait", "jog", "drive"],
)
def test_an_interrupted_cell_stops_both_motors_at_once(interrupted, cell):
    mount = interrupted
    with pytest.raises(KeyboardInterrupt):
        cell(mount)
    simulation = mount.link.port.simulation
    assert not any(simulation.bench.duties().values())
    assert mount.status().x.reason == 3
    ons = [t for t, pin, duty in simulation.edges if pin == "m2_en" and duty]
    assert len(ons) == 1, "another step began after the interrupt"


def test_an_interrupted_search_for_a_switch_stops_too(monkeypatch):
    with Mount.open("virtual://?speed=max&bench=switches") as mount:
        mount.apply({"x": {"switches": 3}})
        monkeypatch.setattr(mount.link, "sleep", lambda seconds: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            mount.x.home()
        assert not any(mount.link.port.simulation.bench.duties().values())
        assert not mount.status().moving


def test_what_is_shown_is_the_last_status_with_its_age(mount):
    mount.x.step(3)
    mount.link.sleep(2.0)
    edges = len(mount.link.port.simulation.edges)
    now = mount.link.monotonic()
    assert repr(mount.x) == "<Axis x: +3.000 steps (unknown), at rest, as it was 2.0 s ago>"
    assert repr(mount).startswith(f"<Mount {mount.identity}: x: +3.000 steps (unknown), at rest; y: +0.000 steps")
    for shown in (mount, mount.x, mount.status(), mount.status().x):
        assert shown._repr_html_().startswith("<table>") and "+3.000" in shown._repr_html_()
    mount.session.board.last = None
    assert repr(mount.x) == "<Axis x: not seen yet>"
    assert mount.x._repr_html_() == html.escape(repr(mount.x))
    assert len(mount.link.port.simulation.edges) == edges and mount.link.monotonic() - now < 1


def test_what_is_shown_needs_no_board(board: ServedBoard):
    mount = Mount.open(str(board.link))
    board.kill()
    mount.link.port.read = mount.link.port.write = None  # whoever asks the board fails
    assert "steps (unknown), at rest; as it was " in repr(mount)
    mount.close()
    assert repr(mount).endswith("; closed>") and "closed" in repr(mount.x)


def test_a_port_that_this_program_has_open_says_so_and_how_to_go_on(board: ServedBoard):
    for address in (str(board.link), board.tcp):
        with Mount.open(address) as mount:
            with pytest.raises(errors.PortBusy, match=r"this program has this port open already.*close\(\) it first"):
                Mount.open(address)
            mount.x.step(1)  # the one that is open is none the worse
        Mount.open(address).close()
