"""Facts about tools/bench/experiments.py, which judges `measure` by rendered pictures: truths, table, runs."""

import math
from dataclasses import replace
from functools import partial

import experiments
import pytest

from mirrormount_beam.experiments import drift
from mirrormount_sim.bench import STEP_X_MRAD, STEP_Y_MRAD
from mirrormount_sim.profiles import ROUGH, SMOOTH


def test_the_true_step_is_that_of_the_paper_and_slower_to_negative_on_the_rough_profile():
    x, y = (experiments.steps_rad(SMOOTH, axis, experiments.STEP_US)[0] * 1e3 for axis in "xy")
    assert x * 2 == pytest.approx(STEP_X_MRAD, rel=0.002)
    assert y * math.sqrt(2) == pytest.approx(STEP_Y_MRAD, rel=0.002)
    there, back = (experiments.steps_rad(ROUGH, "x", way * experiments.STEP_US)[0] for way in (1, -1))
    assert back / there == pytest.approx(1 - ROUGH.negative_slower, rel=0.01)
    assert experiments.steps_rad(ROUGH, "x", 1000, 100)[0] == pytest.approx(0, abs=1e-7)


def test_the_table_counts_both_axes_and_the_four_sides_as_one_quantity():
    found = {
        "x.side_left": (10.0, 1.0, 11.0),
        "y.side_up": (10.0, 1.0, 13.0),
        "x.open": (1.0, 0.1, 1.0),
        "y.open": (1.0, 0.1, 1.1),
    }
    shares = experiments.shares([experiments.Run("square", "smooth", 1, found, 5.0)])
    assert {kind: (share.n, share.inside) for kind, share in shares.items()} == {"side": (2, 1), "open": (2, 2)}
    assert shares["side"].off == pytest.approx(-2.0)


def test_a_run_goes_through_pictures_and_is_kept_and_not_made_again(tmp_path, monkeypatch, capsys):
    short = replace(experiments.EXPERIMENTS["drift"], run=partial(drift.drift, seconds=30.0))
    monkeypatch.setitem(experiments.EXPERIMENTS, "drift", short)
    file = tmp_path / "runs.jsonl"
    words = ["experiments.py", "drift", "--seeds", "1", "--first", "5", "--profile", "rough", "--json", str(file)]
    monkeypatch.setattr("sys.argv", words)
    experiments.main()
    assert len(file.read_text().splitlines()) == 1
    assert "drift, rough: 1 mounts, seeds 5 to 5" in capsys.readouterr().out
    (run,) = experiments.kept_runs(file)
    for value, error, truth in run.found.values():
        assert truth == pytest.approx(0.054, abs=0.001)
        assert abs(value - truth) < 4 * error
    monkeypatch.setattr(experiments, "run_one", pytest.fail)
    experiments.main()
    assert "drift, rough: 1 mounts" in capsys.readouterr().out
