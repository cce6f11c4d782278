"""`asterism body`: the verbs that make body models, one file each."""

from __future__ import annotations

EXAMPLES = {
    "fit": "asterism body fit static.c3d -o body.toml",
    "place": "asterism body place static.c3d --markers my-set.toml -o my-set-placed.toml",
}
"""Each verb, which is a function in a module of its name, and its example."""
