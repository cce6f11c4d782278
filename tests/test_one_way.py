"""A file has one way to its labels: commands, the page and Python give the same labels, verdicts, findings and refusals."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from correcting import model, recorded, walks

import asterism
from asterism import AsterismError, formats
from asterism.cli import main
from asterism.findings import Finding
from asterism.labelling import MarkerModel, join_labellings, label_together, recording_labeller, virtual_model
from asterism.labelling.correction import Ghost
from asterism.labelling.correction.touches import Touch
from asterism.labelling.recording_labeller import LabellingSettings, RecordingLabeller
from asterism.labelling.stretches import StretchRules
from asterism.labelling.whole.bodies import SeveralBodiesRules
from asterism.labelling.whole.settings import ForeignRules, RecordingLabellingSettings
from asterism.recording import Floats, Labelling, Recording, check_labels, filled_samples, is_partly_labelled, keep_labels
from asterism.session import FileLabeller, LabelledFile, LabellingOptions, SetFinder, label_file
from asterism.simulation import simulate_standing, simulate_walks

pytest.importorskip("starlette")

from asterism.web import CorrectionSession, SessionOptions
from asterism.web.app import make_app
from asterism.web.finishing import spans_of

FRAMES = slice(0, 36)
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Case:
    """A file, and how it is to be labelled.

    write    writes the files of the run below a folder, and gives them, the one that is judged first
    words    options of the commands
    options  the same in Python
    models   how often the model is given; 0 where the marker set is found and virtual people label
    codes    findings that must be among those of labelling, so that the case is what it says
    refused  what the refusal says; None where the file is labelled
    by_hand  the same by the model alone, in Python
    """

    write: Callable[[Path], list[Path]]
    words: Sequence[str] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    models: int = 1
    codes: frozenset[str] = frozenset()
    refused: str | None = None
    by_hand: Callable[[asterism.MarkerModel, Recording], Labelling] = lambda trained, recording: trained.label(recording)


@dataclass(frozen=True)
class Answer:
    """What one door says of a file; None where it does not say.

    paths      (T, M, 3) of the markers
    confidence (T, M)
    """

    paths: Floats | None = None
    confidence: Floats | None = None
    verdict: str | None = None
    use: str | None = None
    findings: Rows | None = None
    refusal: str | None = None


def anonymous(recording: Recording) -> Recording:
    return replace(recording, labels=tuple(f"*{m + 1}" for m in range(len(recording.labels))))


def only(make: Callable[[], Recording], name: str = "walk.c3d") -> Callable[[Path], list[Path]]:
    """What writes a single file."""

    def write(folder: Path) -> list[Path]:
        asterism.write(folder / name, make())
        return [folder / name]

    return write


def walk() -> Recording:
    return recorded(walks()[4].frames(FRAMES), seed=1)[0]


def two_people() -> Recording:
    one, other = (walks()[number].frames(FRAMES) for number in (4, 3))
    both = np.concatenate([one.positions, other.positions + np.array([3.0, 0.0, 0.0])], axis=1)
    return Recording(both, tuple(f"*{m + 1}" for m in range(both.shape[1])), one.rate, one.vertical)


def long_walk() -> Recording:
    there = anonymous(walks()[4])
    return replace(there, positions=np.concatenate([there.positions, there.positions[::-1]] * 2))


def with_standing(found: bool) -> Callable[[Path], list[Path]]:
    """A walk, and a trial in which this person stands: beside it, or elsewhere."""

    def write(folder: Path) -> list[Path]:
        standing = simulate_standing(subjects=5, frames=40, markers="helen-hayes", seed=3)[4]
        asterism.write(folder / "ann-walk.c3d", walk())
        asterism.write(folder / "ann-static.c3d", anonymous(standing))
        return [folder / "ann-walk.c3d", *([folder / "ann-static.c3d"] if found else [])]

    return write


def named(exchanged: bool) -> Recording:
    """A walk of which every third column lost its name; two names are perhaps exchanged."""
    one = walks()[4].frames(FRAMES)
    names = [f"*{m + 1}" if m % 3 == 0 else name for m, name in enumerate(one.labels)]
    if exchanged:
        names[1], names[4] = names[4], names[1]
    return replace(one, labels=tuple(names))


def no_body() -> Recording:
    """Points that keep no distance."""
    drift = np.random.default_rng(5).normal(0.0, 0.02, size=(60, 15, 3)).cumsum(axis=0)
    return Recording(np.random.default_rng(6).uniform(-1.0, 1.0, size=(15, 3)) + drift, tuple(f"*{m + 1}" for m in range(15)), 100.0)


def other_set() -> Recording:
    """Half of the markers, and eight others of which the model knows nothing."""
    one = walks()[4].frames(FRAMES)
    more = one.positions[:, :8] + np.array([0.0, 0.12, 0.07])
    both = np.concatenate([one.positions[:, ::2], more], axis=1)
    return Recording(both, tuple(f"*{m + 1}" for m in range(both.shape[1])), one.rate, one.vertical)


def damaged(folder: Path) -> list[Path]:
    (path,) = only(walk)(folder)
    path.write_bytes(path.read_bytes()[:700])
    return [path]


def narrowed(trained: asterism.MarkerModel, recording: Recording) -> Labelling:
    standing = Path(str(recording.metadata["file"])).with_name("ann-static.c3d")
    return trained.adapt(asterism.read(standing)).label(recording)


def named_by_hand(trained: asterism.MarkerModel, recording: Recording, *, keep: bool) -> Labelling:
    clouds, labelling = recording.clouds(), trained.label(recording)
    if keep:
        return keep_labels(labelling, recording, clouds, trained.marker_set)
    assert is_partly_labelled(recording, trained.marker_set)
    return check_labels(labelling, recording, clouds, trained.marker_set)[0]


def two_by_hand(trained: asterism.MarkerModel, recording: Recording) -> Labelling:
    return join_labellings(label_together([trained, trained], recording.clouds()), [trained.marker_set] * 2)[0]


def props() -> Recording:
    """A tray of points that is carried."""
    path = np.linspace(0.0, 2.0, 60)[:, None, None] * np.array([1.0, 0.0, 0.0])
    tray = np.random.default_rng(2).uniform(-0.15, 0.15, (1, 12, 3)) + np.array([0.0, 0.0, 1.0]) + path
    return Recording(tray, tuple(f"*{m + 1}" for m in range(12)), 100.0)


def refused_props(_: asterism.MarkerModel, recording: Recording) -> Labelling:
    """A model alone would label them: nobody is asked there which set is worn."""
    SetFinder().of(Path("walk.c3d"), recording)
    raise AssertionError("props are no person")


CASES = {
    "one person": Case(only(walk)),
    "no model": Case(only(walk), models=0, by_hand=lambda _, recording: virtual_model("helen-hayes").label(recording)),
    "no model, the set given": Case(
        only(walk),
        ["--markers", "helen-hayes"],
        {"markers": ["helen-hayes"]},
        models=0,
        by_hand=lambda _, recording: virtual_model("helen-hayes").label(recording),
    ),
    "no model, props": Case(only(props), models=0, refused="like no shipped marker set", by_hand=refused_props),
    "two people, one model": Case(only(two_people), codes=frozenset({"label-two-bodies"})),
    "two people, two models": Case(only(two_people), models=2, by_hand=two_by_hand),
    "long": Case(
        only(long_walk),
        codes=frozenset({"label-in-stretches"}),
        by_hand=lambda trained, recording: RecordingLabeller(trained, LabellingSettings()).label(recording.clouds()),
    ),
    "standing trial given": Case(
        with_standing(found=False), ["--subject", "ann-static.c3d"], {"standing": ["ann-static.c3d"]}, by_hand=narrowed
    ),
    "standing trial found": Case(with_standing(found=True), by_hand=narrowed),
    "names kept": Case(
        only(lambda: named(exchanged=True)), ["--keep-labels"], {"file_names": "keep"}, by_hand=partial(named_by_hand, keep=True)
    ),
    "names contradicting": Case(
        only(lambda: named(exchanged=True)), codes=frozenset({"label-names-differ"}), by_hand=partial(named_by_hand, keep=False)
    ),
    "nothing labelled": Case(only(no_body), codes=frozenset({"label-foreign-recording"})),
    "wrong unit": Case(only(lambda: replace(walk(), positions=walk().positions * 1000.0), "walk.csv"), refused="units are probably mm"),
    "other marker set": Case(only(other_set), codes=frozenset({"label-foreign-recording"})),
    "empty": Case(only(lambda: replace(walk(), positions=np.full_like(walk().positions, np.nan))), refused="has no points to label"),
    "damaged": Case(damaged, refused="walk.c3d"),
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Path]:
    """A folder with the model, in which the commands are called."""
    model().save(tmp_path / "gait.model")
    monkeypatch.chdir(tmp_path)
    # models of virtual people are made once for all cases
    if "long" in request.node.callspec.params["name"]:
        shorter = partial(StretchRules, whole=2000, points=2500, overlap=0.5)
        monkeypatch.setattr(recording_labeller, "StretchRules", shorter)
    yield tmp_path


def plain(findings: Sequence[Finding]) -> Rows:
    return [finding.to_dict() for finding in findings]


def of_file(path: Path, names: Sequence[str]) -> Floats:
    """The paths of markers in a labelled file; NaN where there is none."""
    recording = asterism.read(path)
    columns = [recording.labels.index(name) if name in recording.labels else -1 for name in names]
    return np.stack([recording.positions[:, c] if c >= 0 else np.full((len(recording), 3), np.nan) for c in columns], axis=1)


def of_labelled(labelled: LabelledFile) -> Answer:
    verdict = None if labelled.verdict is None else labelled.verdict.kind
    labelling, paths = labelled.labelling, labelled.labelling.positions(asterism.read(labelled.path).clouds())
    return Answer(paths, labelling.confidence, verdict, labelled.readiness.words, plain(labelled.findings))


class Doors:
    """All ways to label the files of a case."""

    def __init__(self, case: Case, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
        self.case, self.folder, self.capsys, self.monkeypatch = case, folder, capsys, monkeypatch
        self.listed = False
        self.files = [path.relative_to(folder) for path in case.write(folder)]
        self.models = [model()] * case.models
        self.labeller = RecordingLabeller(self.models or [virtual_model("helen-hayes")])
        self.names = self.labeller.marker_set.names

    def command(self, *words: str) -> str | None:
        """Call a command with the files of the case; what it says where it is refused."""
        given = [word for _ in self.models for word in ("--model", "gait.model")]
        status = main([words[0], *map(str, self.files), *given, *self.case.words, *words[1:]])
        said = self.capsys.readouterr().err.strip().splitlines()
        refused = [line.removeprefix("asterism: ") for line in said if "[" not in line]
        return refused[-1] if status == 2 else None

    def label(self) -> Answer:
        refusal = self.command("label", "-o", "labelled", "--json", "label.json")
        report = json.loads(Path("label.json").read_text())
        if refusal:
            return Answer(refusal=refusal)
        row = next(row for row in report["files"] if row["file"] == str(self.files[0]))
        paths = of_file(Path("labelled") / self.files[0], self.names)
        return Answer(paths, None, row["verdict"], row["use"], self.mine(report["findings"]))

    def review(self) -> Answer:
        """The list; what it labels is seen on the way."""
        labelled, plain_label = dict[Path, LabelledFile](), FileLabeller.label

        def label(labeller: FileLabeller, path: Path, *more: Any) -> LabelledFile:
            labelled[path] = plain_label(labeller, path, *more)
            return labelled[path]

        with self.monkeypatch.context() as patch:
            patch.setattr(FileLabeller, "label", label)
            refusal = self.command("review", "--json", "review.json", "--csv", "items.csv", "--overwrite")
        self.listed = refusal is None
        if refusal:
            return Answer(refusal=refusal)
        report = json.loads(Path("review.json").read_text())
        return replace(of_labelled(labelled[self.files[0]]), findings=self.mine(report["findings"]))

    def answers(self) -> Answer:
        """The list as a table, which `review` has written unless it was refused, and in which nothing was filled in."""
        refused = None if self.listed else self.command("review", "--csv", "items.csv", "--json", "-", "--overwrite")
        if refused:
            return Answer(refusal=refused)
        self.command("review", "--answers", "items.csv", "-o", "answered")
        return Answer(of_file(Path("answered") / self.files[0], self.names))

    def page(self) -> Answer:
        """The page's server, asked as the page asks it."""
        options = LabellingOptions(**self.options())
        session = CorrectionSession(self.files, self.models, SessionOptions([Path("gait.model")] * len(self.models), labelling=options))
        session.start().join()
        app = make_app(session)
        trial = ask(app, "GET", "/api/trials")["trials"][0]
        if trial["state"] == "failed":
            session.close()
            return Answer(refusal=trial["error"])
        if trial.get("naming"):
            # the page says why there are no labels, and lets the person name the points
            session.close()
            return Answer(refusal=f"{self.files[0]}: {trial['notes'][-1]}")
        state = ask(app, "GET", "/api/trials/0/state")
        ask(app, "POST", "/api/trials/0/save")
        with session.trial("0").opened() as correction:
            confidence, verdict = correction.labelling.confidence, correction.labelling.verdict
            use = correction.verdict.words
            assert state["verdict"]["kind"] == correction.verdict.kind and state["markers"] == list(self.names)
        session.close()
        kind = None if verdict is None else verdict.kind
        return Answer(
            of_file(self.files[0].parent / "corrected" / self.files[0].name, self.names), confidence, kind, use, trial["findings"]
        )

    def python(self) -> Answer:
        try:
            labelled = label_file(self.files[0], self.models, LabellingOptions(**self.options()), files=self.files)
        except AsterismError as problem:
            return Answer(refusal=str(problem))
        answer = of_labelled(labelled)
        columns = [labelled.recording.labels.index(name) for name in self.names]
        np.testing.assert_array_equal(labelled.recording.positions[:, columns], answer.paths)
        return answer

    def alone(self) -> Answer:
        """The model alone, of a recording that was read."""
        try:
            recording = formats.read(self.files[0])
            labelling = self.case.by_hand(model(), recording)
        except AsterismError as problem:
            sentence = str(problem)
            return Answer(refusal=sentence if str(self.files[0]) in sentence else f"{self.files[0]}: {sentence}")
        verdict = None if labelling.verdict is None else labelling.verdict.kind
        return Answer(labelling.positions(recording.clouds()), labelling.confidence, verdict)

    def options(self) -> dict[str, Any]:
        given = dict(self.case.options)
        return {**given, "standing": [Path(path) for path in given["standing"]]} if "standing" in given else given

    def mine(self, findings: Rows) -> Rows:
        """The findings on the labels of the file that is judged."""
        return [row for row in findings if row["where"] == str(self.files[0]) and row["code"] != "format-not-carried"]


