"""`asterism garment`: the verbs about printed garments, one file each."""

from __future__ import annotations

EXAMPLES = {
    "print": "asterism garment print --rows 90 --cols 90 --diameter 10mm --pitch 18mm -o garment.svg",
    "check": "asterism garment check photo.jpg --garment garment.toml",
    "calibrate": "asterism garment calibrate target/ --target target.toml -o rig.toml --report rig.html",
    "capture": "asterism garment capture walk/ --rig rig.toml --garment suit.toml -o dense.npz --report suit.html",
}
"""Each verb, which is a function in a module of its name, and its example."""
