"""The kernels that decide which point is which marker, or which blobs make a point, and the test that checks each decision.

A check is either a plain twin that the kernel must equal, or, where the decision has no simpler form, all small cases by exhaustion.
`test_deciding_kernels.py` holds this table together with the kernels and the tests; `python -m benchmarks house --rows kernels` counts
those that have no check.
"""

from __future__ import annotations

_BODY = "asterism.labelling.body"
_PARTIAL = "asterism.labelling.partial"
_POINTS = "asterism.reconstruction"

CHECKED_BY: dict[str, str] = {
    f"{_BODY}._refine_kernels.refine": "",
    f"{_BODY}._search_kernels.propose": "",
    f"{_BODY}._search_kernels.find_labellings": "",
    f"{_BODY}._frame_kernels.nearest_changes": "",
    f"{_BODY}._frame_kernels.retry_doubtful": "",
    f"{_BODY}._score_kernels.rescore": "",
    f"{_BODY}._frame_kernels.label_frame": "",
    f"{_PARTIAL}._matrix_kernels.check_marker": "",
    f"{_PARTIAL}._matrix_kernels.complete_labels": "",
    f"{_PARTIAL}._matrix_kernels.count_confusions": "",
    f"{_PARTIAL}._build_kernels.order_tests": "",
    f"{_PARTIAL}._search_kernels.label_by_full_solver": "",
    f"{_POINTS}._shared_kernels.add_without_shared": "",
    f"{_POINTS}._frame_kernels.attach_available": "",
    f"{_POINTS}._frame_kernels.count_visibility": "",
    f"{_POINTS}._plain_kernels.reconstruct_frame_plain": "",
    f"{_POINTS}._plain_kernels.merge_versions": "",
    f"{_POINTS}._score_kernels.score": "",
    f"{_POINTS}._compose_kernels.compose": "",
    "asterism.calibration.wand._kernels.locate_wand": "",
}
"""Kernel -> "test_file.py::test_name" of the check; empty where there is none yet."""
