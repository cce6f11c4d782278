"""From blobs to 3D points, each with its uncertainty.

Six cameras see a walker whose body hides many of the markers from many of the cameras. Every composed point has a covariance.
The picture compares these covariances with the true errors.
"""

import matplotlib.pyplot as plt
import numpy as np

from asterism.reconstruction import reconstruct
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules


def main(picture: str = "points_with_uncertainty.png", frames: int = 150) -> float:
    """Draw the picture; returns the median error of a point in metres."""
    rng = np.random.default_rng(0)
    rig, walk = ring_rig(6, rng=rng), simulate_walks(1, frames, markers="plug-in-gait")[0]
    blobs, _ = simulate_blobs(rig, walk.positions, ImagingSettings(noise=0.3, strays=0.5), body=walker_capsules(walk), rng=rng)

    result = reconstruct(blobs, rig)
    print(f"{len(result.clouds.xyz)} points of {blobs.counts.sum()} blobs")

    from_truth = np.linalg.norm(result.clouds.xyz[:, None] - walk.positions[result.clouds.frame_of], axis=2)
    marker, error = from_truth.argmin(axis=1), from_truth.min(axis=1)
    away = result.clouds.xyz - walk.positions[result.clouds.frame_of, marker]
    normalised = np.einsum("ni,nij,nj->n", away, np.linalg.inv(result.covariance), away)
    expected = np.sqrt(np.trace(result.covariance, axis1=1, axis2=2))

    figure, (dots, spread) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    image = dots.scatter(1000 * expected, 1000 * error, c=(result.rays >= 0).sum(axis=1), cmap="viridis", s=5)
    dots.plot([0, 3], [0, 3], color="black", linewidth=0.8)
    dots.set(title="each point", xlabel="expected error (root of the trace), mm", ylabel="error, mm", xlim=(0.8, 2.8), ylim=(0, 6))
    figure.colorbar(image, ax=dots, label="cameras that see it", ticks=range(2, 7))

    squares = np.linspace(0, 16, 200)
    spread.hist(normalised, bins=np.linspace(0, 16, 65), density=True, color="#a5d8dc", label="points")
    spread.plot(squares, np.sqrt(squares / (2 * np.pi)) * np.exp(-squares / 2), color="#0b5563", label="chi-squared, 3 degrees of freedom")
    spread.set(title="squared errors in units of their covariance", xlabel="squared Mahalanobis distance")
    spread.legend(frameon=False)
    figure.savefig(picture, dpi=110)
    return float(np.median(error))


if __name__ == "__main__":
    main()
