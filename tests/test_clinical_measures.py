"""Measures of a person: from tables, .mp and .vsk; with a standing trial; and those of another person."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import asterism
from asterism import AsterismError, Recording, formats
from asterism.cli import main
from asterism.motion.clinical import StaticRules, clinical_angles, gathered_measures, with_static_offsets
from asterism.motion.clinical.measure_files import measures_of_person, read_measures
from asterism.motion.clinical.measures import computed_by_the_file
from asterism.simulation import simulate_walks

VSK = """<?xml version="1.0" encoding="UTF-8"?>
<KinematicModel MODEL="PlugInGait"><Parameters>
<StaticParameter NAME="LeftKneeWidth" PRIOR="120" QUANTITY="length" VALUE="105"/>
<StaticParameter NAME="RightAnkleWidth" PRIOR="100" QUANTITY="length"/>
<StaticParameter NAME="LeftTibialTorsion" PRIOR="0" QUANTITY="angle" VALUE="-0.2"/>
<StaticParameter NAME="Bodymass" QUANTITY="mass" VALUE="75"/>
<StaticParameter NAME="InterAsisDistance" QUANTITY="length" VALUE="0"/>
<StaticParameter NAME="LeftSoleDelta" QUANTITY="length" VALUE="3"/>
</Parameters></KinematicModel>"""


def test_a_vsk_has_radians_and_an_mp_degrees_and_what_nobody_measured_is_absent(tmp_path: Path) -> None:
    (tmp_path / "ann.vsk").write_text(VSK)
    known = read_measures(tmp_path / "ann.vsk")[""]
    assert known == {"LKneeWidth": 105.0, "LTibialTorsion": pytest.approx(np.degrees(-0.2)), "Bodymass": 75.0}
    lines = "$Bodymass = 67\r\r\n$LKneeWidth=102,5\r\n$RKneeWidth = 0\n$RWristWidth = 0\npelvis_RASI_x = 4.1e-05\n$LTibialTorsion = -12\n"
    (tmp_path / "ann.mp").write_bytes(lines.encode())
    assert read_measures(tmp_path / "ann.mp")[""] == {"Bodymass": 67.0, "LKneeWidth": 102.5, "RWristWidth": 0.0, "LTibialTorsion": -12.0}


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_table_has_a_row_for_each_person_or_one_for_each_measure(tmp_path: Path, separator: str) -> None:
    rows = [["person", "LKneeWidth (cm)", "Left Tibial Torsion [rad]", "shoe"], ["ann", "10.2", "0.1", "38"], ["bob", "9.9", "", "44"]]
    (tmp_path / "all.csv").write_text("\n".join(separator.join(row) for row in rows) + "\n")
    [recording] = simulate_walks(1, frames=5, seed=0)
    for file, width in (("data/ann/walk1.c3d", 102.0), ("data/bob_walk.c3d", 99.0)):
        own = measures_of_person(tmp_path / "all.csv", replace(recording, metadata={"file": file}))
        assert own["LKneeWidth"] == pytest.approx(width) and ("LeftTibialTorsion" in own or "LTibialTorsion" in own) == (width == 102.0)
    with pytest.raises(AsterismError, match=r"2 people \(ann, bob\).*of none of them"):
        measures_of_person(tmp_path / "all.csv", replace(recording, metadata={"file": "data/eve/walk.c3d"}))
    (tmp_path / "one.csv").write_text(f"LKneeWidth{separator}0.1\n")
    with pytest.raises(AsterismError, match=r"one\.csv: LKneeWidth is 0\.1; give it in mm"):
        measures_of_person(tmp_path / "one.csv", recording)
    (tmp_path / "one.csv").write_text(f"measure{separator}mm\nLKneeWidth{separator}101\nRKneeWidth{separator}\n")
    assert read_measures(tmp_path / "one.csv") == {"": {"LKneeWidth": 101.0}}


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.vsk", "<KinematicModel><Param", "no whole XML"),
        ("a.vsk", "<KinematicModel/>", "no measure"),
        ("a.mp", "$LKneeWidth = broad", "no number"),
        ("a.csv", "person,LKneeWidth (inch)\nann,4\n", "is in inch"),
        ("a.csv", "person,LKneeWidth\nann,100\nann,101\n", "twice"),
        ("a.csv", "\n", "empty"),
    ],
)
def test_a_damaged_file_of_measures_is_refused_by_name(tmp_path: Path, name: str, content: str, said: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(AsterismError, match=rf"(?s){name}.*{said}"):
        read_measures(tmp_path / name)


def held(recording: Recording, **numbers: float) -> Recording:
    """The recording, as if its file held these parameters: mm, rad."""
    parameters = SimpleNamespace(number=lambda group, name: {key.upper(): value for key, value in numbers.items()}.get(name))
    return replace(recording, source=SimpleNamespace(parameters=parameters, labels=(), coordinates=None))


@pytest.mark.parametrize(("unit", "value", "read"), [(0.001, 102, 0.102), (1.0, 0.102, 0.102), (1.0, 102, 0.102), (0.001, 4, 0.1)])
def test_lengths_of_a_file_are_in_the_unit_of_its_points_or_in_mm(unit: float, value: float, read: float) -> None:
    """4 may be in inches, or no such width: nobody guesses, an adult's is named."""
    [walk] = simulate_walks(1, frames=5, markers="helen-hayes", seed=0)
    own = held(replace(walk, metadata={**walk.metadata, "metres_per_unit": unit}), LKneeWidth=value)
    measures = gathered_measures(own)[0]
    assert measures.left.knee_width == pytest.approx(read) and ("knee_width" in measures.left.from_file) == (value != 4)


