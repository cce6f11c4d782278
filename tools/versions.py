"""The tests with other versions than those that pip installs today, in an environment of their own.

    python tools/versions.py oldest                  # the oldest dependencies that pyproject.toml allows
    python tools/versions.py python3.13              # today's dependencies with another interpreter
    python tools/versions.py oldest tests/test_cli.py    # what pytest shall run; else everything

Needs the network. The environment is kept, and taken again by the next run: `--folder` names its place.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PROJECT = f"{ROOT}[dev]"


def environment(which: str, folder: Path) -> Path:
    """Make the environment, or bring it up to date; return its Python."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        subprocess.run([sys.executable if which == "oldest" else which, "-m", "venv", str(folder)], check=True)
    subprocess.run([python, "-m", "pip", "install", "-q", "--disable-pip-version-check", "uv"], check=True)
    resolution = "lowest-direct" if which == "oldest" else "highest"
    subprocess.run([python, "-m", "uv", "pip", "install", "-q", "--python", python, "--resolution", resolution, "-e", PROJECT], check=True)
    return python


def main(arguments: Sequence[str]) -> int:
    """Run the tests; return pytest's exit status."""
    parser = argparse.ArgumentParser(description="The tests with other versions than those that pip installs today.")
    parser.add_argument("which", help='"oldest", or the interpreter to take, such as python3.13')
    parser.add_argument("--folder", type=Path, help="where the environment is kept; a temporary folder if not given")
    chosen, rest = parser.parse_known_args(arguments)
    name = "".join(letter if letter.isalnum() else "-" for letter in chosen.which)
    folder = chosen.folder or Path(tempfile.gettempdir()) / f"asterism-{name}"
    python = environment(chosen.which, folder)
    subprocess.run([python, "-m", "uv", "pip", "list", "--python", python], check=True)
    tests = [python, "-m", "pytest", "-q", "-n", "auto", "--dist", "loadfile", *rest]
    return subprocess.run(tests, cwd=ROOT, env={"OPENBLAS_NUM_THREADS": "1", **os.environ}).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
