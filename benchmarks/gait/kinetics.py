"""Moments and powers of hip, knee and ankle against those that the recordings' own program computed from the same plates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import asterism
from asterism.formats import force_plates
from asterism.gait import analyse_gait
from asterism.motion.clinical.measures import computed_by_the_file
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

ASKED = {"Moment": (0.03, "N m/kg"), "Power": (0.1, "W/kg")}


def kinetics(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """RMS of each curve of both legs over the frames at which the forces are known.

    The rest of the 13 walks: the right leg of one of NP1012, to which that program gave the plate that the left foot stands on; and single
    curves of the hips and a knee of NP1001, whose file alone holds markers on a grid of 0.158 mm: that program had them unrounded. With
    markers rounded to 0.1 mm the hip's extension of the others is 0.01 to 0.03 N m/kg off.
    """
    apart: dict[tuple[str, str], list[float]] = {}
    held: dict[tuple[str, str], list[float]] = {}
    for path in sorted((folder() / "gait-events/plates").rglob("*.c3d"))[: 3 if benchmark.quick else None]:
        recording = asterism.read(path)
        found = analyse_gait(recording, force_plates(recording)[0]).kinetics
        for name, values in {} if found is None else {**found.moments, **found.powers}.items():
            theirs = computed_by_the_file(recording, name)
            if theirs is not None:
                kind = "Moment" if name.endswith("Moment") else "Power"
                off = values - theirs / 1000 if kind == "Moment" else (values - theirs[:, 2])[:, None]
                known = np.isfinite(off).all(axis=1)
                if known.sum() > 50 and found is not None:
                    sigmas = found.sigmas[name].reshape(off.shape)[known]
                    held.setdefault((kind, name[1:].removesuffix(kind)), []).append(float((np.abs(off[known]) < 1.96 * sigmas).mean()))
                    apart.setdefault((kind, name[1:].removesuffix(kind)), []).extend(np.sqrt(np.nanmean(off**2, axis=0)))
    for kind, (near, unit) in ASKED.items():
        rms = np.concatenate([curves for (own, _), curves in apart.items() if own == kind])
        row = f"{kind.lower()}s against the files' own"
        yield Figure(f"{row}: curves within {near} {unit} RMS", ">= 0.9", float((rms < near).mean()), "fraction", len(rms))
        for joint in ("Hip", "Knee", "Ankle"):
            own = np.array(apart[kind, joint])
            yield Figure(f"{row}, {joint.lower()}: median RMS", "none", float(np.median(own)), unit, len(own))
            inside = float(np.mean(held[kind, joint]))
            yield Figure(f"{row}, {joint.lower()}: within the stated 95 %", ">= 0.93", inside, "fraction", len(held[kind, joint]))
