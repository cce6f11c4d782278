"""A rig and its map in; out comes a page that says what it measures where, and for a planned rig, against the plain ring."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.cameras import Rig
from asterism.cameras.accuracy import RigMap, WandAccuracy, map_rig, sees, sensitivity
from asterism.recording import Floats, as_vertical
from asterism.recording.display import significant
from asterism.report.page import NOTHING, Cell, Page, Section, Table, decimal, millimetres, percent, tinted, write_page
from asterism.report.space import rig_in_space, slices

if TYPE_CHECKING:
    from asterism.cameras.plan import RigPlan

SEEN_SHADES = [[0, "#7d1a2d"], [0.25, "#dd6b4d"], [0.375, "#f6c177"], [0.5, "#a5d8dc"], [1, "#0b5563"]]
ERROR_SHADES = [[0, "#0b5563"], [0.3, "#5fb6be"], [0.6, "#f6c177"], [1, "#7d1a2d"]]
COORDINATES = ("xa", "ya", "xb", "yb")


def rig_report(
    path: str | Path,
    rig: Rig,
    result: RigMap,
    *,
    title: str = "What this rig measures",
    wand: WandAccuracy | None = None,
    still: Floats | None = None,
    plan: RigPlan | None = None,
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write an HTML page on a rig.

    result  of `map_rig`; wand: of `wand_accuracy`; still: of `repeatability`, (M,) m; plan: where the rig is a proposal
    Raises AsterismError where the file cannot be written.
    """
    # A rig that knows no vertical is drawn as its numbers stand.
    up = as_vertical("z") if rig.vertical is None else rig.vertical
    seen = sees(rig, result.places)
    three = result.coverage(3)
    noise = significant(result.noise, 2)
    merits = [
        (str(len(rig)), "cameras", ""),
        (percent(three), "of the volume is seen by three cameras or more", "good" if three > 0.95 else "warn" if three > 0.7 else "bad"),
        (millimetres(result.median_error), f"error of a marker (RMS, median) at {noise} px noise", ""),
        (percent(float(result.facing.mean())), "of markers on a body face two cameras or more", ""),
    ]
    # Percentiles: one place at the edge must not take the whole scale.
    best, worst = 1000 * np.nanpercentile(result.error, (1, 99)) if np.isfinite(result.error).any() else (0.0, 1.0)
    sections = [
        Section(
            "The rig", "Cameras open where they look; the grey box is the volume. Drag to turn.", figure=rig_in_space(rig, result.volume)
        ),
        Section(
            "How many cameras see each place",
            "Two compose a point, three tell it from a ghost; a body hides a marker from half of them.",
            figure=slices(result, result.seen_by.astype(np.float64), up, "cameras", SEEN_SHADES, 0, 8),
            table=_coverage(result),
        ),
        Section(
            "How exactly a marker is measured",
            f"The RMS length of the error in 3D from all cameras that see the place, for {noise} px noise of a blob's x and y. "
            "Calibration is taken as exact. Grey: fewer than two cameras.",
            figure=slices(result, 1000 * result.error, up, "mm", ERROR_SHADES, float(best), float(worst)),
            table=_errors(result),
        ),
        Section("The cameras", table=_cameras(rig, result, seen), note="Without it: what three of the other cameras see of the volume."),
        _pairs(rig, result),
    ]
    # What was measured stands before what was computed of single cameras.
    if wand is not None:
        sections.insert(3, _wand(rig, result, wand))
        merits.append((millimetres(wand.mean_absolute), "off the wand's lengths, on average", ""))
    if still is not None:
        sections.insert(3, _still(still))
    if plan is not None:
        sections.insert(1, _against_the_ring(plan, result))
    exact = millimetres(result.median_error)
    lead = f"Three cameras or more see {percent(three)} of the volume; a marker is measured to {exact} there in the median."
    write_page(path, Page(title, lead, settings or {}, merits, sections))


def _coverage(result: RigMap) -> Table:
    most = int(result.seen_by.max(initial=0))
    return Table(["cameras, at least", "share of the volume"], [[str(n), percent(result.coverage(n))] for n in range(1, most + 1)])


def _errors(result: RigMap) -> Table:
    def row(name: str, values: Floats) -> list[str | Cell]:
        known = values[np.isfinite(values)]
        return [name, *(millimetres(float(np.percentile(known, share))) if len(known) else NOTHING for share in (50, 95, 100))]

    return Table(
        ["", "median", "95 % of places", "worst"],
        [
            row("RMS length of the error in 3D", result.error),
            row("standard deviation along the worst direction", result.worst_axis),
            row(f"sensitivity of the best pair, ± {significant(result.noise, 2)} px (mean of 12)", result.sensitivity),
        ],
    )


def camera_facts(rig: Rig, result: RigMap) -> list[dict[str, Any]]:
    """Per camera: where it stands (m), what it sees, and what three of the others see of the volume without it."""
    seen = sees(rig, result.places)
    return [
        {
            "name": camera.name,
            "position_m": camera.position,
            "fov_deg": float(np.degrees(2 * np.arctan2(0.5 * camera.size[0], camera.focal[0]))) if camera.size else None,
            "size_px": camera.size,
            "error_px": camera.error,
            "sees": float(seen[c].mean()),
            "coverage_without": float((result.seen_by - seen[c] >= 3).mean()),
        }
        for c, camera in enumerate(rig)
    ]


