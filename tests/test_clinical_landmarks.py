"""Angles from landmarks, some carried over from a standing trial: of a body built of known angles, and of people who wear two sets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import asterism
from asterism import AsterismError, Recording, formats
from asterism.cli import main
from asterism.gait import analyse_gait
from asterism.motion.clinical import (
    ClinicalAngles,
    ClinicalErrors,
    SubjectMeasures,
    clinical_angles,
    clinical_uncertainty,
    gathered_measures,
)
from asterism.motion.clinical.measures import computed_by_the_file
from asterism.motion.uncertainty import MonteCarloRules

WIDTH, DEPTH = 0.24, 0.15
TO_ROOM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From the axes of ISB, x ahead, y up, z to the right, into a room with z up."""
RIZZOLI = ("LASIS", "LPSIS", "LGT", "LLE", "LME", "LHF", "LTT", "LLM", "LMM", "LCA", "LFM", "LSM", "LVM")
HELEN_HAYES = dict(zip(RIZZOLI, ("LASI", "LPSI", "LTHI", "LKNE", "LKNM", "", "", "LANK", "LMED", "LHEE", "", "LTOE", ""), strict=True))
CAST = dict(zip(RIZZOLI, ("LIAS", "LIPS", "", "LFLE", "LKNM", "", "", "LFAL", "LMM", "LFCC", "LFM1", "LFM2", "LFM5"), strict=True))
OUT_OF_LINE = ((0.07, 0.02), (0.05, -0.04), (0.09, 0.03), (0.06, 0.0))


def person(*poses: tuple[tuple[float, ...], ...], names: dict[str, str] | None = None, heading: float = 0.0) -> Recording:
    """A frame for each pose: flexion, adduction, internal rotation of hip, knee and ankle in degrees, both sides alike.

    names  of the markers by the left ones of Leardini et al.; "" for none. Clusters of CAST are on it where its names are asked for
    """
    frames = [_frame(pose) for pose in poses]
    wanted = {own: own for own in RIZZOLI} if names is None else names
    clusters = [f"{side}{limb}{k}" for side in "LR" for limb in ("TH", "SK") for k in (1, 2, 3, 4)] if wanted is CAST else []
    chosen = {side + own[1:]: side + name[1:] for own, name in wanted.items() if name for side in "LR"} | {one: one for one in clusters}
    turn = Rotation.from_euler("z", heading, degrees=True).as_matrix()
    positions = np.array([[turn @ TO_ROOM @ frame[own] + [0, 0, 0.9] for own in chosen] for frame in frames])
    return Recording(positions, tuple(chosen.values()), 100.0)


def _frame(pose: tuple[tuple[float, ...], ...]) -> dict[str, np.ndarray]:
    """Landmarks in the axes of ISB from midway between the anterior spines, by a chain of rotations."""
    places: dict[str, np.ndarray] = {}
    for side, right in (("L", -1.0), ("R", 1.0)):
        (hf, ha, hr), (kf, ka, kr), (af, ai, ar) = pose
        out = np.array([0.0, 0.0, right])
        thigh = Rotation.from_euler("ZXY", [hf, right * ha, right * hr], degrees=True)
        shank = thigh * Rotation.from_euler("ZXY", [-kf, right * ka, right * kr], degrees=True)
        foot = shank * Rotation.from_euler("ZXY", [af, right * ai, right * ar], degrees=True)
        hip = WIDTH * np.array([-0.22, -0.30, right * 0.36])
        knee = hip + thigh.apply([0, -0.40, 0])
        ankle = knee + shank.apply([0, -0.38, 0])
        heel = ankle + foot.apply([-0.05, -0.06, 0])
        places |= {f"{side}ASIS": out * WIDTH / 2, f"{side}PSIS": np.array([-DEPTH, 0, right * 0.05])}
        places |= {f"{side}GT": hip + thigh.apply([0.02, -0.20, right * 0.09])}
        places |= {f"{side}LE": knee + thigh.apply(0.05 * out), f"{side}ME": knee - thigh.apply(0.05 * out)}
        places |= {f"{side}HF": ankle + shank.apply([0, 0.34, right * 0.05]), f"{side}TT": ankle + shank.apply([0.04, 0.33, 0])}
        places |= {f"{side}LM": ankle + shank.apply(0.04 * out), f"{side}MM": ankle - shank.apply(0.04 * out)}
        places |= {f"{side}CA": heel, f"{side}SM": heel + foot.apply([0.18, 0, 0])}
        places |= {f"{side}FM": heel + foot.apply([0.17, 0, -right * 0.04]), f"{side}VM": heel + foot.apply([0.14, 0, right * 0.05])}
        for k, (beside, ahead) in enumerate(OUT_OF_LINE, 1):
            places[f"{side}TH{k}"] = hip + thigh.apply([ahead, -0.1 - 0.05 * k, right * beside])
            places[f"{side}SK{k}"] = knee + shank.apply([ahead, -0.08 - 0.05 * k, right * beside])
    return places


