"""The kernels that decide which point is which marker, or which blobs make a point, and the test that checks each decision.

A check is either a plain twin that the kernel must equal, or, where the decision has no simpler form, all small cases by exhaustion.
`test_deciding_kernels.py` holds this table together with the kernels and the tests.
"""

from __future__ import annotations

_BODY = "asterism.labelling.body"
_WHOLE = "asterism.labelling.whole"
_PARTIAL = "asterism.labelling.partial"
_POINTS = "asterism.reconstruction"
_TWINS = "test_reconstruction_twins.py"
_PLAIN = f"{_TWINS}::test_the_plain_method_gives_every_pair_of_rays_that_meets via reconstruct"

CHECKED_BY: dict[str, str] = {
    f"{_BODY}._refine_kernels.refine": "test_body_search.py::test_refinement",
    f"{_BODY}._anchor_kernels.search_anchor": "test_body_search.py::test_an_anchor_keeps_the_likeliest_triples_of_its_partial_solver",
    f"{_BODY}._search_kernels.propose": "test_body_search.py::test_proposals_of_an_anchor",
    f"{_BODY}._search_kernels.find_labellings": "test_body_search.py::test_the_labellings_that_anchors_lead_to",
    f"{_BODY}._search_kernels.add_twins": "test_body_search.py::test_the_labellings_that_anchors_lead_to",
    f"{_BODY}._frame_kernels.nearest_changes": "test_body_search.py::test_the_nearest_changes",
    f"{_BODY}._frame_kernels.retry_doubtful": "test_body_search.py::test_doubtful_labels_are_tried_again",
    f"{_BODY}._score_kernels.rescore": "test_body_search.py::test_rescoring_finds_the_outliers",
    f"{_BODY}._frame_kernels.label_frame": "test_body_search.py::test_a_whole_frame via label_clouds",
    f"{_WHOLE}._kernels.settle_dominant": "test_track_kernels.py::test_what_dominates_is_in_the_best_of_all_labellings",
    f"{_WHOLE}._kernels.best_split": "test_track_kernels.py::test_where_a_tracklet_goes_over_to_another_marker",
    f"{_WHOLE}._twin_kernels.score_twins": "test_track_kernels.py::test_twins_of_labelled_frames",
    f"{_WHOLE}._twin_kernels.score_exchanges": "test_track_kernels.py::test_what_scores_say_of_exchanges",
    f"{_WHOLE}._short_kernels.label_short": "test_track_kernels.py::test_points_of_short_tracklets",
    f"{_WHOLE}._short_kernels.take_best_pairs": "test_track_kernels.py::test_the_best_pairs_of_a_frame",
    f"{_PARTIAL}._matrix_kernels.check_marker": "test_partial_twins.py::test_check_marker_on_all_placements_of_four_markers",
    f"{_PARTIAL}._matrix_kernels.complete_labels": "test_partial_twins.py::test_complete_labels",
    f"{_PARTIAL}._matrix_kernels.count_confusions": "test_partial_twins.py::test_count_confusions",
    f"{_PARTIAL}._build_kernels.order_tests": "test_partial_twins.py::test_order_tests",
    f"{_PARTIAL}._full_solver_kernels.label_by_full_solver": "test_partial_twins.py::test_label_by_full_solver",
    f"{_POINTS}._shared_kernels.add_without_shared": f"{_TWINS}::test_hypotheses_without_shared_blobs_are_those_of_the_twin",
    f"{_POINTS}._frame_kernels.attach_available": f"{_TWINS}::test_available_blobs_are_attached_as_by_the_twin",
    f"{_POINTS}._frame_kernels.count_visibility": f"{_TWINS}::test_visibility_is_counted_as_by_the_rigs_own_projection",
    f"{_POINTS}._plain_kernels.reconstruct_frame_plain": _PLAIN,
    f"{_POINTS}._plain_kernels.merge_versions": f"{_TWINS}::test_versions_are_merged_by_the_sensitivity_as_by_the_twin",
    f"{_POINTS}._score_kernels.score": f"{_TWINS}::test_the_score_is_that_of_the_twin",
    f"{_POINTS}._compose_kernels.compose": f"{_TWINS}::test_composition_finds_what_trying_all_pairs_of_blobs_finds",
    "asterism.calibration.wand._kernels.locate_wand": "test_wand.py::test_what_cameras_agree_on_equals_the_plain_search_in_all_frames",
}
"""Kernel -> "test_file.py::test_name" of the check; " via function" where the test calls the kernel through another function; empty where
there is none yet."""
