"""The names of bones in; which bone of a body each is, out: as animation programs, motion libraries and OpenSim name them.

Parts are named as the segments of `asterism.recording.Place` are, with a side before those of limbs: "pelvis", "left thigh".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

LIMB_PARTS = ("thigh", "shank", "foot", "toe", "clavicle", "upper arm", "forearm", "hand")
FINGERS = ("thumb", "index", "middle", "ring", "little")

_WORDS: Mapping[str, str] = {
    "pelvis": "pelvis hips",
    "head": "head skull",
    "neck": "neck lowerneck upperneck necklower neckupper neckbase",
    "spine": "spine chest torso thorax lowerback upperback upperchest abdomen abdomenlower abdomenupper chestlower chestupper lumbar "
    "spinelower spineupper spinemid spinemiddle body trunk back waist ribcage",
    "thigh": "thigh upleg upperleg femur thighbend legupper thighstretch",
    "shank": "shank shin calf tibia lowerleg leglower lowleg crus shinbend legstretch knee",
    "foot": "foot ankle talus",
    "toe": "toe toes toebase ball football forefoot",
    "clavicle": "clavicle collar collarbone scapula innershoulder",
    "upper arm": "upperarm humerus shldrbend shldr uparm armupper armstretch upperarmbend",
    "forearm": "forearm lowerarm radius ulna armlower lowarm forearmbend forearmstretch elbow",
    "hand": "hand wrist palm",
    "thumb": "thumb handthumb fthumb",
    "index": "index handindex findex indexfinger",
    "middle": "middle handmiddle fmiddle mid middlefinger",
    "ring": "ring handring fring ringfinger",
    "little": "little pinky handpinky fpinky pinkyfinger littlefinger handlittle",
}
_PART_OF = {word: part for part, words in _WORDS.items() for word in words.split()}
_BY_COMPANY = {"shoulder", "hip", "leg", "arm", "hipjoint"}
"""Words that name other bones in other programs: the shoulder is a collar bone beside an arm, and an upper arm beside an elbow."""

_PREFIXES = re.compile(
    r"^(mixamorig\d*|bip\d*|biped\d*|character\d*|cc base|def|j bip|valvebiped bip\d+|[mf] avg|armature|skeleton|skel|bone|jnt"
    r"|genesis\d*\w*)(?=[ ]|$)"
)
_NOT_BONES = re.compile(
    r"\b(ik|pole|ctrl|control|mch|org|target|twist|roll|helper|nub|end|site|eye|jaw|breast|tongue|socket|fk|effector)\b"
)
"""Bones that steer, share a twist, or carry no part of a body of their own."""

_SIDES = {"left": "left", "l": "left", "lft": "left", "lf": "left", "right": "right", "r": "right", "rgt": "right", "rt": "right"}


def split_name(name: str) -> tuple[str, str, int | None]:
    """The side of a bone ("left", "right" or ""), its word in small letters, and the number behind it.

    >>> split_name("mixamorig:LeftHandThumb1"), split_name("upper_arm.R"), split_name("lfemur")
    (('left', 'handthumb', 1), ('right', 'upperarm', None), ('left', 'femur', None))
    """
    name = re.split(r"[:|]", name)[-1]
    tokens = [t.lower() for t in re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+", name)]
    if len("".join(tokens)) < len(re.sub(r"[\W_]", "", name)):  # letters of other scripts
        tokens = [name.lower()]
    text = re.sub(r"\b(bip|biped|mixamorig|character|genesis) (\d+)", r"\1\2", " ".join(tokens))
    text = _PREFIXES.sub("", text).strip() or text
    tokens = [token for token in text.split() if token not in ("c", "m", "def", "joint", "jnt", "bone")]
    sides = [_SIDES[token] for token in tokens if token in _SIDES]
    words = [token for token in tokens if token not in _SIDES and not token.isdigit()]
    numbers = [int(token) for token in tokens if token.isdigit()]
    word = "".join(words)
    side = sides[0] if sides else ""
    if not side and word not in _PART_OF and word not in _BY_COMPANY:
        for start in ("left", "right", "l", "r"):
            rest = word.removeprefix(start)
            if rest != word and (rest in _PART_OF or rest in _BY_COMPANY):
                side, word = _SIDES[start], rest
                break
            rest = word.removesuffix(start)
            if len(start) > 1 and rest != word and rest in _PART_OF:
                side, word = _SIDES[start], rest
                break
    return side, word, numbers[-1] if numbers else None


def parts_of(names: Sequence[str], parents: Sequence[int]) -> dict[str, int]:
    """The bone that each part of the body is, by the names: "pelvis", "neck", "head", "left thigh", "left thumb 1".

    parents  (B,) the bone on which each hangs, -1 for the root

    Of bones with one name the first in the tree is taken. The spine is what lies between pelvis and neck, and is not among the parts.
    """
    found: dict[str, int] = {}
    splits = [split_name(name) for name in names]
    steering = [bool(_NOT_BONES.search(" ".join(re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)).lower())) for name in names]

    def take(part: str, bone: int) -> None:
        found.setdefault(part, bone)

    def there(side: str, *words: str) -> bool:
        return any(splits[b][0] == side and splits[b][1] in words and not steering[b] for b in range(len(names)))

    for b, (side, word, number) in enumerate(splits):
        if steering[b]:
            continue
        part = _PART_OF.get(word)
        if not side:
            if part in ("pelvis", "neck", "head") or (word in ("hip", "root") and not there("", *_WORDS["pelvis"].split())):
                take("pelvis" if word in ("hip", "root") else str(part), b)
            continue
        if word in _BY_COMPANY:
            part = _by_company(side, word, there)
        elif part == "foot" and word == "foot" and there(side, "ankle", "talus"):
            part = "toe" if not there(side, *_WORDS["toe"].split()) else None
        elif part == "hand" and word in ("hand", "palm") and there(side, "wrist"):
            part = None
        if part in FINGERS:
            take(f"{side} {part} {number or 1}", b)
        elif part in LIMB_PARTS:
            take(f"{side} {part}", b)
    return found


def _by_company(side: str, word: str, there: object) -> str | None:
    """Which part a word is that several programs use for different ones, by the other bones of that side."""
    assert callable(there)
    if word == "shoulder":
        collar = there(side, *_WORDS["clavicle"].split())
        arm = there(side, "arm", *_WORDS["upper arm"].split())
        return "clavicle" if arm and not collar else None if arm else "upper arm"
    if word in ("hip", "hipjoint"):
        return None if word == "hipjoint" or there(side, *_WORDS["thigh"].split()) else "thigh"
    if word == "leg":
        return "thigh" if there(side, *_WORDS["shank"].split()) and not there(side, *_WORDS["thigh"].split()) else "shank"
    # an arm beside a forearm is the upper one
    return None if there(side, *_WORDS["upper arm"].split()) else "upper arm"