@pytest.mark.parametrize(("name", "value"), [("BodyMass", 54500), ("BodyMass", -5), ("MarkerDiameter", 0.014), ("InterAsisDistance", 0.24)])
def test_a_measure_of_the_whole_person_in_another_unit_is_told(name: str, value: float) -> None:
    with pytest.raises(AsterismError, match=f"{name} is .*; give it in"):
        gathered_measures(simulate_walks(1, frames=12, markers="helen-hayes", seed=0)[0], given={name: value})


def stood(recording: Recording) -> Recording:
    """The person as in the first frame, all the time, with both feet flat: heels as high above the toes as they come down in the walk."""
    positions = np.repeat(recording.positions[:1], len(recording), axis=0)
    for heel, toe in ((recording.labels.index(f"{side}HEE"), recording.labels.index(f"{side}TOE")) for side in "LR"):
        back = positions[0, heel] - positions[0, toe]
        up, long = np.subtract(*np.quantile(recording.positions[:, [heel, toe], 2], 0.08, axis=0)), np.linalg.norm(back)
        level = back[:2] / np.linalg.norm(back[:2]) * np.sqrt(long**2 - up**2)
        positions[:, heel] = positions[:, toe] + np.append(level, up)
    return replace(recording, positions=positions, events=())


def test_a_walk_given_as_the_standing_trial_is_told() -> None:
    """Offsets of feet and wands would be means over steps; a person who sways stands."""
    [walk] = simulate_walks(1, frames=150, markers="helen-hayes", seed=0)
    sway = np.linspace(0.0, 0.05, len(walk))[:, None, None] * [1.0, 0.0, 0.0]
    for static, told in ((walk, 1), (stood(walk), 0), (replace(stood(walk), positions=stood(walk).positions + sway), 0)):
        assert [finding.code for finding in gathered_measures(walk, static)[1]] == ["clinical-static-moves"] * told
    hidden = walk.positions.copy()
    hidden[:, walk.labels.index("LANK")] = np.nan
    assert "clinical-static-moves" not in [one.code for one in gathered_measures(walk, replace(walk, positions=hidden))[1]]


def test_walks_of_two_persons_in_one_analysis_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [walk] = simulate_walks(1, frames=300, markers="helen-hayes", seed=0)
    files = [tmp_path / name for name in ("ann 1.c3d", "ann 2.c3d", "bob.c3d")]
    for file, one in zip(files, (walk, walk, replace(walk, positions=0.8 * walk.positions)), strict=True):
        asterism.write(file, one)
    main(["gait", *map(str, files)])
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "clinical-other-person" in line]
    assert "bob.c3d and" in line and "two persons" in line
    main(["gait", *map(str, files), "--save-band", str(tmp_path / "band.json")])
    assert "two persons" not in capsys.readouterr().err


