"""Labels in images against a trained model of point clouds: agreement changes nothing, another name costs confidence."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import models
import numpy as np
import pytest

import asterism
from asterism.cameras.files import write_rig
from asterism.cli import main
from asterism.formats import write_blobs
from asterism.recording import MarkerSet
from asterism.simulation import simulate_standing, simulate_walks
from asterism.simulation.views_laboratory import ViewsSession, simulate_views
from asterism.skeleton import ArticulatedBody, fit_body, save_body
from asterism.views import ViewsLabelling, label_views
from asterism.views.agreement import check_by_model
from asterism.views.rules import QUICK


@cache
def model() -> asterism.MarkerModel:
    return models.trained(simulate_walks(3, 80, seed=5), training=models.BRIEF)


@cache
def body() -> ArticulatedBody:
    standing, walking = simulate_standing(3, 10, seed=5), simulate_walks(3, 60, seed=5)
    people = [str(trial.metadata["subject"]) for trial in (*standing, *walking)]
    return fit_body(standing, walking, markers=MarkerSet.load("helen-hayes"), people=people, title="three walkers")


@cache
def walk() -> ViewsSession:
    return simulate_views(simulate_walks(1, 60, seed=33)[0], body().labels, rng=np.random.default_rng(3))


def renamed(given: ArticulatedBody) -> ArticulatedBody:
    """The body with the names of its sides exchanged, and its marker places too: nothing in it is mirrored, its names are wrong."""
    swapped = {"L": "R", "R": "L"}
    by_name = {marker.name: marker for marker in given.markers}
    twin = {name: (swapped[name[0]] + name[1:]) if swapped.get(name[0], "") + name[1:] in by_name else name for name in by_name}
    return replace(given, markers=tuple(replace(marker, name=twin[marker.name]) for marker in given.markers), aliases={})


def with_names_of_the_other_side(result: ViewsLabelling) -> ViewsLabelling:
    """What a wrong body would have given with the same blobs: all labels and places under the names of the other side."""
    names = list(result.body.labels)
    wrong = renamed(result.body)
    order = np.array([wrong.labels.index(name) for name in names])
    labels = np.where(result.labels >= 0, order[result.labels], -1)
    back = np.argsort(order)
    return replace(
        result, labels=labels, views=result.views[:, back], positions=result.positions[:, back], covariances=result.covariances[:, back]
    )


@cache
def labelled() -> ViewsLabelling:
    given = walk()
    return label_views(given.blobs, given.rig, body(), rules=QUICK)


def test_where_the_model_agrees_nothing_changes() -> None:
    checked = check_by_model(labelled(), model())
    assert (checked.labels >= 0).sum() > 0.97 * (labelled().labels >= 0).sum()
    assert (checked.confidence <= labelled().confidence).all()
    assert "views-model-disagrees" not in [finding.code for finding in checked.findings]


def test_labels_of_a_wrong_body_lose_their_confidence() -> None:
    wrong = with_names_of_the_other_side(labelled())
    sided = np.isin(wrong.labels, [m for m, name in enumerate(body().labels) if name != "SACR"])
    assert (wrong.confidence[sided] > 0.9).all() and sided.sum() > 500
    checked = check_by_model(wrong, model())
    several = wrong.views[wrong.blobs.frame_of[sided], wrong.labels[sided]] >= 2
    assert (checked.labels[sided][several] >= 0).mean() < 0.2, "wrong names of points of several cameras must not be given"
    assert np.median(checked.confidence[sided][several]) < 0.6
    assert "views-model-disagrees" in [finding.code for finding in checked.findings]
    gone = checked.views == 0
    assert np.isnan(checked.positions[gone]).all() and np.isnan(checked.covariances[gone]).all()
    assert (checked.views <= wrong.views).all()


def test_points_of_one_camera_and_unknown_markers_are_not_judged() -> None:
    single = replace(labelled(), views=np.minimum(labelled().views, 1))
    assert check_by_model(single, model()) is single


def test_the_command_checks_by_a_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = walk()
    write_blobs(given.blobs.frames(slice(0, 12)), tmp_path / "2d.csv")
    write_rig(given.rig, tmp_path / "rig.toml")
    save_body(body(), tmp_path / "body.toml")
    model().save(tmp_path / "walks.model")
    words = ["label-views", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "rig.toml"), "--body", str(tmp_path / "body.toml"), "--quick"]
    assert main([*words, "--model", str(tmp_path / "walks.model"), "-o", str(tmp_path / "out.c3d")]) == 0
    assert "blobs labelled" in capsys.readouterr().out
    assert main([*words, "--model", str(tmp_path / "none.model"), "-o", str(tmp_path / "other.c3d")]) == 2
