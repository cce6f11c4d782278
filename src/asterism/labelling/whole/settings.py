"""How whole recordings are labelled: all rules of this room, which are handed in once."""

from __future__ import annotations

from dataclasses import dataclass, field

from asterism.labelling.whole.bodies import SeveralBodiesRules
from asterism.labelling.whole.short import ShortTrackletRules


@dataclass(frozen=True)
class TwinRules:
    """How labels are held against their twins. Chosen on virtual people, see docs/labelling.md.

    frames       sampled frames that are compared, at most. Twice as many change no label
    gap          nats by which a twin may be behind in a frame to be completed and refined
    marker_gain  nats that one more marker gains in a frame at best, about
    prior        log odds that the labels found are right against a twin that explains a frame as well. At 0 a fifth of the right labels of
                 people unlike the training is taken back (pig39), at 2 twice as many turned labels of virtual people are given
    scale        nats a frame that multiply these odds by e. Turned labels lead by 13.3 at most on virtual people, which stays below 0.99
    rounds       how often a better twin is held against its own twins
    exchange_scale nats a frame over the best exchange that multiply the odds of a label by e. See docs/labelling.md. At
                 half of it 6 of 100 labels at 0.99 are wrong, at twice half of the right ones are below
    poor_left    points left over beside markers without one, a frame, from which a body may be explained poorly
    poor_gain    nats a label, beyond what nearly every frame of people left out earns, below which it then is. Of `movement`, labels one
                 segment along have -0.1 to 0.8, right ones 0.7 to 2.9, 2.2 in the middle. At half a third of the former is sure, at
                 double a fifth of the latter is not where points are left over
    """

    frames: int = 8
    gap: float = 40.0
    marker_gain: float = 10.0
    prior: float = 1.44
    scale: float = 4.4
    rounds: int = 3
    exchange_scale: float = 1.2
    poor_left: float = 2.0
    poor_gain: float = 1.0


@dataclass(frozen=True)
class ForeignRules:
    """How a foreign recording is labelled again. Chosen on the sets for choosing (docs/recordings.md).

    frames           sampled frames on which labellings are compared, at most
    headings         turns of the mean body about the vertical that are tried
    sizes            its sizes that are tried
    rounds           alternating steps of matching and placing, at most
    reach            how far a point may be from its marker, as a share of the body's root mean square radius: first, and in the last rounds
    max_starts       labellings that are refined, the ones whose distances fit best
    same             share of common labels from which two labellings are the same one
    body_weight      weight of the body model's evidence
    distance_weight  weight of the near-rigid distances
    distance_weight_crowded  the same in a crowded recording in which no labelling has a scatter up to `close`
    close            scatter of the distances, as a share of them, up to which a labelling fits even in a crowd
    prior            nats for the labels so far against others
    prior_crowded    the same in a crowded recording
    forward          nats for a body that travels forward
    min_speed        m/s from which a body travels
    backward         `forward_share` up to which a body seems to walk backwards
    share_std        standard deviation of a near-rigid distance between people, as a share of it, at least
    noise            m, the same beyond that share
    freedom          degrees of freedom of the heavy-tailed distribution about it
    background       density of the log of a distance that is not the marker's
    loose            nats for a distance that is rigid in a training with movement, but not here
    partners         distances of a marker that count as independent, at most
    scale            nats of evidence between two whole labellings that make the odds e to 1
    crowded          points left over, as a share of the markers, from which a recording is crowded
    log_odds         log odds that a label of a foreign recording is right: a logistic regression on clinical-lower and pig39, of each label
    by_margin        log odds per 4 nats of distance margin, by which the label's distances beat those of the best exchange
    margin_range     nats to which the distance margin is clipped
    by_deviation     log odds lost per standard deviation by which a tracklet's distances differ from its marker's elsewhere
    max_deviation    standard deviations up to which nothing is lost
    by_hidden        log odds lost per nat that the label's distances lack to beat the best hidden marker's by `hidden_margin`: a heel
                     looks like the ankle beside it where only one of the two is seen
    hidden_margin    nats by which a hidden marker must be beaten
    hidden_people    people who taught the model from which on hidden markers are no rivals
    by_fit           log odds per 2 nats of the tracklet's fit
    fits             nats to which the fit is clipped
    by_certainty     log odds per 2 log odds that the label has where recordings fit
    by_surplus       log odds lost where e^2 points are left over in a usual frame
    least_confidence labels that this evidence makes less certain are taken back
    least_confidence_crowded  the same where points are left over
    """

    frames: int = 60
    headings: int = 8
    sizes: tuple[float, ...] = (0.85, 1.0, 1.18)
    rounds: int = 10
    reach: tuple[float, float] = (0.8, 0.5)
    max_starts: int = 3
    same: float = 0.7
    body_weight: float = 0.3
    distance_weight: float = 1.5
    distance_weight_crowded: float = 0.5
    close: float = 0.035
    prior: float = 7.0
    prior_crowded: float = 0.0
    forward: float = 12.0
    min_speed: float = 0.4
    backward: float = -0.6
    share_std: float = 0.06
    noise: float = 0.012
    freedom: float = 3.0
    background: float = 0.4
    loose: float = -2.0
    partners: int = 3
    scale: float = 5.0
    crowded: float = 0.25
    log_odds: float = 3.1
    by_margin: float = 2.23
    by_deviation: float = 0.29
    max_deviation: float = 1.5
    margin_range: tuple[float, float] = (-6.0, 12.0)
    by_hidden: float = 1.0
    hidden_margin: float = 2.0
    hidden_people: int = 3
    by_fit: float = 0.73
    fits: tuple[float, float] = (-8.0, 2.0)
    by_certainty: float = 0.61
    by_surplus: float = 2.35
    least_confidence: float = 0.9
    least_confidence_crowded: float = 0.95


