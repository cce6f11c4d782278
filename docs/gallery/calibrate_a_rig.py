"""Calibrate eight cameras with a waved wand.

The calibration knows the sizes of the images and the lengths of the wand, nothing else. It says how certain each camera's place is;
the simulation knows the truth, so both can be compared. The map shows how exactly the calibrated cameras measure a point at each place.
"""

import matplotlib.pyplot as plt
import numpy as np

from asterism.calibration import calibrate_wand
from asterism.cameras.accuracy import map_rig
from asterism.simulation import compare_rigs
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_wand


def main(picture: str = "calibrate_a_rig.png", cameras: int = 8, frames: int = 900) -> float:
    """Draw the picture; returns the largest error of a camera's place in metres."""
    truth = ring_rig(cameras, rng=np.random.default_rng(1))
    seen = ImagingSettings(noise=0.2, strays=0.2)
    blobs, _ = simulate_wand(truth, (0.0, 0.2, 0.6), frames, settings=seen, rate=30.0, rng=np.random.default_rng(2))

    calibration = calibrate_wand(blobs, [0.0, 0.2, 0.6], sizes=(1280, 1024))
    for finding in calibration.findings:
        print(finding.sentence)
    errors = compare_rigs(calibration.rig, truth)
    print(f"cameras stand within {1000 * errors.position.max():.2f} mm of where they are")

    figure, (bars, space) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    places = np.arange(cameras)
    bars.bar(places - 0.2, 1000 * errors.position, 0.4, color="#0f7b8a", label="error, from the truth")
    bars.bar(places + 0.2, 1000 * calibration.position_sigma, 0.4, color="#a5d8dc", label="standard deviation, as calibrated")
    bars.set_xticks(places, calibration.rig.names)
    bars.set(title="where the cameras stand", ylabel="mm")
    bars.margins(y=0.25)
    bars.legend(frameon=False)

    rig_map = map_rig(calibration.rig, noise=0.2)
    level = np.abs(rig_map.places[:, 2] - 1.0) == np.abs(rig_map.places[:, 2] - 1.0).min()
    dots = space.scatter(*rig_map.places[level, :2].T, c=1000 * rig_map.error[level], cmap="viridis_r", marker="s", s=60)
    space.scatter(*np.array([camera.position[:2] for camera in calibration.rig]).T, color="black", marker="^", label="cameras")
    space.set(title="error of a point 1 m above the floor", xlabel="x, m", ylabel="y, m", aspect="equal")
    figure.colorbar(dots, ax=space, label="mm", shrink=0.8)
    figure.savefig(picture, dpi=110)
    return float(errors.position.max())


if __name__ == "__main__":
    main()
