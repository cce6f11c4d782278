"""Trials and their corrections in; the plain values and bytes that the page asks for, out."""

from __future__ import annotations

from typing import Any

import numpy as np

from asterism.geometry import rotate_z_up
from asterism.labelling.correction import Correction, CorrectionChange, Readiness
from asterism.recording import label_shares, label_states
from asterism.recording.display import short_names
from asterism.recording.sides import marker_sides
from asterism.report import marker_bones
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
    with trial.opened() as correction:
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


def plain_state(trial: CorrectionTrial, correction: Correction) -> dict[str, Any]:
    """What `/api/trials/ID/state` answers."""
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


def packed_points(correction: Correction) -> bytes:
    """What `/api/trials/ID/points` answers: numbers of frames and points, offsets, and positions with the z axis up."""
    clouds = correction.clouds
    # Bytes instead of JSON: a long recording has millions of numbers.
    head = np.array([len(clouds), len(clouds.xyz)], dtype="<u4").tobytes() + clouds.offsets.astype("<u4").tobytes()
    return head + rotate_z_up(clouds.xyz, clouds.vertical).astype("<f4").tobytes()


def packed_pieces(correction: Correction) -> bytes:
    """What `/api/trials/ID/piece_points` answers: the place in the table of pieces of each point."""
    return correction.pieces.of_point.astype("<u4").tobytes()


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
