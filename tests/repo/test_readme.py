"""The README's Python lines do what they say."""

import re
from pathlib import Path

README = Path(__file__).parent.parent.parent / "README.md"


def test_the_ten_lines_of_the_readme_run(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert code.count('"virtual://"') == 1
    exec(compile(code.replace("virtual://", "virtual://?speed=max"), "README.md", "exec"), {})
    assert capsys.readouterr().out == "5.0 unknown\n"


def test_every_shell_command_of_the_readme_exists():
    from mirrormount.cli import _parser

    parser = _parser()
    lines = re.findall(r"^mirrormount (.*?) *(?:#.*)?$", README.read_text(), re.MULTILINE)
    assert len(lines) >= 5
    for line in lines:
        parser.parse_args(line.split())