def test_given_measures_go_before_the_standing_trials_and_these_before_the_files() -> None:
    [walk] = simulate_walks(1, frames=30, markers="helen-hayes", seed=0)
    own = held(walk, LKneeWidth=90, RKneeWidth=91, LAnkleWidth=60, BodyMass=50)
    static = held(stood(walk), RKneeWidth=95, LAnkleWidth=61, MarkerDiameter=9)
    measures, found = gathered_measures(own, static, {"LAnkleWidth": 62})
    assert (measures.left.knee_width, measures.right.knee_width, measures.left.ankle_width) == (0.090, 0.095, 0.062)
    assert (measures.mass, measures.marker_radius) == (50, pytest.approx(0.0045))
    assert [one.code for one in found] == ["clinical-measure-differs"], "62 in place of 61"
    assert "foot_flexion" in measures.left.from_file
    assert gathered_measures(own, static, {"MarkerDiameter": 16})[0].marker_radius == 0.008


def test_a_standing_trial_is_read_as_its_own_program_read_it_and_one_that_it_did_not_use_is_told() -> None:
    """With the marker's diameter that its file names, whatever the walk's was, and by the rule that comes nearest to the file's offsets."""
    [walk] = simulate_walks(1, frames=30, markers="helen-hayes", seed=0)
    lengths = {f"{side}{name}": value for side in "LR" for name, value in (("KneeWidth", 100), ("AnkleWidth", 70), ("LegLength", 940))}
    static, own = stood(walk), held(walk, MarkerDiameter=16, **lengths)
    for rules in (StaticRules(flat_foot=False), StaticRules()):
        thin = replace(gathered_measures(own)[0], marker_radius=0.005)
        flexion = {side: with_static_offsets(static, thin, rules).of(side).foot_flexion for side in "LR"}
        offsets = {f"{side}StaticPlantFlex": value for side, value in flexion.items()}
        measures, found = gathered_measures(own, held(static, MarkerDiameter=10, **offsets))
        assert [one.code for one in found] == ["clinical-static-rule"] * (not rules.flat_foot) and measures.marker_radius == 0.008
        assert {side: measures.of(side).foot_flexion for side in "LR"} == pytest.approx(flexion, abs=1e-12)
    measures, found = gathered_measures(own, held(static, MarkerDiameter=10, **offsets | {"RStaticPlantFlex": flexion["R"] + 0.2}))
    (one,) = found
    assert one.code == "clinical-static-differs" and "right foot flexion differs by 11 degrees" in one.sentence
    assert measures.right.foot_flexion == pytest.approx(flexion["R"], abs=1e-12), "what the trial shows is taken"


def test_a_heel_that_is_lifted_in_the_standing_trial_is_told_and_one_that_never_comes_down_in_the_walk_is_not() -> None:
    [walk] = simulate_walks(1, frames=120, markers="helen-hayes", seed=0)
    static, heel = stood(walk), walk.labels.index("LHEE")
    long = float(np.median(np.linalg.norm(walk.positions[:, heel] - walk.positions[:, walk.labels.index("LTOE")], axis=1)))

    def codes(walk: Recording, up: float) -> list[str]:
        moved = static.positions.copy()
        moved[:, heel, 2] += up * long
        return [
            one.sentence for one in gathered_measures(walk, replace(static, positions=moved))[1] if one.code == "clinical-static-lifted"
        ]

    assert not codes(walk, 0.0) and not codes(walk, 0.05)
    (said,) = codes(walk, 0.25)
    assert "left heel stands 1" in said
    on_toes = walk.positions.copy()
    on_toes[:, heel, 2] += 0.25 * long
    assert not codes(replace(walk, positions=on_toes), 0.0)


