"""Label points while they arrive.

A stream takes the points of each frame and returns the labels of that frame at once, or those of an earlier frame, which are more
certain. The picture compares delays, and shows how long each frame takes.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

import asterism
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks


def main(picture: str = "live_stream.png", subjects: int = 6, frames: int = 500, delays: tuple[int, ...] = (0, 5, 10, 25)) -> list[float]:
    """Draw the picture; returns, for each delay, the share of the markers in view that are labelled right."""
    *training, walk = simulate_walks(subjects, frames, markers="helen-hayes", seed=1)
    model = asterism.MarkerModel.fit(training, seed=0)
    clouds, truth = simulate_gaps_and_ghosts(walk, hidden=3, ghosts=1, seed=2, number_tracks=False)
    in_view = (truth != asterism.NULL).sum()

    right, seconds = [], []
    for delay in delays:
        stream = model.stream(walk.rate, delay)
        labels = []
        for frame in range(frames):
            began = time.perf_counter()
            labels.append(stream.push(clouds[frame]))
            seconds.append(time.perf_counter() - began)
        given = [frame for frame in (*labels, *stream.flush()) if frame is not None]
        right.append(sum(int(((frame.indices == truth[frame.frame]) & (frame.indices >= 0)).sum()) for frame in given) / int(in_view))
        print(f"delay {delay}: {right[-1]:.2%} of the markers in view are labelled right")

    figure, (shares, speed) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    shares.plot(delays, 100 * np.array(right), marker="o", color="#0f7b8a")
    shares.set(title="markers in view, labelled right", xlabel="delay, frames", ylabel="%")
    shares.grid(alpha=0.3)
    speed.hist(1000 * np.array(seconds), bins=np.geomspace(0.05, 50, 60), color="#a5d8dc")
    speed.set(title="time per frame", xlabel="ms", ylabel="frames", xscale="log")
    speed.axvline(1000 / walk.rate, color="#d1495b", label=f"{walk.rate:.0f} frames/s")
    speed.legend(frameon=False)
    figure.savefig(picture, dpi=110)
    return right


if __name__ == "__main__":
    main()
