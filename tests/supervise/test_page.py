"""docs/supervise.md: its example runs, and prints what its comments say."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "supervise.md"


@pytest.mark.wall_clock  # the example is stopped by design where it gets no processor for its patience
def test_the_example_of_the_page_runs_and_prints_what_it_says(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    promised = re.findall(r"print\(.*\)  # (.*)", example)
    exec(compile(example, str(PAGE), "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    assert "stopped: the user pressed STOP" in printed
    printed.remove("stopped: the user pressed STOP")
    assert [re.sub(r"on_time_s=[\d.]+", "on_time_s=0.4", line) for line in printed] == promised
