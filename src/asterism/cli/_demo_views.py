"""`asterism demo views`: a simulated walker before four small cameras, labelled in the images, beside the truth."""

from __future__ import annotations

from pathlib import Path

from asterism.cli import _console

_LEAST_RIGHT, _MOST_WRONG = 0.99, 0.005
"""Shares of the blobs that show one marker, which the demo promises."""


def demo_views(output: Path, seed: int, json: str | None) -> int:
    """Simulate, label, compare; leave 2d.csv, rig.toml, body.toml, labelled.c3d and views.html. Returns the exit status."""
    import numpy as np

    from asterism import formats
    from asterism.cameras.files import write_rig
    from asterism.formats import write_blobs
    from asterism.recording import MarkerSet
    from asterism.report.views import views_report
    from asterism.simulation import simulate_standing, simulate_walks
    from asterism.simulation.views_laboratory import simulate_views
    from asterism.skeleton import fit_body, save_body
    from asterism.views import label_views

    _console.check_new(json, overwrite=True)
    output.mkdir(parents=True, exist_ok=True)
    show = _console.result if json != "-" else _console.error
    show("Fitting a body to four simulated people ...")
    standing, walking = simulate_standing(4, 30, seed=seed), simulate_walks(4, 120, seed=seed)
    # standing and walking trials of one person belong together
    people = [str(trial.metadata["subject"]) for trial in (*standing, *walking)]
    body = fit_body(standing, walking, markers=MarkerSet.load("helen-hayes"), people=people, title="four simulated people")
    session = simulate_views(simulate_walks(2, 240, seed=seed + 1)[1], body.labels, rng=np.random.default_rng(seed))
    show(f"Labelling what four cameras of 656 x 491 px see of another one, {len(session.blobs)} frames ...")
    result = label_views(session.blobs, session.rig, body)
    write_blobs(session.blobs, output / "2d.csv")
    write_rig(session.rig, output / "rig.toml")
    save_body(body, output / "body.toml")
    formats.write(output / "labelled.c3d", result.recording())
    views_report(output / "views.html", result, title="Asterism demo: labels in the images of four cameras")
    identity, labels = session.identity, result.labels
    # blobs of two markers at once, and false ones, have no right name
    marker = identity >= 0
    right = float((labels[marker] == identity[marker]).mean())
    wrong = float(((labels >= 0) & (labels != identity) & (identity != -2)).sum() / marker.sum())
    away = np.linalg.norm(result.positions - session.recording.positions, axis=2)
    # apart, as one camera and the body tell a place less exactly than two cameras
    one, more = away[result.views == 1], away[result.views >= 2]
    good = right >= _LEAST_RIGHT and wrong <= _MOST_WRONG
    if json != "-":
        _console.table(
            "Blobs that show one marker",
            ["", "measured", "promised"],
            [
                ["labelled right", _console.percent(right), f">= {_console.percent(_LEAST_RIGHT)}"],
                ["labelled wrong", _console.percent(wrong), f"<= {_console.percent(_MOST_WRONG)}"],
                ["places by two or more cameras, median error", f"{1e3 * np.median(more):.1f} mm", ""],
                ["places by one camera and the body, median error", f"{1e3 * np.median(one):.1f} mm" if len(one) else "none", ""],
            ],
        )
    show(f"Open {output / 'views.html'} in a browser. Label the blobs yourself:")
    show(f"  asterism label-views {output / '2d.csv'} --rig {output / 'rig.toml'} --body {output / 'body.toml'} -o {output / 'again.c3d'}")
    content = {"command": "demo views", "seed": seed, "right": right, "wrong": wrong, "reached": good, "report": output / "views.html"}
    _console.write_json(json, content)
    return 0 if good else 1
