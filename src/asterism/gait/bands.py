"""Walks of people without complaints in; a band of each angle and parameter out, and how far others are from it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.gait.analysis import GaitAnalysis, analyses_without_turns
from asterism.gait.cycles import POINTS
from asterism.recording import Floats
from asterism.recording.display import listed

SCORED = (
    ("Pelvis", 0, "pelvic tilt"),
    ("Pelvis", 1, "pelvic obliquity"),
    ("Pelvis", 2, "pelvic rotation"),
    ("Hip", 0, "hip flexion"),
    ("Hip", 1, "hip adduction"),
    ("Hip", 2, "hip rotation"),
    ("Knee", 0, "knee flexion"),
    ("Ankle", 0, "ankle dorsiflexion"),
    ("FootProgress", 2, "foot progression"),
)
"""The nine angles of the Gait Profile Score (Baker et al. 2009): quantity, which of its angles, name."""
_FORMAT = "asterism gait band 1"


@dataclass(frozen=True)
class Band:
    """Means and standard deviations (101, 3) rad of quantities such as "Knee", of both sides together, of so many people and cycles.

    parameters  by their names in `PARAMETERS`, mean and standard deviation; none in bands of older versions
    log_score   mean and standard deviation of the logarithm of the Gait Profile Score (rad) of each side of each of these people against
                the others; None of fewer than three people, and in bands of older versions
    models      whose definitions the angles are by; none in bands of older versions
    """

    mean: Mapping[str, Floats]
    deviation: Mapping[str, Floats]
    people: int
    cycles: int
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    log_score: tuple[float, float] | None = None
    models: tuple[str, ...] = ()

    def save(self, path: str | Path) -> None:
        """Write it as JSON, degrees, whole or not at all. Raises AsterismError where the file cannot be written."""
        angles = {
            name: {"mean_deg": np.degrees(self.mean[name]).round(4).tolist(), "sd_deg": np.degrees(self.deviation[name]).round(4).tolist()}
            for name in self.mean
        }
        content = {"format": _FORMAT, "people": self.people, "cycles": self.cycles, "angles": angles}
        content["parameters"] = {name: {"mean": mean, "sd": deviation} for name, (mean, deviation) in self.parameters.items()}
        if self.log_score is not None:
            content["log_score"] = list(self.log_score)
        content["models"] = list(self.models)
        write_atomically(Path(path), utf8(json.dumps(content, indent=1) + "\n"))

    @classmethod
    def load(cls, path: str | Path) -> Band:
        """Read a band that `save` wrote. Raises AsterismError where the file is none."""
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            if content["format"] != _FORMAT:
                raise AsterismError(f"{path} is a band of another version ({content['format']}); make it again with --save-band.")
            mean, deviation = (
                {name: np.radians(np.asarray(angles[which], dtype=np.float64)) for name, angles in content["angles"].items()}
                for which in ("mean_deg", "sd_deg")
            )
            people, cycles = int(content["people"]), int(content["cycles"])
            parameters = {name: (float(one["mean"]), float(one["sd"])) for name, one in content.get("parameters", {}).items()}
            logs = content.get("log_score")
            log_score = None if logs is None else (float(logs[0]), float(logs[1]))
            models = tuple(map(str, content.get("models", ())))
        except OSError as problem:
            raise AsterismError(f"{path} cannot be read ({problem.strerror}); name a file that --save-band wrote.") from None
        except (ValueError, KeyError, TypeError, AttributeError, IndexError):
            raise AsterismError(f"{path} is no band of gait curves; make one with asterism gait controls/*.c3d --save-band FILE.") from None
        if any(values.shape != (POINTS, 3) for values in (*mean.values(), *deviation.values())):
            raise AsterismError(f"{path} has curves of another length than {POINTS} points; make the band again with --save-band.")
        return cls(mean, deviation, people, cycles, parameters, log_score, models)


def band_of(analyses: Sequence[GaitAnalysis], people: Sequence[str]) -> Band:
    """The band of analysed walks; `people` names whose each is. Each person counts once, whatever the number of cycles, and
    turns not at all where somebody goes straight.

    Raises AsterismError where no walk has angles over a whole cycle, and for fewer than two people.
    """
    analyses = analyses_without_turns(analyses)
    band, walks = _band(analyses, people), list(zip(analyses, people, strict=True))
    scores = []
    for person in sorted(set(people)) if band.people > 2 else ():
        others = [(analysis, name) for analysis, name in walks if name != person]
        # Who is part of a mean is near to it: each is scored by the others.
        without = _band([analysis for analysis, _ in others], [name for _, name in others])
        scores += [score.gps for score in profile_scores([analysis for analysis, name in walks if name == person], without)]
    logs = np.log(scores)
    return replace(band, log_score=(float(logs.mean()), float(logs.std(ddof=1))) if len(logs) > 2 else None)


def _band(analyses: Sequence[GaitAnalysis], people: Sequence[str]) -> Band:
    curves: dict[str, dict[str, list[Floats]]] = {}
    for analysis, person in zip(analyses, people, strict=True):
        for name, cycles in analysis.curves.items():
            curves.setdefault(name[1:].removesuffix("Angles"), {}).setdefault(person, []).extend(cycles)
    who = {person for by_person in curves.values() for person in by_person}
    if len(who) < 2:
        raise AsterismError(
            f"a band needs whole gait cycles of two people or more, and {len(who)} has some (cycles of turns do not count beside others); "
            "give more controls."
        )
    mean, deviation, count = {}, {}, 0
    for name, by_person in curves.items():
        means = np.stack([np.nanmean(cycles, axis=0) for cycles in by_person.values()])
        within = np.mean([np.nanvar(cycles, axis=0) for cycles in by_person.values()], axis=0)
        # What a single cycle of a control does: how people differ, and how one person's cycles do.
        mean[name], deviation[name] = means.mean(axis=0), np.sqrt(means.var(axis=0, ddof=1) + within)
        count = max(count, sum(len(cycles) for cycles in by_person.values()))
    return Band(mean, deviation, len(who), count, _parameters_of(analyses, people), models=_models(analyses))


def _models(analyses: Sequence[GaitAnalysis]) -> tuple[str, ...]:
    known = [(one.clinical.model, one.recording) for one in analyses if one.clinical is not None]
    return tuple(dict.fromkeys(model.title(recording) for model, recording in known))


def other_models(analyses: Sequence[GaitAnalysis], band: Band) -> str:
    """A sentence where angles are by other definitions than those of a band, so that scores hold the difference; else nothing."""
    others = [title for title in _models(analyses) if title not in band.models]
    if not others or not band.models:
        return ""
    return f"The controls' angles are by {listed(band.models)}, these by {listed(others)}: a score holds that difference, too."


def _parameters_of(analyses: Sequence[GaitAnalysis], people: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of each parameter that two people or more have, of both sides together."""
    by_name: dict[str, dict[str, list[float]]] = {}
    for analysis, person in zip(analyses, people, strict=True):
        for one in analysis.parameters:
            by_name.setdefault(one.name, {}).setdefault(person, []).append(one.value)
    found = {}
    for name, by_person in by_name.items():
        if len(by_person) > 1:
            means, within = (np.array([part(values) for values in by_person.values()]) for part in (np.mean, np.var))
            found[name] = (float(means.mean()), float(np.sqrt(means.var(ddof=1) + within.mean())))
    return found