UPRIGHT = ((0.0, 0.0, 0.0),) * 3
BENT = ((35.0, 6.0, -9.0), (62.0, -4.0, 8.0), (12.0, 5.0, -7.0))
BACK = ((-15.0, -7.0, 11.0), (5.0, 3.0, -6.0), (-18.0, -4.0, 9.0))


def agree(clinical: ClinicalAngles, frame: int, pose: tuple[tuple[float, ...], ...]) -> None:
    found = {joint.name: np.degrees(joint.angles[frame]) for joint in clinical.joints}
    for side in ("left", "right"):
        for joint, angles in zip(("hip", "knee", "ankle"), pose, strict=True):
            np.testing.assert_allclose(found[f"{side} {joint}"], angles, atol=1e-6, err_msg=f"{side} {joint}")


@pytest.mark.parametrize("heading", [0.0, 200.0])
@pytest.mark.parametrize("names", [None, CAST])
def test_a_body_bent_by_known_angles_has_them(names, heading) -> None:
    """Whose medial markers are in the recording itself: Rizzoli's names, and CAST's."""
    clinical = clinical_angles(person(BENT, BACK, names=names, heading=heading))
    assert clinical.model.name == "landmarks" and clinical.model.hip == "Bell et al. (1990)"
    agree(clinical, 0, BENT)
    agree(clinical, 1, BACK)
    told = [finding.sentence for finding in clinical.findings if finding.code == "clinical-model"]
    assert len(told) == 1 and ("Leardini" in told[0]) == (names is None)


def test_helen_hayes_with_medial_markers_has_knees_and_hips_of_the_same_angles() -> None:
    """Two markers make its foot, whose third axis is the ankle's: dorsiflexion counts from the line of heel and toe."""
    clinical = clinical_angles(person(BENT, names=HELEN_HAYES))
    found = {joint.name: np.degrees(joint.angles[0]) for joint in clinical.joints}
    for side in ("left", "right"):
        np.testing.assert_allclose(found[f"{side} hip"], BENT[0], atol=1e-6)
        np.testing.assert_allclose(found[f"{side} knee"], BENT[1], atol=1e-6)
        assert found[f"{side} ankle"][0] == pytest.approx(BENT[2][0], abs=1.5) and found[f"{side} ankle"][2] == pytest.approx(-7.0, abs=1.0)
    assert "ISB" in next(finding.sentence for finding in clinical.findings if finding.code == "clinical-model")


@pytest.mark.parametrize("names", [None, CAST])
def test_a_standing_trial_carries_medial_markers_that_the_walk_does_not_show(names) -> None:
    """Standing as the person likes: it only says where landmarks are among the markers of a limb."""
    whole = person(BENT, BACK, names=names)
    medial = [name for name in whole.labels if name[1:] in ("ME", "KNM", "MM")]
    walk = whole.select([name for name in whole.labels if name not in medial])
    static = person(((8.0, 2.0, -3.0), (5.0, 1.0, 2.0), (4.0, 0.0, 6.0)), UPRIGHT, names=names, heading=70.0)
    # of another file: with a subject's name before the markers', and y up
    turned = static.positions @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    up = np.array([0.0, 1.0, 0.0])
    static = replace(static, positions=turned, labels=tuple(f"Ann:{name}" for name in static.labels), vertical=up)
    clinical = clinical_angles(walk, static=static)
    agree(clinical, 0, BENT)
    agree(clinical, 1, BACK)
    told = next(finding.sentence for finding in clinical.findings if finding.code == "clinical-model")
    assert ("CAST" in told) == (names is CAST) and "carried over from the standing trial: LME, LMM, RME, RMM" in told
    shifted = walk.positions.copy()
    shifted[0, walk.labels.index("LFLE" if names else "LGT")] += 0.05
    moved = clinical_angles(replace(walk, positions=shifted), static=static)
    off = np.degrees(moved.outputs["LHipAngles"][0] - clinical.outputs["LHipAngles"][0])
    assert (np.abs(off).max() < 1e-6) == (names is CAST), "of CAST only the cluster counts"


