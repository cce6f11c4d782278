"""Can this marker set be labelled?

A short pilot recording of a few people answers before the study begins: which markers are taken for which, and how much
is lost when more of them are hidden. The verdict is a text that says what would help.
"""

import matplotlib.pyplot as plt
import numpy as np

from asterism.labelling import capturability
from asterism.simulation import simulate_walks


def main(picture: str = "capturability_of_a_marker_set.png", subjects: int = 4, frames: int = 200) -> str:
    """Draw the picture; returns the verdict."""
    result = capturability(simulate_walks(subjects, frames, markers="helen-hayes", seed=3), seed=0)
    print(result.verdict)

    figure, (table, curve) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained", width_ratios=[1.3, 1])
    shares = 100 * np.where(np.eye(len(result.markers), dtype=bool), np.nan, result.confusion)
    image = table.imshow(shares, cmap="Reds", vmin=0)
    table.set_xticks(range(len(result.markers)), result.markers, rotation=90, fontsize=7)
    table.set_yticks(range(len(result.markers)), result.markers, fontsize=7)
    table.set(title="point of the row's marker taken for the column's", xlabel="taken for", ylabel="marker")
    figure.colorbar(image, ax=table, label="%", shrink=0.8)

    hidden, labelled, by_marker = zip(*result.by_occlusions, strict=True)
    curve.plot(hidden, 100 * np.array(by_marker), color="#c9d8ea", linewidth=1)
    curve.plot(hidden, 100 * np.array(labelled), color="#0f7b8a", linewidth=2.5, marker="o")
    curve.set(title="markers in view that get their label", xlabel="hidden markers", ylabel="%  (thin: each marker)", ylim=(None, 101))
    curve.grid(alpha=0.3)
    figure.savefig(picture, dpi=110)
    return result.verdict


if __name__ == "__main__":
    main()
