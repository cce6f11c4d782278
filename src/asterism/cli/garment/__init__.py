"""`asterism garment`: the verbs about printed garments, one file each."""

from __future__ import annotations

EXAMPLES = {
    "print": "asterism garment print --rows 90 --cols 90 --diameter 10mm --pitch 18mm -o garment.svg",
    "check": "asterism garment check photo.jpg --garment garment.toml",
}
"""Each verb, which is a function in a module of its name, and its example."""