def test_a_marker_of_the_pelvis_that_a_walk_never_shows_is_carried_too() -> None:
    whole, static = person(BENT, BACK), person(UPRIGHT)
    for name in ("LASIS", "RPSIS"):
        hidden = whole.positions.copy()
        hidden[:, whole.labels.index(name)] = np.nan
        agree(clinical_angles(replace(whole, positions=hidden), static=static), 1, BACK)


@pytest.mark.parametrize("name", ["LHF", "RTT", "LVM"])
def test_a_marker_that_one_leg_lacks_leaves_both_legs_one_definition(name: str) -> None:
    """Legs that are bent alike have the same angles, whatever the definition."""
    whole = person(BENT)
    found = clinical_angles(whole.select([label for label in whole.labels if label != name])).outputs
    for joint in ("Hip", "Knee", "Ankle"):
        np.testing.assert_allclose(found[f"L{joint}Angles"], found[f"R{joint}Angles"], atol=1e-9)


def test_what_can_be_computed_is_and_the_rest_is_named() -> None:
    whole = person(BENT, BACK)
    without = clinical_angles(whole.select([name for name in whole.labels if name not in ("LMM", "RCA")]), model="landmarks")
    assert [joint.name for joint in without.joints] == ["left hip", "right hip", "right knee"]
    said = " ".join(finding.sentence for finding in without.findings if finding.code == "clinical-left-out")
    assert "left knee, ankle: LMM" in said and "right ankle: RCA" in said
    pelvis = clinical_angles(whole.select([name for name in whole.labels if name not in ("LME", "RME", "LMM", "RMM")]))
    assert not pelvis.joints and {"LPelvisAngles", "RFootProgressAngles"} <= set(pelvis.outputs)
    with pytest.raises(AsterismError, match="epicondyles and malleoli"):
        clinical_angles(whole.select(["LLE", "LME", "LLM", "LMM"]))
    with pytest.raises(AsterismError, match="no model"):
        clinical_angles(whole, model="cgm")


def test_other_spellings_of_plug_in_gaits_markers_make_the_same_angles() -> None:
    """As Cortex writes them, and behind a subject's name. A thigh's other markers are no wands."""
    from asterism.motion.clinical import complete_legs, with_static_offsets
    from asterism.recording.marker_set import shipped_sets
    from asterism.simulation import simulate_walks

    [walk] = simulate_walks(1, frames=60, markers="helen-hayes", seed=0)
    aliases = shipped_sets()["helen-hayes"].aliases
    theirs = clinical_angles(walk, measures=with_static_offsets(walk, SubjectMeasures()))
    for labels in ([aliases[name][0] for name in walk.labels], [f"Ann:{name}" for name in walk.labels]):
        other = replace(walk, labels=tuple(labels))
        own = clinical_angles(other, measures=with_static_offsets(other, SubjectMeasures()))
        assert complete_legs(other) == ("L", "R") and own.outputs.keys() == theirs.outputs.keys()
        for name, values in theirs.outputs.items():
            np.testing.assert_array_equal(own.outputs[name], values)
    wands = {"LTHI": "LTH1", "RTHI": "RTH1", "LTIB": "LSK1", "RTIB": "RSK1"}
    without = clinical_angles(replace(walk, labels=tuple(wands.get(name, name) for name in walk.labels)))
    assert not without.joints and without.model.name == "landmarks"


