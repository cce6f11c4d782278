"""`asterism rig`: the verbs that judge and plan rigs, one file each."""

from __future__ import annotations

EXAMPLES = {
    "report": "asterism rig report rig.toml --volume 6x4x2.5 -o rig.html",
    "plan": "asterism rig plan --volume 6x4x2.5 --cameras 8 --image-size 1280x1024 --fov 56 -o rig.toml",
}
"""Each verb, which is a function in a module of its name, and its example."""
