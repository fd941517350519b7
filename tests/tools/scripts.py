"""The scripts of tools/ as modules, for the tests of them."""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def load(name, register_as):
    """A script of tools/ as a module, registered so that the scripts can import each other."""
    spec = importlib.util.spec_from_file_location(register_as, ROOT / "tools" / name)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[register_as] = module
    spec.loader.exec_module(module)
    return module


bootstrap = load("_bootstrap.py", "_bootstrap")
demo = load("demo.py", "mirrormount_tools_demo")
mechanics = load("mechanics/make.py", "mirrormount_tools_mechanics")
checks = load("test.py", "mirrormount_tools_test")
release = load("release.py", "mirrormount_tools_release")