@dataclass(frozen=True)
class RelabelRules:
    """How much of a recording is looked at again. So chosen that a minute of 15 markers takes 0.2 s; medians over so few frames serve.

    rounds          how often labels are chosen anew at most; what a touch sets off ends after two
    chance_frames   frames of a piece by which the chances of other markers are told, at most
    penalty_frames  sampled frames by which labels that changed are compared with the body's distances and places, at most
    """

    rounds: int = 3
    chance_frames: int = 20
    penalty_frames: int = 120


@dataclass(frozen=True)
class RecordingLabellingSettings:
    """How a recording is labelled as a whole. All were chosen on the gait subjects, each left out in turn (docs/recordings.md).

    frame_interval    s between the frames that are sampled: scored, and labelled singly
    least_voting      sampled frames at least that are labelled singly, and one more for each tracklet that none of them shows. With 60 no
                      label of children with ghosts changes, and time doubles; with 12 one label of a thousand changes, either way
    voting_interval   one in so many sampled frames is labelled singly, where these are more. Not tuned
    crowded           points of long tracklets for each marker, on average, above which single frames are searched briefly
    max_rounds        relabellings after which the labels are taken as they are
    min_score         nats, the most that one frame can say against a label (negative)
    max_score         nats, the most that one frame can say for a label
    frame_correlation correlation of two frames of one tracklet: many frames are worth 1 / frame_correlation independent ones at most
    long_track        s; a longer tracklet is no ghost, unless the recording shows long ghosts
    ghosts_cost       nats for the explanation that a recording shows ghosts, and as many again for long ghosts
    max_vote          nats, the most that the labelling of a single frame can vote for a label
    adapt_margin      nats; the model is adapted to the subject by tracklets whose labels have at least this margin
    no_adapt_margin   nats; where all labels have more, the model is not adapted, as nothing could change
    max_rigid_std     m; two markers are near-rigid where their distance varies by less in this recording
    min_rigid_std     m; the standard deviation of such a distance is taken as at least this
    pose_spread       and as at least this share of its range over the key poses of the training. Chosen on six gait subjects in clutter
    max_rigid_deviation standard deviations by which a tracklet's near-rigid distances and place may differ without a loss of margin.
                        Chosen of 0.9 to 1.2 on six gait subjects with riding ghosts: the largest without avoidable wrong labels
    deviation_cost    nats of margin lost for each square of what exceeds that
    training_noise    m, standard deviation of a near-rigid distance between bodies of one size, beyond the range of the training
    max_deviation_familiar standard deviations by which a tracklet's near-rigid distances may differ from the training's
    max_deviation_unfamiliar the same where most frames of the tracklet fit worse than those of people left out did
    adapt_rounds      how often the model is adapted to the subject's own body; 0 for never
    turn_cost         nats that a sampled frame must gain to be turned upright (`upright.py`). Chosen on acrobatics (cmu41, 85)
    min_turned_share  share of the markers that must be labelled there. Not tuned
    split_gain        nats by which two markers must explain a tracklet better than one, before and after a frame, to cut it there
    max_splits        how often tracklets are cut and labelled again
    short             which tracklets are short, and how their points are labelled
    bodies            when a recording shows two bodies of one model
    twins             how labels are held against those of a body turned round
    foreign           how a recording that does not fit its model is labelled again
    relabel           how much of a recording is looked at again when a person corrects it
    """

    frame_interval: float = 0.1
    least_voting: int = 20
    voting_interval: int = 10
    crowded: float = 1.5
    max_rounds: int = 4
    min_score: float = -4.0
    max_score: float = 15.0
    frame_correlation: float = 0.3
    long_track: float = 0.9
    ghosts_cost: float = 30.0
    max_vote: float = 10.0
    adapt_margin: float = 6.0
    no_adapt_margin: float = 15.0
    max_rigid_std: float = 0.02
    min_rigid_std: float = 0.004
    pose_spread: float = 0.3
    max_rigid_deviation: float = 1.0
    deviation_cost: float = 12.0
    training_noise: float = 0.01
    max_deviation_familiar: float = 5.0
    max_deviation_unfamiliar: float = 2.5
    adapt_rounds: int = 2
    turn_cost: float = 10.0
    min_turned_share: float = 0.3
    split_gain: float = 40.0
    max_splits: int = 2
    short: ShortTrackletRules = field(default_factory=ShortTrackletRules)
    bodies: SeveralBodiesRules = field(default_factory=SeveralBodiesRules)
    twins: TwinRules = field(default_factory=TwinRules)
    foreign: ForeignRules = field(default_factory=ForeignRules)
    relabel: RelabelRules = field(default_factory=RelabelRules)
