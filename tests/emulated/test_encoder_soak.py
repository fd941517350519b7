"""tools/bench/encoder_soak.py on the emulated board: it reports, and notices a count that was lost."""

import encoder_soak
import pytest

pytestmark = [pytest.mark.full, pytest.mark.usefixtures("emulator_works")]


def test_a_round_of_the_encoders_soak_loses_no_count(tmp_path):
    file = tmp_path / "soak.md"
    assert encoder_soak.main(["--steps", "1", "--report", str(file)]) == 0
    assert "| counts lost | 0 |" in file.read_text(encoding="utf-8")


def test_the_encoders_soak_notices_lost_edges(tmp_path):
    file = tmp_path / "soak.md"
    assert encoder_soak.main(["--steps", "1", "--fault", "lost", "--report", str(file)]) == 1
    assert "| counts lost | 0 |" not in file.read_text(encoding="utf-8")
