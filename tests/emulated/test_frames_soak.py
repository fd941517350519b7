"""tools/bench/frames_soak.py on the emulated board: it reports, and notices a stop that is late."""

import frames_soak
import pytest

pytestmark = [pytest.mark.full, pytest.mark.usefixtures("emulator_works")]


def test_every_frame_of_a_train_is_obeyed_and_the_stop_after_it_cuts(tmp_path):
    file = tmp_path / "soak.md"
    assert frames_soak.main(["--frames", "1500", "--report", str(file)]) == 0
    text = file.read_text(encoding="utf-8")
    assert "| frames obeyed, in their order | 1500 |" in text
    assert "| what must not have happened | 0 |" in text


def test_the_soak_of_frames_notices_late_stops(tmp_path):
    file = tmp_path / "soak.md"
    assert frames_soak.main(["--frames", "300", "--without-gate", "--report", str(file)]) == 1
    assert "- more than one stop in a hundred was late" in file.read_text(encoding="utf-8")
