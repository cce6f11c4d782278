"""Trials and their corrections in; the plain values and bytes that the page asks for, out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from asterism.geometry import rotate_z_up
from asterism.labelling.correction import Correction, CorrectionChange, Readiness
from asterism.labelling.correction.group_naming import GroupNaming
from asterism.recording import Clouds, label_shares, label_states
from asterism.recording.display import counted, short_names
from asterism.recording.sides import marker_sides
from asterism.report import marker_bones
from asterism.report.naming import side
from asterism.web.relabelling import RelabelRun
from asterism.web.session import CORRECTED, READY, CorrectionSession, CorrectionTrial

ITEMS = 500
"""The list is cut after so many items."""
BONE_FRAMES = 200
"""Frames by which the bones are chosen, at most."""


def plain_trials(session: CorrectionSession) -> dict[str, Any]:
    """What `/api/trials` answers."""
    out, names = session.options.output, short_names([trial.path for trial in session.trials])
    return {
        "trials": [_plain_trial(trial, name) for trial, name in zip(session.trials, names, strict=True)],
        "models": [model.name for model in session.models],
        "relabelling": plain_relabelling(session.relabelling),
        "out": CORRECTED if out is None else str(out),
    }


def _plain_trial(trial: CorrectionTrial, name: str) -> dict[str, Any]:
    row: dict[str, Any] = {
        "id": trial.id,
        "name": name,
        "path": str(trial.path),
        "state": trial.state,
        "error": trial.error,
        "notes": list(trial.notes),
        "findings": [finding.to_dict() for finding in trial.findings],
        "saved": trial.is_saved,
    }
    if trial.state != READY:
        return row
    # Under the trial's lock: shares and verdict are of one revision.
    with trial.held() as correction:
        if isinstance(correction, GroupNaming):
            return row | _plain_naming_row(trial, correction)
        shares = label_shares(correction.labelling, correction.clouds)
        return row | {
            "frames": len(correction.clouds),
            "rate": correction.recording.rate,
            "first_frame": correction.recording.first_frame,
            "verdict": plain_verdict(correction.verdict),
            **{name: _number(share) for name, share in vars(shares).items()},
            "touches": len(correction.touches),
            "saved": trial.is_saved,
        }


def plain_relabelling(run: RelabelRun | None) -> dict[str, Any]:
    """How far labelling again is, or what has become of it."""
    if run is None:
        return {"running": False, "sentence": ""}
    return {
        "running": run.running,
        "model": run.model.name,
        "trial": run.present,
        "share": round(run.share, 3),
        "done": run.done + len(run.failed),
        "of": len(run.trials),
        "failed": len(run.failed),
        "sentence": "" if run.running else run.sentence,
    }


def plain_verdict(verdict: Readiness) -> dict[str, Any]:
    """A verdict."""
    return {"kind": verdict.kind, "sentence": verdict.sentence, "look_at": verdict.look_at}


def _plain_naming_row(trial: CorrectionTrial, naming: GroupNaming) -> dict[str, Any]:
    return {
        "naming": True,
        "frames": len(naming.clouds),
        "rate": naming.recording.rate,
        "first_frame": naming.recording.first_frame,
        "verdict": _naming_verdict(naming),
        "touches": len(naming.touches),
        "saved": trial.is_saved,
    }


def _naming_verdict(naming: GroupNaming) -> dict[str, Any]:
    left, count = len(naming.left), naming.groups.frequent
    if left:
        sentence = f"{left} of {counted(count, 'group')} of points {'has' if left == 1 else 'have'} no name yet."
    else:
        sentence = f"All {count} groups of points that are often seen have a name."
    return {"kind": "look" if left else "ready", "sentence": sentence, "look_at": left}


def plain_naming(trial: CorrectionTrial, naming: GroupNaming) -> dict[str, Any]:
    """What `/api/trials/ID/state` answers of a recording whose groups are named: each group is a piece, and a marker of its own."""
    names, groups = naming.names, naming.groups
    # Groups that are rarely seen are ghosts mostly; one that has a name is not.
    shown = sorted({*range(groups.frequent), *names})
    row_of = {group: row for row, group in enumerate(shown)}
    first, last, look = naming.frames_of
    count = len(groups)
    labels = [names.get(group, str(group + 1)) for group in shown]
    return {
        "naming": True,
        "revision": naming.revision,
        "markers": labels,
        "side": _sides(naming, shown),
        "bones": _group_bones(naming, shown),
        "rate": naming.recording.rate,
        "first_frame": naming.recording.first_frame,
        "frames": len(naming.clouds),
        "pieces": {
            "id": list(range(count)),
            "first": first.tolist(),
            "last": last.tolist(),
            "marker": [row_of.get(group, -1) for group in range(count)],
            # paler than what a person said, in the colours of the timeline
            "confidence": [0.9 * (group in row_of) for group in range(count)],
            "ghost": [False] * count,
            "person": [group in names for group in range(count)],
            "track": [-1] * count,
        },
        "items": [
            {"piece": group, "frame": int(look[group]), "gain": int(groups.frames[group]), "alternatives": _mirrored(naming, group)}
            for group in naming.left
        ],
        "mirrored": {group: other for group in shown if (other := naming.mirrored(group)) is not None},
        "unsure": [],
        "verdict": _naming_verdict(naming),
        "can_undo": naming.can_undo,
        "can_redo": naming.can_redo,
        "touches": len(naming.touches),
        "saved": trial.is_saved,
        "relabelled": False,
    }


def _mirrored(naming: GroupNaming, group: int) -> list[list[str | None]]:
    name = naming.mirrored_name(group)
    return [] if name is None else [[name, None]]


def _sides(naming: GroupNaming, shown: Sequence[int]) -> list[str]:
    """On which side each group is: by its name where it has one, else by its place, if the body walks."""
    by_name = dict(zip(naming.names, marker_sides(list(naming.names.values())), strict=True))
    return [by_name.get(group) or {"left": "left", "right": "right"}.get(side(naming.places[group]), "middle") for group in shown]


def _group_bones(naming: GroupNaming, shown: Sequence[int]) -> list[list[int]]:
    """Bones between groups, by names and by steady distances."""
    clouds, groups = naming.clouds, naming.groups
    row = np.full(len(groups), -1)
    row[shown] = np.arange(len(shown))
    frames = np.unique(np.linspace(0, len(clouds) - 1, BONE_FRAMES).round().astype(np.int64))
    place = np.full(len(clouds), -1)
    place[frames] = np.arange(len(frames))
    points = np.nonzero((row[groups.of_point] >= 0) & (place[clouds.frame_of] >= 0))[0]
    positions = np.full((len(frames), len(shown), 3), np.nan)
    positions[place[clouds.frame_of[points]], row[groups.of_point[points]]] = clouds.xyz[points]
    return [[int(a), int(b)] for a, b in marker_bones(positions, [naming.names.get(group, f"*{group + 1}") for group in shown])]


def plain_state(trial: CorrectionTrial, held: Correction | GroupNaming) -> dict[str, Any]:
    """What `/api/trials/ID/state` answers."""
    return plain_naming(trial, held) if isinstance(held, GroupNaming) else plain_correction(trial, held)


def plain_correction(trial: CorrectionTrial, correction: Correction) -> dict[str, Any]:
    """What it answers of a recording whose labels are corrected."""
    pieces, names = correction.pieces, correction.names
    return {
        "revision": correction.revision,
        "markers": list(names),
        "side": marker_sides(names, correction.marker_set),
        "bones": _bones(correction),
        "rate": correction.recording.rate,
        "first_frame": correction.recording.first_frame,
        "frames": len(correction.clouds),
        "pieces": {
            "id": pieces.id.tolist(),
            "first": pieces.first.tolist(),
            "last": pieces.last.tolist(),
            "marker": pieces.marker.tolist(),
            "confidence": np.round(pieces.confidence, 6).tolist(),
            "ghost": pieces.ghost.tolist(),
            "person": pieces.person.tolist(),
            "track": pieces.track.tolist(),
        },
        "items": [
            {
                "piece": int(pieces.id[pieces.of_point[item.points[0]]]),
                "frame": item.frame,
                "gain": round(item.gain, 3),
                "alternatives": [[name, round(chance, 6)] for name, chance in item.alternatives],
            }
            for item in correction.to_look_at()[:ITEMS]
        ],
        "unsure": _unsure_frames(correction),
        "verdict": plain_verdict(correction.verdict),
        "can_undo": correction.can_undo,
        "can_redo": correction.can_redo,
        "touches": len(correction.touches),
        "saved": trial.is_saved,
        "relabelled": trial.relabelled is not None and trial.relabelled.revision == correction.revision,
    }


def plain_change(change: CorrectionChange) -> list[dict[str, Any]]:
    """What a touch changed."""
    return [
        {
            "piece": part.piece,
            "first": part.first,
            "last": part.last,
            "before": part.before,
            "after": part.after,
            "by_person": part.by_person,
        }
        for part in change.pieces
    ]


def packed_points(clouds: Clouds) -> bytes:
    """What `/api/trials/ID/points` answers: numbers of frames and points, offsets, and positions with the z axis up."""
    # Bytes instead of JSON: a long recording has millions of numbers.
    head = np.array([len(clouds), len(clouds.xyz)], dtype="<u4").tobytes() + clouds.offsets.astype("<u4").tobytes()
    return head + rotate_z_up(clouds.xyz, clouds.vertical).astype("<f4").tobytes()


def packed_pieces(held: Correction | GroupNaming) -> bytes:
    """What `/api/trials/ID/piece_points` answers: the place in the table of pieces of each point."""
    of_point = held.groups.of_point if isinstance(held, GroupNaming) else held.pieces.of_point
    return of_point.astype("<u4").tobytes()


def _unsure_frames(correction: Correction) -> list[list[list[int]]]:
    """For each marker the runs of frames, first and last, in which a point without a name may be it."""
    unsure = label_states(correction.labelling, correction.clouds).unsure
    edges = np.diff(np.pad(unsure.astype(np.int8), ((1, 1), (0, 0))), axis=0).T
    return [np.column_stack([np.nonzero(row > 0)[0], np.nonzero(row < 0)[0] - 1]).tolist() for row in edges]


def _bones(correction: Correction) -> list[list[int]]:
    labelling, clouds = correction.labelling, correction.clouds
    # Bones by a sample of frames: distances settle long before all are seen.
    frames = np.unique(np.linspace(0, len(clouds) - 1, BONE_FRAMES).round().astype(np.int64))
    some = clouds.frames(frames)
    positions = np.full((len(frames), len(correction.names), 3), np.nan)
    row, marker = np.nonzero(labelling.indices[frames] >= 0)
    positions[row, marker] = some.xyz[some.offsets[row] + labelling.indices[frames[row], marker]]
    return [[int(a), int(b)] for a, b in marker_bones(positions, correction.names, correction.marker_set)]


def _number(value: float) -> float | None:
    return None if np.isnan(value) else round(value, 6)