@pytest.mark.parametrize("missing", [(), ("LSM", "RSM")])
def test_a_walk_with_the_names_of_rizzoli_has_events(missing: tuple[str, ...]) -> None:
    """Without the second metatarsal's head the middle of the first and the fifth is the toe."""
    from asterism.gait import find_events
    from asterism.simulation import simulate_walks

    [walk] = simulate_walks(1, frames=300, seed=0)
    columns = {"LASIS": ("LASI", 0), "RASIS": ("RASI", 0), "LPSIS": ("SACR", 0), "RPSIS": ("SACR", 0)}
    for side in "LR":
        columns |= {f"{side}CA": (f"{side}HEE", 0), f"{side}SM": (f"{side}TOE", 0)}
        columns |= {f"{side}FM": (f"{side}TOE", 0.04), f"{side}VM": (f"{side}TOE", -0.04)}
    worn = {
        name: walk.positions[:, walk.labels.index(own)] + [0, beside, 0] for name, (own, beside) in columns.items() if name not in missing
    }
    ours = find_events(Recording(np.stack(list(worn.values()), axis=1), tuple(worn), walk.rate, vertical=walk.vertical)).events
    theirs = find_events(walk.select(["LASI", "RASI", "SACR", "LHEE", "RHEE", "LTOE", "RTOE"])).events
    assert len(ours) == len(theirs) > 4
    assert max(abs(one.time - other.time) for one, other in zip(ours, theirs, strict=True)) < 0.001


def test_a_marker_that_one_leg_lacks_is_a_gap_and_one_that_both_lack_is_another_set() -> None:
    whole = person(BENT, BACK)
    for absent, severity in ((("LMM",), "warning"), (("LMM", "RMM"), "note")):
        clinical = clinical_angles(whole.select([name for name in whole.labels if name not in absent]), model="landmarks")
        assert {finding.severity.name.lower() for finding in clinical.findings if finding.code == "clinical-left-out"} == {severity}


@pytest.mark.parametrize("carried", [False, True])
def test_landmarks_that_are_put_elsewhere_turn_the_knee_as_far_as_geometry_says(carried: bool) -> None:
    """Of a leg that stands: 5 mm ahead or back, one of two epicondyles turns the thigh by 5 / 100, a malleolus the shank by 5 / 80.

    Also where the medial ones are carried from the standing trial: the same hand felt for them.
    """
    whole = person(UPRIGHT, names=HELEN_HAYES if not carried else CAST)
    static = person(UPRIGHT, UPRIGHT, names=CAST) if carried else None
    walk = whole.select([name for name in whole.labels if not carried or name[1:] not in ("KNM", "MM")])
    clinical = clinical_angles(walk, static=static)
    apart = [moved["LKneeAngles"][0, 2] - clinical.outputs["LKneeAngles"][0, 2] for moved in clinical.model.placed_anew(walk, 1e-6)]
    deviation = 0.005 * np.sqrt(np.sum(np.square(np.array(apart) / 1e-6)))
    by_hand = np.sqrt(2.0) * np.hypot(0.005 / 0.10, 0.005 / 0.08)
    assert deviation == pytest.approx(by_hand, rel=1e-3)
    assert clinical.model.carries(walk) == carried
    if not carried:
        errors = ClinicalErrors(skin=None, placement_m=0.005)
        drawn = clinical_uncertainty(walk, clinical, errors, rules=MonteCarloRules(most=150, block=150), budget_trials=4)
        assert drawn.joints[1].standard[0, 2] == pytest.approx(by_hand, rel=0.25)


def test_hip_centres_are_those_of_their_regressions() -> None:
    """By hand, in millimetres from midway between the spines: ahead, up, to the right."""
    walk = person(UPRIGHT)
    by_hand = {"bell": (-52.8, -72.0, 86.4), "harrington": (-0.24 * 150 - 9.9, -0.30 * 240 - 10.9, 0.33 * 240 + 7.3)}
    for name, place in by_hand.items():
        measures = replace(SubjectMeasures(), hip_regression=name)
        hip = clinical_angles(walk, measures=measures).model.body(walk).legs["R"].hip[0] - [0, 0, 0.9]
        np.testing.assert_allclose(1000 * TO_ROOM.T @ hip, place, atol=1e-6)
    with pytest.raises(AsterismError, match=r"Davis et al\. needs the length of a leg"):
        clinical_angles(walk, measures=replace(SubjectMeasures(), hip_regression="davis"))


