"""What `mkdocs build` does beside docs/: a hook of mkdocs.yml.

README.md becomes the first page, CHANGELOG.md and CONTRIBUTING.md pages of their own. Their links, and those to them,
are changed to match. Files in docs/, such as the examples, are part of the site. A link to any other file, or to a
folder, becomes its name: the site has no copy of the code.
"""

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parent.parent
PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
LINK = re.compile(r"\[([^\]]+)\]\(([^)#:]+)(#[^)]*)?\)")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that stand outside docs/."""
    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=LINK.sub(lambda m: _link(m, ROOT), text)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """The links of a page of docs/; and a block of code has a language alone, without a mark for the tests."""
    markdown = re.sub(r"^```(\w+) .+$", r"```\1", markdown, flags=re.MULTILINE)
    return markdown if page.file.src_path in PAGES.values() else LINK.sub(lambda m: _link(m, ROOT / "docs"), markdown)


def _link(found: re.Match[str], folder: Path) -> str:
    """A link, seen from docs/."""
    text, target, anchor = found[1], found[2], found[3] or ""
    path = (folder / target).resolve()
    if path.parent == ROOT and path.name in PAGES:
        return f"[{text}]({PAGES[path.name]}{anchor})"
    if path.is_relative_to(ROOT / "docs") and path.is_file():
        return f"[{text}]({path.relative_to(ROOT / 'docs').as_posix()}{anchor})"
    return text
