"""Label a walk with occlusions and ghosts.

Five simulated people teach a model. A sixth walks past: at every moment five of the fifteen markers are hidden, and three ghosts
move with the body. The picture shows one frame as it comes from the cameras, and what became of every marker in every frame.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap

import asterism
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks


def main(picture: str = "label_a_walk.png", subjects: int = 6, frames: int = 400) -> float:
    """Draw the picture; returns the share of the markers in view that have their own point."""
    *training, walk = simulate_walks(subjects, frames, markers="helen-hayes", seed=1)
    model = asterism.MarkerModel.fit(training, seed=0)

    clouds, truth = simulate_gaps_and_ghosts(walk, hidden=5, ghosts=3, seed=2)
    labelling = model.label(clouds)

    hidden = truth == asterism.NULL
    right = ~hidden & (labelling.indices == truth)
    wrong = (labelling.indices != asterism.NULL) & (labelling.indices != truth)
    share = right.sum() / (~hidden).sum()
    print(f"{share:.2%} of the markers in view are labelled right; {wrong.sum()} of {(right | wrong).sum()} labels are wrong")

    figure = plt.figure(figsize=(10, 4.2), layout="constrained")
    space = figure.add_subplot(1, 3, 1, projection="3d", title="one frame: points without names")
    space.scatter(*clouds[frames // 2].T, color="black", s=12)
    space.set_aspect("equal")
    space.tick_params(labelsize=6)
    # The body is narrow: more numbers would lie over each other.
    space.locator_params(axis="x", nbins=2)
    space.locator_params(axis="y", nbins=2)

    time = figure.add_subplot(1, 3, (2, 3), title="every marker in every frame", xlabel="time, s")
    state = np.select([wrong, right, hidden], [3, 1, 0], default=2)
    colors = ["#e3e7ee", "#248f9c", "#f2a93b", "#d1495b"]
    extent = (0, frames / walk.rate, len(walk.labels), 0)
    time.imshow(state.T, ListedColormap(colors), aspect="auto", interpolation="nearest", vmin=0, vmax=3, extent=extent)
    time.set_yticks(np.arange(len(walk.labels)) + 0.5, walk.labels, fontsize=7)
    patches = [plt.Rectangle((0, 0), 1, 1, color=color) for color in colors]
    time.legend(patches, ["hidden", "right", "no label", "wrong"], ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False)
    figure.savefig(picture, dpi=110)
    return float(share)


if __name__ == "__main__":
    main()