def test_the_command_says_the_model_and_takes_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from asterism.simulation import simulate_walks

    [plain] = simulate_walks(1, frames=120, markers="helen-hayes", seed=0)
    legs = clinical_angles(plain).model.body(plain).legs
    lateral = {f"{side}{name}": plain.positions[:, plain.labels.index(f"{side}{name}")] for side in "LR" for name in ("KNE", "ANK")}
    medial = {f"{side}KNM": 2 * legs[side].knee - lateral[f"{side}KNE"] for side in "LR"}
    medial |= {f"{side}MED": 2 * legs[side].ankle - lateral[f"{side}ANK"] for side in "LR"}
    positions = np.concatenate([plain.positions, np.stack(list(medial.values()), axis=1)], axis=1)
    formats.write(tmp_path / "walk.c3d", Recording(positions, (*plain.labels, *medial), plain.rate, vertical=plain.vertical))
    words = [str(tmp_path / "walk.c3d"), "--vertical", "z"]
    main(["gait", *words, "--hip", "harrington"])
    assert "medial markers" in (told := "".join(capsys.readouterr())) and "Harrington et al. (2007)" in told
    main(["gait", *words, "--lower-body", "plug-in-gait"])
    assert "medial markers" not in (told := "".join(capsys.readouterr())) and "no knee width" in told
    assert main(["motion", *words, "--limbs", "2", "--lower-body", "landmarks", "--anatomy"]) in (0, 1)
    assert "ISB" in "".join(capsys.readouterr())


def test_two_models_of_one_real_walk_agree(data: Path) -> None:
    """Both with the standing trial's medial markers: Plug-in-Gait's wands against midpoints. One knee alone has the tibia's torsion.

    Ferrari et al. (2008) found such models to differ by up to 8 degrees in one walk, but for rotations, after their offsets.
    """
    static, walk = (asterism.read(data / f"movement/clinical-lower/auc_{name}.c3d") for name in ("static", "dynamic"))
    wands = clinical_angles(walk, measures=gathered_measures(walk, static)[0], static=static)
    bones = clinical_angles(walk, static=static, model="landmarks")
    assert (wands.model.name, bones.model.name) == ("plug-in-gait", "landmarks")
    for side in "LR":
        for name, parts in (("Hip", 3), ("Knee", 2)):
            apart = np.degrees(wands.outputs[f"{side}{name}Angles"] - bones.outputs[f"{side}{name}Angles"])[:, :parts]
            assert np.sqrt(np.nanmean(apart**2, axis=0)).max() < 3.0, name
        torsion = np.nanmedian(np.degrees(wands.outputs[f"{side}KneeAngles"] - bones.outputs[f"{side}KneeAngles"])[:, 2])
        assert 15.0 < torsion < 45.0, "the ankle's axis is turned outwards by the tibia"


def test_landmarks_of_a_treadmill_walk_bend_as_the_vendors_model_does(data: Path) -> None:
    """A laboratory that wears medial markers, and whose program wrote angles of Plug-in-Gait: the same pelvis, flexions but for offsets."""
    walk = asterism.read(data / "gait-events/treadmill/gaitalytics.c3d")
    clinical = clinical_angles(walk)
    assert clinical.model.name == "landmarks"
    for side in "LR":
        for name, most in (("Pelvis", 0.1), ("Hip", 2.0), ("Knee", 3.0)):
            theirs = computed_by_the_file(walk, f"{side}{name}Angles")
            assert theirs is not None
            apart = np.degrees(clinical.outputs[f"{side}{name}Angles"][:, 0]) - theirs[:, 0]
            assert np.nanstd(apart) < most, name
    bands = analyse_gait(walk.frames(slice(0, 350))).bands
    for name, (least, most) in {"LHipAngles": (2.0, 6.0), "LKneeAngles": (1.5, 7.0)}.items():
        assert least < np.degrees(np.nanmax(bands[name].high - bands[name].low, axis=0))[0] / 2 < most, name
