"""`asterism calibrate`: the verbs that make and mend rigs, one file each."""

from __future__ import annotations

EXAMPLES = {
    "wand": "asterism calibrate wand 2d.csv --wand 0 0.2 0.6 --image-size 1280x1024 -o rig.toml --report wand.html",
    "refine": "asterism calibrate refine walk.csv --rig rig.toml -o mended.toml",
    "board": "asterism calibrate board left/ right/ --chessboard 9x6 --square 0.025 -o rig.toml",
}
"""Each verb, which is a function in a module of its name, and its example."""
