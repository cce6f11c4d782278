"""A page in; the same on A4 sheets, printed by a browser that is installed, out."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge", "microsoft-edge")
_PLACES = {
    "darwin": (
        "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
        "/Applications/Chromium.app/Contents/MacOS/Chromium",
        "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    ),
    "win32": tuple(
        rf"{os.environ.get(folder, '')}\{program}"
        for folder in ("PROGRAMFILES", "PROGRAMFILES(X86)", "LOCALAPPDATA")
        for program in (r"Google\Chrome\Application\chrome.exe", r"Microsoft\Edge\Application\msedge.exe")
    ),
}
"""Where browsers stand that are not on the path."""
_PATIENCE = 120
"""s: a page of many walks prints in two to five, on a busy computer in twenty."""


def find_browser() -> str:
    """The program that prints: Chromium, Chrome or Edge. Raises AsterismError where none is installed."""
    for name in _NAMES:
        if (found := shutil.which(name)) is not None:
            return found
    for place in _PLACES.get(sys.platform, ()):
        if Path(place).is_file():
            return place
    raise AsterismError("no Chromium, Chrome or Edge was found to print a PDF; install one, or print the page of --report from a browser.")


def print_page(page: str | Path, pdf: str | Path) -> None:
    """Print an HTML file to a PDF file, whole or not at all. Raises AsterismError without a browser, or where it fails."""
    browser = find_browser()
    with TemporaryDirectory(prefix="asterism-", ignore_cleanup_errors=True) as folder:
        out = Path(folder) / "page.pdf"
        words = [browser, "--headless", "--disable-gpu", "--no-first-run", f"--user-data-dir={folder}/profile", "--no-pdf-header-footer"]
        # The sandbox of Chromium refuses to run for root, as in a container; the page is ours and asks for nothing.
        words += ["--no-sandbox"] if getattr(os, "geteuid", lambda: 1)() == 0 else []
        try:
            done = subprocess.run(
                [*words, f"--print-to-pdf={out}", Path(page).resolve().as_uri()],
                stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_PATIENCE, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise AsterismError(f"{browser} did not print {pdf} ({type(problem).__name__}); print the page of --report by hand.") from None
        if not out.is_file() or not out.stat().st_size:
            last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise AsterismError(f"{browser} did not print {pdf} ({last}); print the page of --report from a browser.")
        write_atomically(Path(pdf), out.read_bytes())
