"""What the events of feet are called, and the numbers by which they are told while they happen."""

from __future__ import annotations

from dataclasses import dataclass

from asterism.gait.events import OFF, STRIKE

KINDS = {STRIKE: "heel strike", OFF: "toe off"}
"""As live events call those of recordings."""


@dataclass(frozen=True)
class LiveEventRules:
    """How events are told while they happen.

    Chosen on 17 walks and runs of `movement` and 40 of simulated people, whole and with markers hidden, exchanged or wrong. Where nothing
    is said, half and double change no count of what is missed or told for nothing by more than one of 200, and no delay by 5 ms.

    noise        m, of a marker's place; jerk  m2/s5, how fast accelerations of a foot change: filters follow 15 Hz
    jump         m, by which a point may be elsewhere than expected, beside three standard deviations, or its marker is another one's
    jumped       s of such, after which the point is where it is seen now; at double, feet that come back are told 0.1 s late
    rough        s over which misses tell how far points are off, and times: a stream whose times jitter is as much less certain
    lost         m, standard deviation of a point's place above which it tells nothing
    prior, steps  steps as which the recording's rules count in what lies between a turning and its event, and last ones of the person
                 beside them; and in how certain that is, with twice their standard deviation
    fall, least_fall  of the usual swing, and m, that a heel goes back (a toe forward) after it turned, until it counts as told. This is the
                 trade of delay against false alarms: at half, strikes of slow steps are told 10 ms sooner, at double of `fall` one in
                 hundred 170 ms later; false ones are as many
    off_soon     s, within which a toe turns, as its speed and acceleration foretell by `sure` standard deviations, when it has left the
                 floor. At half of `sure` offs are told 8 ms sooner and 4 % for nothing, at double 20 ms later
    behind       s of curves before and after an event that the recording's rules look at: a swing, and what their filters need. They judge
                 the last steps as often
    pause        s without a frame after which all but what was learned begins anew, twice a swing's turning; for so long at most left and
                 right foot are given back each other's places, where each is where the other one goes; and over so long a foot stands of
                 which heel or toe is where it was
    floats       m/s up or down below which an end of a foot rests on the floor, be it a stair; at half, stairs hold strikes back, at double
                 who marches slowly strikes at the top
    seen         frames of a marker, after which it counts as worn
    climbs       m/s by which the floor is believed to rise where no foot comes down to it
    upright      cosine of the angle from feet to pelvis against the vertical, over a second, below which nobody walks: 60 degrees
    backwards, backwards_in  of the leg that the pelvis goes back, and in how many s, when the person walks backwards
    lower        m, by which feet are lower between off and strike than between strike and off, where a person walks backwards on a
                 treadmill; at half, one in ten steps of people who drag their feet is lost
    """

    noise: float = 0.001
    jerk: float = 2000.0
    jump: float = 0.05
    jumped: float = 0.15
    rough: float = 1.0
    lost: float = 0.02
    prior: float = 1.0
    steps: int = 6
    fall: float = 0.04
    least_fall: float = 0.005
    off_soon: float = 0.03
    sure: float = 2.0
    behind: tuple[float, float] = (1.0, 0.4)
    pause: float = 0.3
    floats: float = 0.2
    seen: int = 3
    climbs: float = 0.01
    upright: float = 0.5
    backwards: float = 0.4
    backwards_in: float = 1.5
    lower: float = 0.01