def pair_scalars(rig: Rig, result: RigMap) -> list[dict[str, Any]]:
    """The 12 scalars (m) of each pair of cameras in the middle of the volume, the best pair first (thesis 3.3)."""
    middle = 0.5 * (result.volume.low + result.volume.high)
    sensitivities = sensitivity(rig, middle[None], result.noise, "one-at-a-time")
    # Pairs that see no common place come last.
    order = np.argsort(np.where(np.isfinite(sensitivities.effective[:, 0]), sensitivities.effective[:, 0], np.inf), kind="stable")
    return [
        {
            "pair": [rig.names[c] for c in sensitivities.pairs[q]],
            "effective_m": float(sensitivities.effective[q, 0]),
            "scalars_m": {
                axis: dict(zip(COORDINATES, sensitivities.scalars[q, 0, i].tolist(), strict=True)) for i, axis in enumerate("xyz")
            },
        }
        for q in order
    ]


def _cameras(rig: Rig, result: RigMap, seen: np.ndarray) -> Table:
    rows: list[list[str | Cell]] = []
    for fact, camera in zip(camera_facts(rig, result), rig, strict=True):
        rows.append(
            [
                camera.name,
                ", ".join(f"{v:.2f}" for v in camera.position),
                NOTHING if camera.size is None else f"{camera.size[0]} × {camera.size[1]}",
                NOTHING if fact["fov_deg"] is None else f"{fact['fov_deg']:.0f}°",
                f"{camera.error:.2f} px" if np.isfinite(camera.error) else NOTHING,
                percent(fact["sees"]),
                tinted(result.coverage(3) - fact["coverage_without"], 1, 0.3)
                if result.coverage(3) > fact["coverage_without"]
                else percent(0.0),
            ]
        )
    return Table(
        ["camera", "stands at (m)", "image", "angle of view", "calibration error", "sees of the volume", "lost without it"], rows, left=2
    )


def _pairs(rig: Rig, result: RigMap) -> Section:
    def scalars(pair: Mapping[str, Any]) -> list[str]:
        return [decimal(1000 * value, 2) for axis in "xyz" for value in pair["scalars_m"][axis].values()]

    noise = significant(result.noise, 2)
    head = ["pair (a, b)", "mean of 12", *(f"{axis} of {coordinate}" for axis in "xyz" for coordinate in COORDINATES)]
    rows = [[", ".join(pair["pair"]), decimal(1000 * pair["effective_m"], 2), *scalars(pair)] for pair in pair_scalars(rig, result)]
    return Section(
        "Sensitivity of pairs in the middle of the volume",
        f"How far a point moves, in mm, where one coordinate of one image moves from -{noise} to +{noise} px and the "
        "others stay: the 12 one-at-a-time scalars, and their mean.",
        table=Table(head, rows),
        folded=True,
    )


def _wand(rig: Rig, result: RigMap, wand: WandAccuracy) -> Section:
    return Section(
        "Accuracy against the wand",
        f"{wand.frames:,} frames show the whole wand. Its measured lengths are {1000 * wand.mean_error:+.3f} mm off on average "
        f"(the sign is that of a wrong scale), "
        f"{millimetres(wand.mean_absolute)} without signs, with a standard deviation of {millimetres(wand.std)}.",
        figure=rig_in_space(rig, result.volume, wand.places, (1000 * wand.place_errors).tolist(), "mm off"),
        table=Table(
            ["pair of wand markers", "mean error"],
            [[f"{a + 1} and {b + 1}", f"{1000 * error:+.3f} mm"] for (a, b), error in zip(wand.pairs, wand.pair_errors, strict=True)],
        ),
    )


def _still(still: Floats) -> Section:
    return Section(
        "Repeatability of what stands still",
        "How far the measurements of a still marker lie from their mean, on average.",
        table=Table(["still marker", "mean distance"], [[str(m + 1), millimetres(float(value))] for m, value in enumerate(still)]),
    )


def _against_the_ring(plan: RigPlan, result: RigMap) -> Section:
    # The same map of the ring: both are judged by one measure.
    ring = map_rig(plan.ring, result.volume, noise=result.noise)

    def row(name: str, value_of: Any) -> list[str | Cell]:
        return [name, value_of(result, plan.worth, plan.glare), value_of(ring, plan.ring_worth, plan.ring_glare)]

    rows = [row(f"seen by {n} cameras or more", lambda m, w, g, n=n: percent(m.coverage(n))) for n in (2, 3, 4)]
    rows += [
        row("markers on a body that face two cameras", lambda m, w, g: percent(float(m.facing.mean()))),
        row("error of a marker, median", lambda m, w, g: millimetres(m.median_error)),
        row("error of a marker, 95 % of places", lambda m, w, g: millimetres(float(np.nanpercentile(m.error, 95)))),
        row("cameras that have another one's lamps in their image", lambda m, w, g: str(g)),
        row("worth", lambda m, w, g: f"{w:.3f}"),
    ]
    return Section(
        "Against the plain ring",
        "The ring: the same cameras evenly around the volume, on the same mounts, as high as may be, looking at its middle.",
        table=Table(["", "proposed", "ring"], rows),
        note="Worth: half for what three cameras see, a quarter for markers on a body, a quarter for precision; less for lamps in sight.",
    )
