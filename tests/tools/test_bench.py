"""Facts about tools/bench: its statistics, its table, what it reads off edges. No board is started here."""

import random
from pathlib import Path

import pytest
import run
from lab import ENABLES, LOST, first_low_us, last_fall_us, on_times_us
from rows import PAPER_SOURCE, ROWS, Figure, Row
from run import NOT_MODELLED, Measurement, as_json, markdown


def measurement(values, must=9.0, more_is_better=False, p99=False, floor=None) -> Measurement:
    figure = Figure("ms", must, more_is_better, p99)
    return Measurement(Row("row", "what it is", figure, "35 ms", lambda _lab: [], floor=floor), values)


def test_statistics_of_a_known_list():
    values = list(range(1, 201))
    random.Random(1).shuffle(values)
    m = measurement(values)
    assert (m.median, m.p99, m.worst) == (100.5, 198, 200)
    assert m.sd == pytest.approx(57.879, abs=1e-3)


def test_an_error_is_judged_by_its_size_and_spreads_with_its_sign():
    m = measurement([-30.0, 10.0, 20.0])
    assert (m.median, m.worst) == (20, 30)
    assert m.sd == pytest.approx(26.458, abs=1e-3)


def test_the_worst_of_a_rate_is_the_least():
    m = measurement([500.0, 700.0, 600.0], must=500, more_is_better=True)
    assert (m.median, m.p99, m.worst) == (600, 500, 500)
    assert m.meets(500) and not m.meets(1000)


def test_a_limit_is_for_the_worst_value_or_for_the_p99():
    values = [1.0] * 198 + [2.0, 9.0]
    assert measurement(values, must=5).meets(5) is False
    assert measurement(values, must=5, p99=True).meets(5)


def test_a_check_fails_for_a_missed_must_and_a_quick_one_for_a_missed_floor():
    assert measurement([1.0, 3.0], must=3).missed(quick=False) == ""
    assert measurement([1.0, 4.0], must=3).missed(quick=True) == "row: 4 ms, must 3"
    slow = measurement([1.0, 4.0], must=3, floor=4.4)
    assert slow.missed(quick=False) == "row: 4 ms, must 3"
    assert slow.missed(quick=True) == ""
    assert measurement([4.5], must=3, floor=4.4).missed(quick=True) == "row: 4.5 ms, must 3, floor 4.4"


def test_a_floor_stands_only_where_the_must_is_missed():
    floors = [row for row in ROWS if row.floor is not None]
    for row in floors:
        better = row.floor > row.figure.must if row.figure.more_is_better else row.floor < row.figure.must
        assert row.quick and not better, row.name


def test_a_row_with_the_gate_is_measured_without_it_too():
    names = {row.name for row in ROWS}
    for row in ROWS:
        if row.gate:
            assert row.name.removesuffix("-gate") in names


def test_the_newest_official_image_is_taken_where_there_are_some(monkeypatch, tmp_path):
    monkeypatch.delenv("MIRRORMOUNT_IMAGES", raising=False)
    assert run.parse([]).image is None
    for name in ("RPI_PICO-20241129-v1.24.1.uf2", "RPI_PICO-20250911-v1.26.1.uf2", "adafruit-circuitpython.uf2"):
        (tmp_path / name).touch()
    monkeypatch.setenv("MIRRORMOUNT_IMAGES", str(tmp_path))
    assert run.parse([]).image == tmp_path / "RPI_PICO-20250911-v1.26.1.uf2"
    assert run.parse(["--image", "other.bin"]).image == Path("other.bin")


def test_a_quick_run_has_ten_trials_of_the_rows_of_stops_and_frames():
    assert run.parse(["--quick"]).n == 10 and run.parse([]).n == 200
    names = {row.name.split("-")[0] for row in run.chosen("", quick=True)}
    assert names == {"frame", "stop"}


def test_one_number_is_enough():
    m = measurement([3.0], must=3)
    assert (m.median, m.p99, m.worst, m.sd) == (3, 3, 3, None)
    assert m.meets(3)


def test_what_was_lost_keeps_no_limit():
    m = measurement([1.0, 1.0, LOST], must=1_000_000)
    assert m.median == 1 and m.sd is None
    assert m.meets(1_000_000) is False
    assert "lost" in markdown([m])
    (told,) = as_json([m])
    assert told["worst"] is None and told["values"] == [1.0, 1.0, None]


def test_the_table_has_a_line_for_each_row_and_says_what_it_is_not():
    text = markdown([measurement([1.0, 1.5], must=2), measurement([1234.5], must=1000)])
    lines = text.splitlines()
    assert lines[2] == "| what it is | ms | 2 | 1.25 | 1.5 | 1.5 | 0.354 | 2: met | 35 ms |"
    assert lines[3].split(" | ")[3:8] == ["1234", "1234", "1234", "", "1000: **not met**"]
    assert NOT_MODELLED in " ".join(lines)
    assert PAPER_SOURCE in " ".join(lines)


def test_rows_are_chosen_by_name_or_by_its_beginning(capsys):
    assert len({row.name for row in ROWS}) == len(ROWS)
    assert run.chosen("") == list(ROWS)
    assert [row.name for row in run.chosen("rate, hanging-end")] == ["hanging-end", "rate"]
    assert [row.name for row in run.chosen("stop-q")] == ["stop-queries", "stop-queries-gate"]
    with pytest.raises(SystemExit, match="'rum'"):
        run.chosen("rum")
    assert run.main(["--list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == [row.name for row in ROWS]


EDGES = [
    (5, "m1_en", 65535),
    (6, "m2_en", 65535),
    (8, "m1_en", 0),
    (9, "m1_en", 65535),
    (12, "m1_en", 0),
    (14, "m2_en", 0),
]


def test_what_is_read_off_the_edges():
    assert last_fall_us(EDGES, 7) == 14
    assert last_fall_us(EDGES, 7, ("m1_en",)) == 12
    assert last_fall_us(EDGES, 15) == 15
    assert first_low_us(EDGES, 7) == 14
    assert first_low_us(EDGES, 7, {"m1_en"}) == 8
    assert first_low_us(EDGES, 7, ()) == 7
    assert first_low_us(EDGES[:-1], 7, ENABLES) == LOST
    assert on_times_us(EDGES, "m1_en") == [3, 3]


def test_update_replaces_what_is_between_the_marks_of_the_page_and_nothing_else():
    page = run.PAGE.read_text(encoding="utf-8")
    text = run.updated(page, "a table")
    assert text.count("\n\na table\n\n") == 1
    before, after = page.split(run.BEGIN)[0], page.split(run.END)[1]
    assert text.startswith(before + run.BEGIN) and text.endswith(run.END + after)
    assert run.updated(text, "a table") == text


@pytest.mark.parametrize("page", ["no mark", run.BEGIN, run.END + run.BEGIN, f"{run.BEGIN}{run.END}{run.END}"])
def test_a_page_without_its_marks_is_not_written(page):
    with pytest.raises(ValueError, match="once each"):
        run.updated(page, "a table")


def test_a_part_of_the_table_does_not_replace_it(capsys):
    with pytest.raises(SystemExit):
        run.parse(["--update", "--only", "stop"])
    assert "--only" in capsys.readouterr().err
