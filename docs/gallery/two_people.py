"""Two people in one volume.

Both wear the same fifteen markers. The recording holds the points of both without names, in random order. The same model, given twice,
labels each of them; no point goes to both.
"""

import matplotlib.pyplot as plt
import numpy as np

import asterism
from asterism.labelling import label_together
from asterism.simulation import simulate_walks


def main(picture: str = "two_people.png", subjects: int = 6, frames: int = 300) -> float:
    """Draw the picture; returns the share of all markers that are labelled right."""
    *training, ann, ben = simulate_walks(subjects, frames, markers="helen-hayes", seed=4)
    model = asterism.MarkerModel.fit(training, seed=0)

    aside = ben.positions + (ann.positions[0].mean(axis=0) - ben.positions[0].mean(axis=0) + np.array([0.0, 0.9, 0.0]))
    truth = np.concatenate([ann.positions, aside], axis=1)
    rng = np.random.default_rng(0)
    clouds = asterism.Clouds.from_points([points[rng.permutation(len(points))] for points in truth], ann.rate, vertical="z")

    labellings = label_together([model, model], clouds)
    tracks = [labelling.positions(clouds) for labelling in labellings]
    if np.nanmedian(np.linalg.norm(tracks[0] - ann.positions, axis=2)) > 0.1:  # who comes first is not said
        tracks.reverse()
    right = np.linalg.norm(np.concatenate(tracks, axis=1) - truth, axis=2) < 1e-9
    print(f"{right.mean():.2%} of the markers of two people are labelled right")

    figure, views = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    for view, (title, across, up) in zip(views, (("from above", 0, 1), ("from the side", 0, 2)), strict=True):
        for track, color in zip(tracks, ("#0f7b8a", "#e09f3e"), strict=True):
            view.plot(track[:, :, across], track[:, :, up], color=color, linewidth=0.6)
            view.scatter(track[-1, :, across], track[-1, :, up], color=color, s=14, zorder=3)
        view.set(title=title, xlabel="x, m", ylabel=f"{'xyz'[up]}, m", aspect="equal")
    figure.savefig(picture, dpi=110)
    return float(right.mean())


if __name__ == "__main__":
    main()
