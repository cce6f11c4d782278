"""Draws docs/characters.png: a simulated person who steps, and two characters of other proportions that step as the person does.

Run `python docs/make_characters_picture.py` in the repository's folder.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
matplotlib.use("Agg")

from matplotlib import pyplot as plt  # noqa: E402

from asterism.recording import SkeletonMotion  # noqa: E402
from asterism.recording.bone_names import split_name  # noqa: E402
from asterism.skeleton.retargeting import retarget  # noqa: E402
from tests.characters import character, virtual_person  # noqa: E402

COLOURS = {"left": "#c8281f", "right": "#1f66bf", "": "#333333"}
STEP, FRAMES = 1.15, range(20, 240, 31)


def draw(axes: plt.Axes, motion: SkeletonMotion, title: str) -> None:
    """Some frames from the left, beside each other."""
    motion = motion.in_axes(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    for k, t in enumerate(FRAMES):
        joints, tips = motion.joints[t], motion.tips[t]
        shift = STEP * k - joints[0, 0]
        for b, parent in enumerate(motion.parents):
            ends = [tips[b]] if np.isfinite(tips[b]).all() else []
            ends += [joints[parent]] if parent >= 0 else []
            for end in ends:
                side = split_name(motion.names[b])[0]
                dashes = "--" if side == "right" else "-"
                axes.plot(*zip(joints[b, [0, 2]] + [shift, 0], end[[0, 2]] + [shift, 0], strict=True), dashes, color=COLOURS[side], lw=1.6)
    axes.axhline(0.0, color="#888888", lw=1)
    axes.set(title=title, aspect="equal", ylim=(-0.1, 2.2), xlim=(-0.8, STEP * len(FRAMES) - 0.3))
    axes.axis("off")


def main() -> None:
    """Draw all three, one below the other."""
    person = virtual_person("walk")
    _, rows = plt.subplots(3, 1, figsize=(9.6, 9.0), layout="constrained")
    draw(rows[0], person, "the person: 1.70 m")
    draw(rows[1], retarget(person, character(0.7, 1.4)).motion, "a character with legs 0.7 and arms 1.4 times as long")
    draw(
        rows[2],
        retarget(person, character(1.4, 0.7, spine=5)).motion,
        "one with legs 1.4 and arms 0.7 times as long, and five bones in its spine",
    )
    plt.savefig(ROOT / "docs" / "characters.png", dpi=70, metadata={"Software": None})


if __name__ == "__main__":
    main()
