"""Numbers that pages give for constants of the code are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from asterism.garment.read.rules import ReadRules
from asterism.labelling.body.anchors import AnchorRules
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyRules
from asterism.labelling.live.body import LiveRules
from asterism.labelling.live.stream import StreamRules
from asterism.labelling.live.study import StudyRules
from asterism.labelling.live.study_process import _FREE, _REST
from asterism.labelling.stretches import StretchRules
from asterism.labelling.whole.assignment import EXACT_CHOICES
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.short import ShortTrackletRules
from asterism.labelling.whole.verdict import VerdictRules
from asterism.live.frames import MOST_POINTS
from asterism.live.osc import _LARGEST as LARGEST_BUNDLE
from asterism.live.outputs import WAITING
from asterism.live.websocket import _LARGEST as LARGEST_MESSAGE
from asterism.live.websocket import _MOST_RECEIVERS
from asterism.motion.clinical import SkinMotion
from asterism.motion.segmentation import SegmentationRules
from asterism.views.personal import PERSONAL
from asterism.views.rules import QUICK, RULES

DOCS = Path(__file__).parent.parent / "docs"
WORDS = {
    "two": 2,
    "three": 3,
    "four": 4,
    "five": 5,
    "six": 6,
    "eight": 8,
    "eleven": 11,
    "tenth": 10,
    "half": 0.5,
    "one and a half": 1.5,
    "quarter": 0.25,
    "twice": 2,
    "two million": 2e6,
}
WHOLE, VERDICT, SHORT, STREAM = RecordingLabellingSettings(), VerdictRules(), ShortTrackletRules(), StreamRules()
BODY, FRAME, ANCHORS = BodyRules(), FrameLabellingSettings(), AnchorRules()
FOREIGN, READ, SEGMENTS = WHOLE.foreign, ReadRules(), SegmentationRules()

NUMBERS = [
    ("labelling", r"a mixture of at most (\w+) \*key poses\*", BODY.poses),
    ("labelling", r"a pose needs (\d+) frames", BODY.frames_per_pose),
    ("labelling", r"are the (\d+) main directions", BODY.latents),
    ("labelling", r"sizes vary by another (\d+) %", 100 * BODY.size_std),
    ("labelling", r"and every marker by another (\d+) mm", 1000 * BODY.placement_std),
    ("labelling", r"varies by another (\d+) mm / people", 1000 * BODY.few_std),
    ("labelling", r"`reward` \((\d)\) is how much rarer", FRAME.reward),
    ("labelling", r"The first ghost of a frame costs (\d+), since", FRAME.first_ghost_cost),
    ("labelling", r"A point within ([\d.]+) m of its marker's expected place", FRAME.outlier_radius),
    ("labelling", r"at least `outlier_score` \((-\d)\)", FRAME.outlier_score),
    ("labelling", r"Each end of an interval is moved outward by ([\d.]+) standard", ANCHORS.widen),
    ("labelling", r"Up to (\d+) anchors are chosen", ANCHORS.count),
    ("labelling", r"occlusion patterns \(up to (\d+) % hidden\)", 100 * ANCHORS.max_hidden),
    ("labelling", r"squared distance of at most (\d+) from a key pose", FRAME.max_anchor_distance2),
    ("labelling", r"and for the point, by (\d) in log odds over", FRAME.assign_margin),
    ("labelling", r"something is left over, (\w+) otherwise", FRAME.max_votes_needed),
    ("labelling", r"up to (\w+) anchors on missing markers", FRAME.extra_anchors),
    ("labelling", r"where the estimate comes within (\d+) of it", FRAME.exact_margin),
    ("labelling", r"log odds ([\d.]+) \+ margin", WHOLE.twins.prior),
    ("labelling", r"log odds 1.44 \+ margin / ([\d.]+),", WHOLE.twins.scale),
    ("labelling", r"nu = `tail_freedom` = (\d)", FRAME.tail_freedom),
    ("labelling", r"by the log odds margin / ([\d.]+) over the best one", WHOLE.twins.exchange_scale),
    ("labelling", r"with its twins in (\w+) of its sampled frames", WHOLE.twins.frames),
    ("labelling", r"The search stops at (200 000) feature evaluations", FRAME.max_evaluations),
    ("recordings", r"Every ([\d.]+) s, and at least once in every tracklet", WHOLE.frame_interval),
    ("recordings", r"Of these every (\w+), but at least", WHOLE.voting_interval),
    ("recordings", r"but at least (\d+), and one more for each", WHOLE.least_voting),
    ("recordings", r"by its margin, (\d+) at most", WHOLE.max_vote),
    ("recordings", r"One frame contributes (-\d+) to", WHOLE.min_score),
    ("recordings", r"One frame contributes -4 to (\d+)", WHOLE.max_score),
    ("recordings", r"scores that are correlated by ([\d.]+),", WHOLE.frame_correlation),
    ("recordings", r"more than ([\d,]+) choices are in conflict", EXACT_CHOICES),
    ("recordings", r"until nothing changes, (\w+) times at most", WHOLE.max_rounds),
    ("recordings", r"A tracklet of (\d) frames, or of", SHORT.frames),
    ("recordings", r"frames, or of ([\d.]+) s, is short", SHORT.seconds),
    ("recordings", r"show more than ([\d.]+) points for each marker", SHORT.crowded),
    ("recordings", r"are short, too, up to ([\d.]+) s", SHORT.crowd_seconds),
    ("recordings", r"if at least ([\d.]+) points for each marker are left", SHORT.min_shown),
    ("recordings", r"better than one, by an evidence of (\d+)", WHOLE.split_gain),
    ("recordings", r"and cuts again, (\w+) at most", WHOLE.max_splits),
    ("recordings", r"those longer than ([\d.]+) s are", WHOLE.long_track),
    ("recordings", r"The second costs an evidence of (\d+)", WHOLE.ghosts_cost),
    ("recordings", r"if it gains an evidence of (\d+) at least", WHOLE.turn_cost),
    ("recordings", r"labels have a margin of at least (\d+) adapt", WHOLE.adapt_margin),
    ("recordings", r"This is done (\w+), and not at all", WHOLE.adapt_rounds),
    ("recordings", r"mean square of the two exceeds ([\d.]+), each", WHOLE.max_rigid_deviation),
    ("recordings", r"square of the excess costs (\d+) of margin", WHOLE.deviation_cost),
    ("recordings", r"off by more than (\d) standard deviations", WHOLE.max_deviation_familiar),
    ("recordings", r"only labels within ([\d.]+) are kept", WHOLE.max_deviation_unfamiliar),
    ("recordings", r"A recording fits up to ([\d.]+)\.", VERDICT.min_limit),
    ("recordings", r"it fits up to ([\d.]+) times the largest scatter", VERDICT.left_out_factor),
    ("recordings", r"between 0.06 and ([\d.]+)\. Where fewer", VERDICT.max_limit),
    ("recordings", r"it fits up to ([\d.]+), since among", VERDICT.crowded_limit),
    ("recordings", r"or fewer than ([\d.]+) of the markers are found", VERDICT.min_labelled),
    ("recordings", r"\*another body\* from a scatter of ([\d.]+),", VERDICT.body_scatter),
    ("recordings", r"where sizes differ by a factor of ([\d.]+),", VERDICT.body_size),
    ("recordings", r"limited from half that scatter on, down to ([\d.]+)\. Of", VERDICT.standing_confidence),
    ("recordings", r"Where (\d+) people or more taught the model, virtual", VERDICT.many_people),
    ("recordings", r"each counted as (\d) at most", VERDICT.most_deviation),
    ("recordings", r"a recording fits up to ([\d.]+) of them", VERDICT.many_limit),
    ("recordings", r"unless the scatter is at most ([\d.]+): that is", VERDICT.own_scatter),
    ("recordings", r"with most points, at (\w+) headings", FOREIGN.headings),
    ("recordings", r"headings and (\w+) sizes", len(FOREIGN.sizes)),
    ("recordings", r"The (\w+) whose distances fit best are labelled", FOREIGN.max_starts),
    ("recordings", r"as above, on (\d+) of the sampled frames", FOREIGN.frames),
    ("recordings", r"([\d.]+) x evidence of the labels", FOREIGN.body_weight),
    ("recordings", r"([\d.]+) x evidence of the near-rigid distances", FOREIGN.distance_weight),
    ("recordings", r"(\d+) x cosine between the direction", FOREIGN.forward),
    ("recordings", r"comes as near as a scatter of ([\d.]+)\. The first", FOREIGN.close),
    ("recordings", r"The first labelling has (\d) more", FOREIGN.prior),
    ("recordings", r"A margin of (\d) over a whole other labelling", FOREIGN.scale),
    ("recordings", r"evidence makes less certain than ([\d.]+) are withdrawn", FOREIGN.least_confidence),
    ("recordings", r"are withdrawn, than ([\d.]+) where points are left over", FOREIGN.least_confidence_crowded),
    ("recordings", r"recordings of more than (two million) points", StretchRules().whole),
    ("recordings", r"Neighbouring stretches share (\d+) s", StretchRules().overlap),
    ("recordings", r"Every track collects evidence that decays over (\w+) a second", STREAM.evidence_memory),
    ("recordings", r"does not use the past runs every (\w+) second", STREAM.search_interval),
    ("recordings", r"Its result must be better by (\d),", STREAM.takeover_margin),
    ("recordings", r"is worth at most \(m - 3\) / ([\d.]+) in log odds", STREAM.log_odds_scale),
    ("recordings", r"\(after 3, 6, 12 and (\d+) of them", LiveRules().adapt_after[-1]),
    ("motion", r"span a local subspace of (\w+) dimensions", SEGMENTS.dimension),
    ("motion", r"Affinities are computed to (\d+) landmarks", SEGMENTS.landmarks),
    ("live", r"A \*study\* labels the last (\w+) seconds", StudyRules().window),
    ("live", r"when there are a (\w+) more frames", StudyRules().growth - 1),
    ("live", r"after a rest of (\w+) times", _REST),
    ("live", r"They need (one and a half) processor cores", _FREE),
    ("live-outputs", r"to all who connect, at most (\d+)", _MOST_RECEIVERS),
    ("live-outputs", r"gets the newest (\d+) frames", WAITING),
    ("live-outputs", r"If it has more than ([\d,]+) bytes", LARGEST_BUNDLE),
    ("live-sources", r"`points` \| at most ([\d,]+);", MOST_POINTS),
    ("live-sources", r"holds the same as a datagram, at most ([\d,]+) bytes", LARGEST_MESSAGE),
    ("motion", r"(\w+) clusters are merged to limbs", SEGMENTS.clusters),
    ("motion", r"stray less than (\d+) mm \(median\)", 1000 * SEGMENTS.same_limb_m),
    ("motion", r"\((\d) mm at 60 degrees on the thigh", 1000 * SkinMotion().thigh_m),
    ("garment", r"where at least (\d+) of its colours fit", READ.patch),
    ("garment", r"rows and columns go on, within ([\d.]+) pitches", READ.gate),
    ("garment", r"of the neighbours costs (\d) for each factor of e", READ.unlike),
    ("garment", r"A circle needs ([\d.]+), an area", READ.odds),
    ("garment", r"no way that has it ([\d.]+) pitches off", READ.astray),
    ("garment", r"One of ([\d,]+) is less than 2 in 100,000", READ.validated_count),
    ("views", r"(\w+) headings and the poses of the model are tried", RULES.headings),
    ("views", r"Every (\d+) frames the followed body is compared", RULES.turn_frames),
    ("views", r"over the other one in (\w+) frames", 2 * RULES.window + 1),
    ("views", r"body found without a start every (\d+) frames", QUICK.turn_frames),
    ("views", r"Before the recording is labelled, (\d+) frames of it are fitted", PERSONAL.frames),
    ("views", r"where the model has it is sought within (\d) cm", 100 * PERSONAL.astray),
    ("views", r"above 0\. By default it is (-[\d.]+) m", RULES.occlusion_tolerance),
]


@pytest.mark.parametrize(("page", "pattern", "value"), NUMBERS, ids=[f"{page}: {pattern}" for page, pattern, _ in NUMBERS])
def test_a_number_of_a_page_is_that_of_the_code(page: str, pattern: str, value: float) -> None:
    text = " ".join((DOCS / f"{page}.md").read_text(encoding="utf-8").split())
    said = re.findall(pattern, text)
    assert len(said) == 1, f"{page}.md says it {len(said)} times"
    number = WORDS[said[0].lower()] if said[0].lower() in WORDS else float(said[0].replace(",", "").replace(" ", ""))
    assert number == pytest.approx(value), f"{page}.md says {said[0]}"
