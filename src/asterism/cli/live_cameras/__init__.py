"""`asterism live cameras`: the verbs that list, set and watch cameras, one file each."""

from __future__ import annotations

EXAMPLES = {
    "list": "asterism live cameras list -o cameras.toml",
    "set": "asterism live cameras set exposure=4ms gain=6 --cameras cameras.toml -o cameras-dark.toml",
    "watch": "asterism live cameras watch --cameras cameras.toml --seconds 60",
}
"""Each verb, which is a function in a module of its name, and its example."""
