"""The traffic that opens docs/protocol.md, played on a virtual board."""

import re
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep

PROTOCOL = Path(__file__).parent.parent.parent / "docs" / "protocol.md"


@pytest.mark.parametrize(("name", "encoder"), [("traffic", None), ("traffic with encoders", "motor")])
def test_the_documents_traffic_is_real(name, encoder):
    (block,) = re.findall(f"```{name}\n(.*?)```", PROTOCOL.read_text(), re.DOTALL)
    simulation = make_simulation(Options(encoder=encoder))
    board = Lockstep(simulation)
    board.run(100_000)
    played = 0
    try:
        for message in re.split(r"^> ", block, flags=re.MULTILINE)[1:]:
            sent, *expected = message.splitlines()
            text = re.split(r" {2,}", sent)[0]
            is_frame = re.fullmatch(r"[0+-]\d{3}[0+-]\d{3}", text)
            board.received.clear()
            board.send(text.encode() + (b"" if is_frame else b"\n"))
            board.run(90_000)  # longer than the pause that ends a refused frame
            answers = board.received.decode().splitlines()
            assert len(answers) == len(expected), (text, answers)
            for answer, line in zip(answers, expected, strict=True):
                assert line.startswith("< ") and fnmatchcase(answer, line[2:]), (text, answer, line)
            played += 1
    finally:
        simulation.close()
    assert played >= 10
