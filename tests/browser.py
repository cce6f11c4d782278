"""The pages' scripts run by Node and by Chromium; tests that use them are skipped where these are not installed."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from asterism.report import player_script

NODE, CHROMIUM = shutil.which("node"), shutil.which("chromium") or shutil.which("google-chrome")
needs_node = pytest.mark.skipif(NODE is None, reason="Node.js is not installed")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


def in_node(code: str, folder: Path, *, scripts: str = "", **given: Any) -> Any:
    """What the code returns, with `Asterism` and other scripts loaded and `given` defined; as JSON."""
    assert NODE is not None
    values = "\n".join(f"const {name} = {json.dumps(value)};" for name, value in given.items())
    script = folder / "run.js"
    script.write_text(
        f"{player_script()}\n{scripts}\n{values}\n(async () => {{ {code} }})().then(out => console.log(JSON.stringify(out)));",
        encoding="utf-8",
    )
    return json.loads(subprocess.run([NODE, script], capture_output=True, text=True, check=True, timeout=120).stdout)


def opened(address: str, folder: Path, wanted: str) -> str:
    """The page's elements after its scripts have run, with what is wanted. The browser's clock may run out before: three tries."""
    assert CHROMIUM is not None
    elements = ""
    for attempt in range(3):
        words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / f'profile-{attempt}'}"]
        budget = f"--virtual-time-budget={5000 * 4**attempt}"
        done = subprocess.run([*words, budget, "--dump-dom", address], capture_output=True, text=True, check=True, timeout=120)
        elements = re.sub(r"<script.*?</script>", "", done.stdout, flags=re.DOTALL)
        if re.search(wanted, elements):
            return elements
    raise AssertionError(f"{wanted} is not in {elements[-3000:]}")
