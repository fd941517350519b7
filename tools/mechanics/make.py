"""Make the files of the printed parts, with nothing but Python: python3 tools/mechanics/make.py [MOUNT ...]

Makes .venv, installs build123d there, and writes STEP, STL, DXF, drawings and the bill of materials of each mount to
build/mechanics. MOUNT is u100, km100, polaris-k1 or a TOML file with your measures; docs/build.md says more.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import List

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
import _bootstrap as bootstrap

LOCK = "tools/mechanics/requirements.txt"


def main(arguments: List[str]) -> int:
    """Prepare .venv, then write the files; paths are those of the caller's folder."""
    bootstrap.prepare("mechanics", LOCK)
    program = Path(__file__).resolve().parent / "files.py"
    return bootstrap.call([str(bootstrap.PYTHON), str(program), *arguments], cwd=None)


if __name__ == "__main__":
    sys.exit(bootstrap.guarded(main))