def test_measures_and_standing_trials_of_another_person_are_told() -> None:
    """Half a head smaller is another person; a foot that lifts or a knee that bends is not."""
    walk, other = simulate_walks(2, frames=60, markers="helen-hayes", seed=1)
    apart = np.linalg.norm(np.diff(walk.positions[:, [walk.labels.index(name) for name in ("LASI", "LKNE", "LANK")]], axis=1), axis=2)
    length = 1000 * (np.percentile(apart[:, 0], 95) + np.median(apart[:, 1]))
    for share, told in ((1.0, 0), (0.95, 0), (1.15, 1), (0.85, 1)):
        found = gathered_measures(walk, given={"LLegLength": length * share})[1]
        assert [finding.code for finding in found] == ["clinical-other-person"] * told
    assert not gathered_measures(walk, stood(walk))[1]
    child = stood(replace(other, positions=0.8 * other.positions))
    codes = [finding.code for finding in gathered_measures(walk, child)[1]]
    assert codes == ["clinical-other-person"]
    sliding = walk.positions.copy()
    sliding[:, walk.labels.index("LTHI"), 2] += np.linspace(-0.05, 0.05, len(sliding))
    still = walk.positions.copy()
    still[:, walk.labels.index("LTHI"), 2] += 0.08
    for positions, told in ((sliding, 0), (still, 1)):
        moved = gathered_measures(replace(walk, positions=positions), stood(walk))[1]
        assert [finding.code for finding in moved] == ["clinical-other-person"] * told, (
            "what slides tells no person; what was put anew is said"
        )


def test_an_adults_measure_is_never_taken_in_silence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where some measures are given: the others are named."""
    [walk] = simulate_walks(1, frames=120, markers="helen-hayes", seed=0)
    formats.write(tmp_path / "walk.c3d", walk)
    (tmp_path / "ann.mp").write_text("$LKneeWidth = 102\n$RKneeWidth = 103\n")
    words = [str(tmp_path / "walk.c3d"), "--vertical", "z", "--measure", str(tmp_path / "ann.mp"), "--measure", "LAnkleWidth=70"]
    for command in (["gait"], ["motion", "--limbs", "2"]):
        main([*command, *words])
        told = "".join(capsys.readouterr())
        assert "no leg length of the left leg" in told and "no ankle width, leg length of the right leg" in told
    kept = (tmp_path / "ann.mp").read_text()
    assert main(["gait", *words, "-o", str(tmp_path / "ann.mp"), "--overwrite"]) == 2 and (tmp_path / "ann.mp").read_text() == kept
    capsys.readouterr()
    assert main(["gait", *words[:3], "--measure", "LKneeWidth"]) == 2
    assert "neither a name with its value" in capsys.readouterr().err


def test_the_measures_of_a_vsk_make_the_vendors_own_angles(data: Path) -> None:
    """A standing trial whose C3D file holds no measures."""
    recording = asterism.read(data / "movement/pig39/rom_static.c3d")
    given = measures_of_person(data / "movement/pig39/rom.vsk", recording)
    clinical = clinical_angles(recording, measures=gathered_measures(recording, given=given)[0])
    for name in ("LHip", "RKnee", "LShoulder", "RElbow", "LWrist", "RWrist"):
        theirs = computed_by_the_file(recording, f"{name}Angles")
        assert theirs is not None
        apart = (np.degrees(clinical.outputs[f"{name}Angles"]) - theirs + 180.0) % 360.0 - 180.0
        assert np.sqrt(np.nanmean(apart**2, axis=0)).max() < 0.1, name


def test_a_measure_in_place_of_the_files_is_said_with_both() -> None:
    [walk] = simulate_walks(1, frames=12, markers="helen-hayes", seed=0)
    own = held(walk, LKneeWidth=87, RKneeWidth=88, LLegLength=870, BodyMass=60)

    def told(**given: float) -> dict[str, str]:
        return {one.code: one.sentence for one in gathered_measures(own, given=given)[1] if "measure-" in one.code}

    assert not told(LKneeWidth=87.4), "rounded"
    assert "LKneeWidth 95, not 87" in told(LKneeWidth=95)["clinical-measure-differs"]
    assert "BodyMass 70, not 60" in told(BodyMass=70)["clinical-measure-differs"]
    assert not told(LAnkleWidth=70, LTibialTorsion=-10), "the file says nothing of it"
    both = told(LKneeWidth=180)
    assert "left knee's width is 180 mm, the leg's length 870 mm" in both["clinical-measure-implausible"], "no knee of such a leg"
    assert "LKneeWidth 180, not 87" in both["clinical-measure-differs"]
    assert list(told(RKneeWidth=110)) == ["clinical-measure-differs", "clinical-measure-implausible"], "the other knee is of 87 mm"
    assert gathered_measures(own, given={"LKneeWidth": 95})[0].left.knee_width == pytest.approx(0.095), "what is given is taken"