def ask(app: Any, method: str, path: str) -> Any:
    """What an ASGI application answers."""
    sent = list[dict[str, Any]]()

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"{}", "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "method": method,
        "path": path,
        "query_string": b"",
        "headers": [(b"content-type", b"application/json")],
    }
    asyncio.run(app(scope, receive, send))
    answer = json.loads(b"".join(message.get("body", b"") for message in sent))
    assert sent[0]["status"] == 200, answer
    return answer


# Five doors label each case, some of them in a process: those whose kind another case shows as well are for --all.
_DEAR = ("nothing labelled", "names contradicting", "two people, one model")


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow) if name in _DEAR else name for name in CASES])
def test_all_doors_give_the_same(name: str, place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES[name]
    doors = Doors(case, place, capsys, monkeypatch)
    expected = doors.python()
    found = {way: getattr(doors, way)() for way in ("label", "review", "answers", "page", "alone")}
    if case.refused is not None:
        assert expected.refusal is not None and case.refused in expected.refusal
        assert {way: answer.refusal for way, answer in found.items()} == dict.fromkeys(found, expected.refusal)
        return
    assert expected.findings is not None and case.codes <= {row["code"] for row in expected.findings}
    for way, answer in found.items():
        assert answer.refusal is None, way
        for what in ("verdict", "use", "findings"):
            if getattr(answer, what) is not None:
                assert getattr(answer, what) == getattr(expected, what), f"{way}: {what}"
        np.testing.assert_allclose(answer.paths, expected.paths, atol=1e-6, err_msg=way)
        if answer.confidence is not None:
            np.testing.assert_array_equal(answer.confidence, expected.confidence, err_msg=way)


def test_the_cases_differ(tmp_path: Path) -> None:
    """A door that ignored names, the trial or the second person would not pass: these change what is given."""
    plain_labels = [label_file(path, model()) for path in only(lambda: named(exchanged=True))(tmp_path)]
    kept = label_file(plain_labels[0].path, model(), LabellingOptions(file_names="keep"))
    assert not np.array_equal(kept.labelling.indices, plain_labels[0].labelling.indices)
    walking, standing = with_standing(found=True)(tmp_path)
    with_it, without = (label_file(walking, model(), files=files) for files in ([walking, standing], [walking]))
    assert with_it.standing == standing and without.standing is None
    assert not np.array_equal(with_it.labelling.confidence, without.labelling.confidence)


@pytest.mark.parametrize("name", ["two people, one model", "two people, two models", "long", "names contradicting"])
def test_whatever_was_labelled_can_be_corrected(name: str, place: Path) -> None:
    """What is said of one piece holds, leaves most other labels as they were, and can be taken back."""
    case = CASES[name]
    labelled = label_file(case.write(place)[0], [model()] * case.models, LabellingOptions(in_memory=True, keep_tracklets=True))
    correction = labelled.correction()
    first, pieces = correction.labelling, correction.pieces
    assert first == labelled.labelling
    for marker in {0, len(correction.names) - 1}:
        (place_of_piece, *_) = np.nonzero(pieces.marker == marker)[0]
        chances = correction.candidates(int(pieces.id[place_of_piece]))
        assert [chance for _, chance in chances] == sorted((chance for _, chance in chances), reverse=True)
        assert chances[0][0] == correction.names[marker]
    ghost = int(np.nonzero(pieces.marker == 2)[0][0])
    change = correction.apply(Ghost(int(pieces.id[ghost])))
    assert [part.after for part in change.pieces if part.by_person] == ["ghost"]
    points = np.nonzero(correction.pieces.of_point == ghost)[0]
    frames = correction.clouds.frame_of[points]
    places = points - correction.clouds.offsets[frames]
    assert not (correction.labelling.indices[frames] == places[:, None]).any()
    others = np.arange(len(correction.names)) != 2
    assert (correction.labelling.indices == first.indices)[:, others].mean() > 0.9
    given = correction.labelling.indices
    assert all(len(set(row[row >= 0])) == (row >= 0).sum() for row in given), "no point has two labels"
    correction.undo()
    assert correction.labelling == first


def test_settings_are_handed_to_all_that_label() -> None:
    """What a caller gives holds wherever it is used: for two people, for recordings of another body, and for what a person corrects."""
    clouds, trained = two_people().clouds(), model()
    assert trained.label(clouds).bodies == 2
    never = replace(RecordingLabellingSettings(), bodies=SeveralBodiesRules(min_frame_share=2.0))
    assert RecordingLabeller(trained, LabellingSettings(recording=never)).label(clouds).bodies == 1
    strange = other_set().clouds()
    usual, timid = (
        RecordingLabeller(trained, LabellingSettings(recording=replace(RecordingLabellingSettings(), foreign=rules))).label(strange)
        for rules in (ForeignRules(), ForeignRules(log_odds=-5.0))
    )
    assert usual.confidence.max() > timid.confidence.max()
    labeller = RecordingLabeller(trained, LabellingSettings(recording=never))
    kept = labeller.label_bodies(walk().clouds(), keep_tracklets=True).tracklets
    assert kept is not None and kept.settings is never


def test_files_and_folders_given_for_models_are_named(tmp_path: Path) -> None:
    with pytest.raises(AsterismError, match=r"MarkerModel\.load"):
        label_file(tmp_path / "walk.c3d", [tmp_path / "gait.model"])  # type: ignore[list-item]
    with pytest.raises(AsterismError, match="is a folder"):
        MarkerModel.load(tmp_path)


def test_all_doors_fill_the_same_gaps_alike(tmp_path: Path) -> None:
    trials = simulate_walks(subjects=1, frames=150, markers="helen-hayes", trials=3, seed=3)
    (tmp_path / "person").mkdir()
    model().save(tmp_path / "gait.model")
    files = [tmp_path / "person" / f"walk{number}.c3d" for number in range(3)]
    for number, (file, trial) in enumerate(zip(files, trials, strict=True)):
        positions = trial.positions.copy()
        for marker in ("LKNE", "RTIB", "LTOE"):
            positions[50 + 9 * number : 75 + 9 * number, trial.labels.index(marker)] = np.nan
        unnamed = tuple(f"*{column + 1}" for column in range(positions.shape[1]))
        formats.write(file, replace(trial, positions=positions, labels=unnamed))
    out, page = tmp_path / "out", tmp_path / "page"
    words = ["--model", str(tmp_path / "gait.model")]
    assert main(["process", str(tmp_path / "person"), "-o", str(out), *words, "--fill", "auto"]) in (0, 1)
    labelled = sorted((out / "labelled").rglob("*.c3d"))
    assert len(labelled) == 3
    alone, together = tmp_path / "alone", tmp_path / "together"
    assert main(["convert", str(labelled[0]), str(tmp_path / "converted.c3d"), "--fill", "auto"]) in (0, 1)
    assert main(["gait", str(labelled[0]), "--fill", "auto", "--c3d", str(alone)]) in (0, 1)
    assert main(["gait", *map(str, labelled), "--fill", "auto", "--c3d", str(together)]) in (0, 1)
    sitting = CorrectionSession(files, model(), SessionOptions((tmp_path / "gait.model",), output=page))
    try:
        sitting.start().join()
        opened = sitting.trials[0]
        shown = opened.gaps()
        assert shown.trials == 2, "the page asks the other trials of the sitting"
        spans = tuple(span for span, _ in spans_of(shown))
        with opened.opened() as correction:
            correction.touch(Touch("fill", filled=spans))
        opened.save()
    finally:
        sitting.close()
    [processed] = [path for path in (out / "gait").rglob("*.c3d") if path.name == files[0].name]
    found = [tmp_path / "converted.c3d", processed, alone / files[0].name, together / files[0].name, page / files[0].name]
    fills = [{(label, frame): place for label, frame, place in _filled_places(formats.read(path))} for path in found]
    assert len(fills[0]) >= 50
    for other in fills[1:]:
        assert other.keys() == fills[0].keys()
        np.testing.assert_allclose([other[key] for key in fills[0]], list(fills[0].values()), atol=2e-6)


def _filled_places(recording: Recording) -> Iterator[tuple[str, int, Floats]]:
    """Marker, frame and position of each filled sample."""
    for frame, column in zip(*np.nonzero(np.isfinite(filled_samples(recording))), strict=True):
        yield recording.labels[column], int(frame), recording.positions[frame, column]