@dataclass(frozen=True)
class ProfileScore:
    """How far the mean curves of one side, "L" or "R", are from a band (Baker et al. 2009), rad.

    variables  the Gait Variable Score of each angle of `SCORED`, RMS over the cycle
    gps        the Gait Profile Score, their RMS
    gdi        the Gait Deviation Index that follows from it (GDI* of Schwartz, Rozumalski and Baker 2013): 100 is the mean of the band's
               people, and 10 less is a standard deviation of theirs; None where the band does not tell how they differ
    sigmas, gps_sigma, gdi_sigma  their standard uncertainties, from session to session; none where they were not asked for
    """

    side: str
    variables: Mapping[str, float]
    gps: float
    gdi: float | None = None
    sigmas: Mapping[str, float] = field(default_factory=dict)
    gps_sigma: float | None = None
    gdi_sigma: float | None = None


def profile_scores(analyses: Sequence[GaitAnalysis], band: Band, *, sigmas: bool = False) -> list[ProfileScore]:
    """The scores of each side of which all nine angles are known, over the cycles of the walks that count (`without_turns`).

    sigmas  also how uncertain they are, by the bands of the angles (`angle_bands`), to first order: an angle is off alike over the cycle,
            and each angle on its own

    >>> from asterism.gait import analyse_gait
    >>> from asterism.simulation import simulate_walks
    >>> walks = [analyse_gait(walk) for walk in simulate_walks(3, frames=300, markers="helen-hayes", seed=4)]
    >>> scores = profile_scores(walks[:1], band_of(walks, ["a", "b", "c"]))
    >>> [score.side for score in scores], bool(0 < scores[0].gps < 0.5)
    (['L', 'R'], True)
    """
    scores, pairs = [], list(zip(analyses, analyses_without_turns(analyses), strict=True))
    for side in ("L", "R"):
        variables, spread = dict[str, float](), dict[str, float]()
        for quantity, which, title in SCORED:
            name = f"{side}{quantity}Angles"
            own = [(analysis, counted.curves[name]) for analysis, counted in pairs if name in counted.curves]
            if own and quantity in band.mean:
                apart = np.nanmean(np.concatenate([curves for _, curves in own])[:, :, which], axis=0) - band.mean[quantity][:, which]
                # Directions of progression differ by whole turns.
                apart = (apart + np.pi) % (2 * np.pi) - np.pi
                variables[title] = float(np.sqrt(np.mean(apart**2)))
                known = [analysis.bands[name].standard for analysis, _ in own if name in analysis.bands] if sigmas else []
                if known and variables[title] > 0.0:
                    off = np.mean([np.sqrt(sum(part[:, which] ** 2 for part in one.values())) for one in known], axis=0)
                    spread[title] = abs(float(np.nanmean(apart * off))) / variables[title]
        if len(variables) == len(SCORED) and np.isfinite(list(variables.values())).all():
            gps = float(np.sqrt(np.mean(np.square(list(variables.values())))))
            gdi = None
            if band.log_score is not None and gps > 0 and band.log_score[1] > 0:
                gdi = 100.0 - 10.0 * (float(np.log(gps)) - band.log_score[0]) / band.log_score[1]
            score = ProfileScore(side, variables, gps, gdi, spread)
            if len(spread) == len(SCORED):
                off_gps = float(np.sqrt(sum((variables[title] * spread[title]) ** 2 for title in spread))) / (len(SCORED) * gps)
                off_gdi = None if gdi is None or band.log_score is None else 10.0 * off_gps / gps / band.log_score[1]
                score = replace(score, gps_sigma=off_gps, gdi_sigma=off_gdi)
            scores.append(score)
    return scores
