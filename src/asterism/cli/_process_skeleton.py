"""The labelled trials of one person in; the skeleton over time of each walk as BVH, and a table of all joints and bones, out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity


def person_skeleton(
    walks: Mapping[Path, Path], standing: Path | None, table: Path, vertical: str | None
) -> tuple[list[Path], list[Finding], Callable[[], None]]:
    """What is written, what was found, and what writes it.

    walks: the labelled recordings, each with its BVH file. A person whose markers tell no skeleton is a finding, and nothing is written.
    """
    from asterism import formats
    from asterism.formats.bvh import write_bvh
    from asterism.skeleton import fit_person, solve_kinematics
    from asterism.skeleton.outputs import kinematics_findings, kinematics_table

    try:
        moving = {path: formats.read(path, vertical=vertical) for path in walks}
        still = [] if standing is None else [formats.read(standing, vertical=vertical)]
        person = fit_person(still, list(moving.values()))
        found = {path: solve_kinematics(person.tree, recording) for path, recording in moving.items()}
    except AsterismError as problem:
        mend = "Nothing, where the markers are of no whole legs; its other results are written."
        return [], [Finding("session-no-skeleton", Severity.NOTE, str(table), f"{table.stem}: {problem}", mend)], lambda: None
    findings = [*person.findings, *(one for path, movement in found.items() for one in kinematics_findings(movement, moving[path]))]
    targets: Sequence[Path] = [table, *walks.values()]

    def write() -> None:
        for target in targets:
            target.parent.mkdir(parents=True, exist_ok=True)
        kinematics_table([(str(path), movement, moving[path]) for path, movement in found.items()]).write(table)
        for path, movement in found.items():
            write_bvh(walks[path], movement.motion())

    return list(targets), findings, write
