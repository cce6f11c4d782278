"""BVH and glTF: what is written comes back, and others read it alike; what others write is read, and what is damaged is refused."""

from __future__ import annotations

import base64
import itertools
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError, NoMarkers
from asterism.formats import convert, describe, read, read_skeleton, write, write_skeleton
from asterism.formats._bones import as_euler, from_euler, turned_into
from asterism.recording import Recording, SkeletonMotion
from asterism.recording.bone_names import parts_of

Y, Z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]


def any_skeleton(seed: int, bones: int = 7, frames: int = 4, gimbal: bool = False) -> SkeletonMotion:
    """Bones of any lengths on any others, turned at random; with gimbal by whole right angles."""
    rng = np.random.default_rng(seed)
    parents = tuple([-1] + [int(rng.integers(0, b)) for b in range(1, bones)])
    offsets = rng.normal(size=(bones, 3))
    offsets[0] = 0.0
    ends = np.where(np.isin(np.arange(bones), parents)[:, None], np.nan, rng.normal(size=(bones, 3)))
    rotations = Rotation.random(frames * bones, random_state=seed).as_matrix()
    if gimbal:
        rotations = from_euler(ORDERS[seed % 6], rng.integers(-4, 5, (frames * bones, 3)) * np.pi / 2)
    root = rng.normal(size=(frames, 3))
    return SkeletonMotion(tuple(f"b{b}" for b in range(bones)), parents, offsets, ends, rotations.reshape(frames, bones, 3, 3), root, 100.0)


def by_name(motion: SkeletonMotion, names: tuple[str, ...]) -> np.ndarray:
    return motion.joints[:, [motion.names.index(name) for name in names]]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(ORDERS), st.integers(1, 9), st.booleans())
def test_a_bvh_gives_back_what_was_written_to_the_digits_that_it_prints(
    tmp_path_factory: pytest.TempPathFactory, seed: int, order: str, bones: int, gimbal: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.bvh"
    motion = turned_into(any_skeleton(seed, bones, gimbal=gimbal), Y, Z)[0]
    assert write_skeleton(path, motion, order=order, unit="m") == []
    found = read_skeleton(path, unit="m", vertical="y").motion
    assert np.allclose(by_name(found, motion.names), motion.joints, atol=3e-6 * bones), "m"
    turns = found.rotations[:, [found.names.index(name) for name in motion.names]]
    assert np.allclose(turns, motion.rotations, atol=3e-8), "1e-6 degrees are printed"
    assert np.array_equal(np.isnan(found.ends).any(axis=1).sum(), np.isnan(motion.ends).any(axis=1).sum())


@pytest.mark.parametrize("order", ORDERS)
def test_angles_of_a_steady_turn_do_not_jump_and_give_the_turn_back_through_gimbal_lock(order: str) -> None:
    turn = Rotation.from_rotvec(np.linspace(0, 12, 400)[:, None] * np.array([0.6, 0.64, 0.48])).as_matrix()
    angles = as_euler(turn, order)
    assert np.allclose(from_euler(order, angles), turn, atol=1e-12)
    assert np.abs(np.diff(angles, axis=0)).max() < 0.6, "rad from frame to frame of 0.03 rad, without turns by pi or 2 pi"
    locked = from_euler(order, np.array([[0.3, np.pi / 2, 0.2], [0.4, np.pi / 2, 0.2]]))
    assert np.allclose(from_euler(order, as_euler(locked, order)), locked, atol=1e-9)


def test_an_independent_reader_of_bvh_finds_each_joint_where_it_is(tmp_path: Path) -> None:
    pybvh = pytest.importorskip("pybvh")
    motion = any_skeleton(3, 12)
    for order in ("ZXY", "XYZ"):
        write_skeleton(tmp_path / "a.bvh", motion, order=order)
        theirs = pybvh.read_bvh_file(str(tmp_path / "a.bvh"))
        upright = turned_into(motion, Y, Z)[0]
        at = [upright.names.index(name) for name in theirs.joint_names]
        assert np.allclose(np.asarray(theirs.joint_positions()), 100 * upright.joints[:, at], atol=1e-4), "cm"
        assert theirs.frame_time == pytest.approx(0.01)


def test_an_independent_reader_of_gltf_moves_the_body_of_each_bone_with_it(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    motion = any_skeleton(5, 9, frames=5)
    upright = turned_into(motion, Y, Z)[0]
    for suffix in (".glb", ".gltf"):
        write_skeleton(tmp_path / f"a{suffix}", motion)
        theirs = pygltflib.GLTF2().load(str(tmp_path / f"a{suffix}"))

        def values(index: int, theirs=theirs) -> np.ndarray:
            accessor = theirs.accessors[index]
            view = theirs.bufferViews[accessor.bufferView]
            buffer = theirs.buffers[view.buffer]
            data = theirs.binary_blob() if buffer.uri is None else base64.b64decode(buffer.uri.split(",")[1])
            kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor.componentType]
            width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
            return np.frombuffer(data, kind, accessor.count * width, view.byteOffset).reshape(-1, width)

        assert {skin.joints[0] for skin in theirs.skins} == {0}
        frame, animation = 3, theirs.animations[0]
        local = {n: np.eye(4) for n in range(len(theirs.nodes))}
        for n, node in enumerate(theirs.nodes):
            local[n][:3, 3] = node.translation or (0, 0, 0)
        for channel in animation.channels:
            value = values(animation.samplers[channel.sampler].output)[frame]
            if channel.target.path == "rotation":
                assert np.linalg.norm(value) == pytest.approx(1, abs=1e-6)
                local[channel.target.node][:3, :3] = Rotation.from_quat(value).as_matrix()
            else:
                local[channel.target.node][:3, 3] = value
        world = {0: local[0]}
        for n, node in enumerate(theirs.nodes):
            for child in node.children or []:
                world[child] = world[n] @ local[child] if n in world else local[child]
        inverse = values(theirs.skins[0].inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
        for b, name in enumerate(upright.names):
            n = next(i for i, node in enumerate(theirs.nodes) if node.name == name)
            assert np.allclose(world[n][:3, 3], upright.joints[frame, b], atol=1e-5), f"{name}, m"
        # the first corner of each bone's body is on a ring about it: the skin must take it there, too
        for primitive in theirs.meshes[0].primitives:
            corners, joints = values(primitive.attributes.POSITION), values(primitive.attributes.JOINTS_0)
            assert np.allclose(values(primitive.attributes.WEIGHTS_0).sum(axis=1), 1.0)
            for corner, (joint, *_) in zip(corners[::24], joints[::24], strict=True):
                posed = (world[joint] @ inverse[joint] @ np.append(corner, 1.0))[:3]
                place = upright.names.index(theirs.nodes[joint].name)
                assert np.linalg.norm(posed - upright.joints[frame, place]) < 1.5, "m: it stays on its bone of up to 4 m"


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_gltf_gives_back_what_was_written_and_the_rate_of_television(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    motion = any_skeleton(2, 8, frames=30)
    object.__setattr__(motion, "rate", 59.94)
    write_skeleton(path, motion)
    found = read_skeleton(path).motion
    upright = turned_into(motion, Y, Z)[0]
    assert np.allclose(by_name(found, upright.names), upright.joints, atol=2e-5), "m, numbers of 24 bits"
    assert found.rate == 59.94
    ends = found.ends[[found.names.index(name) for name in upright.names]]
    assert np.allclose(ends, upright.ends, atol=1e-6, equal_nan=True)
    # into the same file again: all that it has stays
    write_skeleton(tmp_path / f"b{suffix}", found, like=path)
    again = read_skeleton(tmp_path / f"b{suffix}").motion
    assert np.allclose(again.joints, found.joints, atol=3e-5)


def test_missing_bones_are_held_or_interpolated_and_said(tmp_path: Path) -> None:
    motion = any_skeleton(1, 3, frames=9)
    turn = Rotation.from_euler("x", 10 * np.arange(9)[:, None], degrees=True).as_matrix()
    rotations = np.stack([turn, turn, turn], axis=1)
    rotations[3:6, 1], rotations[0, 2] = np.nan, np.nan
    gaps = SkeletonMotion(motion.names, motion.parents, motion.offsets, motion.ends, rotations, motion.root, 100.0, Y, Z)
    lost = write_skeleton(tmp_path / "hold.bvh", gaps)
    assert lost == ["which bones are missing in 4 of 9 frames (b1, b2): they are held as they last were"]
    held = read_skeleton(tmp_path / "hold.bvh", unit="cm", vertical="y").motion.rotations
    assert np.allclose(held[3:6, 1], turn[2], atol=1e-7) and np.allclose(held[0, 2], turn[1], atol=1e-7)
    lost = write_skeleton(tmp_path / "even.glb", gaps, missing="interpolate")
    assert "interpolated" in lost[0]
    assert np.allclose(read_skeleton(tmp_path / "even.glb", vertical="y").motion.rotations[:, 1], turn, atol=1e-6)
    with pytest.raises(AsterismError, match="hold or interpolate"):
        write_skeleton(tmp_path / "x.bvh", gaps, missing="drop")


PERSON = """HIERARCHY
ROOT Hips
{
	OFFSET 0 0 0
	CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
	JOINT Chest
	{
		OFFSET 0 40 0
		CHANNELS 3 Zrotation Xrotation Yrotation
		JOINT Head
		{
			OFFSET 0 30 0
			CHANNELS 3 Zrotation Xrotation Yrotation
			End Site
			{
				OFFSET 0 20 0
			}
		}
	}
	JOINT Left Foot
	{
		OFFSET 10 -90 0
		CHANNELS 3 Zrotation Xrotation Yrotation
		End Site
		{
			OFFSET 0 0 15
		}
	}
	JOINT Right Foot
	{
		OFFSET -10 -90 0
		CHANNELS 3 Zrotation Xrotation Yrotation
		End Site
		{
			OFFSET 0 0 15
		}
	}
}
MOTION
Frames: 2
Frame Time: 0.0083333
0 95 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
0 95 1 10 0 0 0 20 0 0 0 0 0 0 0 0 0 0
"""


def test_a_persons_bvh_is_read_in_metres_with_up_and_ahead(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text(PERSON)
    file = read_skeleton(tmp_path / "a.bvh")
    assert file.motion.rate == 120.0 and file.unit == 0.01
    assert [finding.code for finding in file.findings] == ["format-units-assumed"] and "1.80 m" in file.findings[0].sentence
    assert file.motion.vertical.tolist() == Y.tolist() and file.motion.forward.tolist() == Z.tolist()
    assert file.motion.joints[0, 2].round(6).tolist() == [0, 1.65, 0]
    assert describe(tmp_path / "a.bvh")["bones"]["Chest"] == 0.3
    assert read_skeleton(tmp_path / "a.bvh", unit="in").motion.joints[0, 2, 1] == pytest.approx(165 * 0.0254)
    with pytest.raises(NoMarkers, match="bones of a skeleton and no markers"):
        read(tmp_path / "a.bvh")
    with pytest.raises(AsterismError, match="holds bones and no markers; fit a skeleton"):
        write(tmp_path / "n.bvh", Recording(np.zeros((2, 1, 3)), ("LASI",), 100.0))
    assert convert(tmp_path / "a.bvh", tmp_path / "a.glb") == []
    assert np.allclose(read_skeleton(tmp_path / "a.glb").motion.joints[1], file.motion.joints[1], atol=1e-6)
    write_skeleton(tmp_path / "b.bvh", file.motion, like=tmp_path / "a.bvh")
    # not a character of the hierarchy is another
    assert (tmp_path / "b.bvh").read_text().split("MOTION")[0] == PERSON.split("MOTION")[0]
    assert np.allclose(read_skeleton(tmp_path / "b.bvh").motion.joints, file.motion.joints, atol=1e-8)


OTHERWISE = {
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "CR": lambda text: text.replace("\n", "\r"),
    "blanks for tabs": lambda text: text.replace("\t", "  "),
    "braces on the line": lambda text: text.replace("\n\t{", " {").replace("\n{", " {"),
    "commas between": lambda text: text.replace("0 95 ", "0, 95, "),
    "decimal commas": lambda text: text.replace("0 95 1 10", "0 95,0 1,0 10,0"),
    "small letters": lambda text: text.replace("OFFSET", "Offset").replace("Xposition", "XPOSITION").replace("End Site", "End site"),
    "empty lines": lambda text: text.replace("\n", "\n\n"),
    "mark of UTF-8": lambda text: "\ufeff" + text,
    "no frames said": lambda text: text.replace("Frames: 2\n", ""),
    "tabs in frames": lambda text: text.replace("0 95 ", "0\t95\t"),
}


@pytest.mark.parametrize("otherwise", OTHERWISE)
def test_a_bvh_is_read_however_it_is_spelled(tmp_path: Path, otherwise: str) -> None:
    (tmp_path / "a.bvh").write_text(PERSON)
    (tmp_path / "b.bvh").write_bytes(OTHERWISE[otherwise](PERSON).encode())
    expected, found = (read_skeleton(tmp_path / name).motion for name in ("a.bvh", "b.bvh"))
    assert np.allclose(found.joints, expected.joints) and found.names == expected.names


DAMAGED = {
    "a second root": (
        lambda text: text.replace("}\nMOTION", "}\nROOT Other\n{\nOFFSET 0 0 0\n}\nMOTION"),
        "line 39: a second root, 'Other'",
    ),
    "cut off among bones": (lambda text: text[:300], "no line MOTION"),
    "a brace is lost": (lambda text: text.replace("}\nMOTION", "\nMOTION"), "not closed"),
    "a brace too many": (lambda text: text.replace("}\nMOTION", "}\n}\nMOTION"), "not opened"),
    "an offset of two": (lambda text: text.replace("OFFSET 0 40 0", "OFFSET 0 40"), "not three numbers"),
    "an offset of nothing": (lambda text: text.replace("OFFSET 0 40 0", "OFFSET 0 nan 0"), "not three numbers"),
    "channels miscounted": (lambda text: text.replace("CHANNELS 6", "CHANNELS 5"), "as many names as it announces"),
    "channels unknown": (lambda text: text.replace("Xposition", "Xscale"), "each once of"),
    "channels twice": (lambda text: text.replace("Xposition", "Yposition"), "each once of"),
    "a row too long": (lambda text: text.replace("0 95 0 0", "0 95 0 0 7"), "line 42 has 19 numbers"),
    "a word in a row": (lambda text: text.replace("0 95 1", "0 wide 1"), "'wide' is not a number"),
    "no frame time": (lambda text: text.replace("Frame Time: 0.0083333\n", ""), "no Frame Time"),
    "frame time zero": (lambda text: text.replace("0.0083333", "0"), "Frame Time is 0"),
    "no frames": (lambda text: text.split("0 95")[0], "no whole frame"),
    "a strange word": (lambda text: text.replace("OFFSET 0 40 0", "PLACE 0 40 0"), "line 8: PLACE"),
    "a thousand bones deep": (
        lambda text: (
            "HIERARCHY\n" + "".join(f"{'JOINT' if i else 'ROOT'} j{i}\n{{\nOFFSET 0 1 0\n" for i in range(1000)) + "}" * 1000 + "\nMOTION\n"
        ),
        "more than 500 bones",
    ),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_bvh_is_refused_in_a_sentence(tmp_path: Path, damage: str) -> None:
    change, sentence = DAMAGED[damage]
    (tmp_path / "walk.bvh").write_text(change(PERSON))
    with pytest.raises(AsterismError, match=r"walk\.bvh") as problem:
        read_skeleton(tmp_path / "walk.bvh")
    assert sentence in str(problem.value)


def test_a_bvh_that_miscounts_or_has_no_numbers_is_read_and_that_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text(PERSON.replace("Frames: 2", "Frames: 9").replace("0 95 1 10", "0 95 1 -nan(ind)") + "0 95 0 0\n")
    file = read_skeleton(tmp_path / "a.bvh")
    codes = [finding.code for finding in file.findings]
    assert codes == ["format-cut-off", "format-header-conflict", "format-units-assumed", "format-missing-samples"]
    assert np.isnan(file.motion.rotations[1, 0]).all() and np.isfinite(file.motion.rotations[0]).all()


def test_positions_on_every_joint_replace_offsets_and_what_slides_is_said(tmp_path: Path) -> None:
    six = PERSON.replace("CHANNELS 3 Z", "CHANNELS 6 Xposition Yposition Zposition Z").replace("OFFSET 0 40 0", "OFFSET 0 0 0")
    rows = [
        "0 95 0 0 0 0  0 40 0 0 0 0  0 30 0 0 0 0  10 -90 0 0 0 0  -10 -90 0 0 0 0",
        "0 95 1 10 0 0  0 40 0 0 20 0  0 34 0 0 0 0  10 -90 0 0 0 0  -10 -90 0 0 0 0",
    ]
    (tmp_path / "a.bvh").write_text(six.split("0 95")[0] + "\n".join(rows) + "\n")
    file = read_skeleton(tmp_path / "a.bvh")
    assert file.motion.offsets[1].tolist() == pytest.approx([0, 0.4, 0])
    assert [f.code for f in file.findings if "Head by 20 mm" in f.sentence] == ["format-bones-rigid"]


def test_a_bone_that_places_the_hips_is_joined_with_them_and_kept_in_a_file_like_it(tmp_path: Path) -> None:
    inner = PERSON.split("MOTION")[0].replace("HIERARCHY\nROOT", "JOINT").replace("OFFSET 0 0 0", "OFFSET 0 3 0", 1)
    head = (
        f"HIERARCHY\nROOT Reference\n{{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n{inner}}}\n"
    )
    rows = [f"5 0 0 0 0 90 {row}" for row in PERSON.strip().split("\n")[-2:]]
    rows[1] = rows[1].replace(" 95 1 ", " 96 1 ")
    (tmp_path / "a.bvh").write_text(head + "MOTION\nFrames: 2\nFrame Time: 0.01\n" + "\n".join(rows) + "\n")
    file = read_skeleton(tmp_path / "a.bvh")
    assert file.motion.names[0] == "Hips" and "both were read as one bone" in " ".join(f.sentence for f in file.findings)
    # a quarter turn about y takes z to x
    assert file.motion.root.tolist() == pytest.approx(np.array([[0.05, 0.95, 0], [0.06, 0.96, 0]]))
    write_skeleton(tmp_path / "b.bvh", file.motion, like=tmp_path / "a.bvh")
    again = read_skeleton(tmp_path / "b.bvh").motion
    assert np.allclose(again.joints, file.motion.joints, atol=1e-7)


def test_a_bvh_with_z_up_is_seen_by_head_and_feet_and_one_who_lies_is_not_taken_for_it(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text(PERSON)
    lying = PERSON.replace("0 95 0 0 0 0", "0 10 0 0 -90 0").replace("0 95 1 10 0 0", "0 10 0 0 -90 0")
    (tmp_path / "lying.bvh").write_text(lying)
    assert read_skeleton(tmp_path / "lying.bvh").motion.vertical.tolist() == Y.tolist()
    standing = PERSON
    for old, new in (("0 40 0", "0 0 40"), ("0 30 0", "0 0 30"), ("0 20 0", "0 0 20"), ("10 -90 0", "10 0 -90"), ("0 0 15", "0 -15 0")):
        standing = standing.replace(old, new)
    (tmp_path / "z.bvh").write_text(standing.replace("0 95 0", "0 0 95").replace("0 95 1", "0 0 95"))
    file = read_skeleton(tmp_path / "z.bvh")
    assert file.motion.vertical.tolist() == Z.tolist() and file.motion.forward.tolist() == [0, -1, 0]
    assert "format-vertical-conflict" in [finding.code for finding in file.findings]
    assert read_skeleton(tmp_path / "z.bvh", vertical="y").motion.vertical.tolist() == Y.tolist()


# glTF as others write it.


def foreign(tmp_path: Path, **changes: object) -> Path:
    """A skin in centimetres under an armature of scale 0.01 with z up, as exporters of other programs give it: hips and a leg."""
    up = Rotation.from_euler("x", -90, degrees=True)
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[0, :3, 3], bind[1, :3, 3] = (0, 0, 95), (10, 0, 50)
    bind[1, :3, :3] = Rotation.from_euler("x", 180, degrees=True).as_matrix()
    local = np.linalg.inv(bind[0]) @ bind[1]
    times = np.array([0.0, 0.5, 1.0], np.float32)
    turns = (Rotation.from_matrix(local[:3, :3]) * Rotation.from_euler("x", [[0], [30], [60]], degrees=True)).as_quat().astype(np.float32)
    blobs = [np.linalg.inv(bind).swapaxes(1, 2).astype(np.float32), times, turns]
    kind = changes.get("interpolation", "LINEAR")
    if kind == "CUBICSPLINE":
        blobs[2] = np.stack([0 * turns, turns, 0 * turns], axis=1).astype(np.float32)
    data, views, at = b"", [], 0
    for blob in blobs:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": blob.nbytes})
        data, at = data + blob.tobytes(), at + blob.nbytes
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 2, "type": "MAT4"},
        {"bufferView": 1, "componentType": 5126, "count": 3, "type": "SCALAR"},
        {"bufferView": 2, "componentType": 5126, "count": 9 if kind == "CUBICSPLINE" else 3, "type": "VEC4"},
    ]
    matrix = np.eye(4)
    matrix[:3, 3] = (0, 0, 95)
    quaternion = Rotation.from_matrix(local[:3, :3]).as_quat().tolist()
    document = {
        "asset": {"version": "2.0"},
        "nodes": [
            {"name": "Armature", "rotation": up.as_quat().tolist(), "scale": [0.01] * 3, "children": [1]},
            {"name": "hips", "matrix": matrix.T.ravel().tolist(), "children": [2]},
            {"name": "leg.L", "translation": local[:3, 3].tolist(), "rotation": quaternion},
        ],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": 0}],
        "animations": [
            {
                "name": "kick",
                "samplers": [{"input": 1, "output": 2, "interpolation": kind}],
                "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}],
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [
            {"byteLength": len(data), "uri": changes.get("uri", "data:application/octet-stream;base64," + base64.b64encode(data).decode())}
        ],
    }
    (tmp_path / "data.bin").write_bytes(data)
    document |= changes.get("document", {})
    (tmp_path / "their.gltf").write_text(json.dumps(document))
    return tmp_path / "their.gltf"


@pytest.mark.parametrize(("kind", "half"), [("LINEAR", 15.0), ("STEP", 0.0), ("CUBICSPLINE", 15.0)])
def test_a_skin_in_centimetres_with_z_up_comes_out_in_metres_with_y_up(tmp_path: Path, kind: str, half: float) -> None:
    motion = read_skeleton(foreign(tmp_path, interpolation=kind), vertical="y").motion
    assert motion.names == ("hips", "leg.L") and motion.rate == 2.0
    assert motion.offsets[1].tolist() == pytest.approx([0.1, -0.45, 0.0], abs=1e-6)
    assert motion.root[0].tolist() == pytest.approx([0, 0.95, 0], abs=1e-6)
    angles = np.degrees(Rotation.from_matrix(motion.rotations[:, 1]).magnitude())
    assert angles.tolist() == pytest.approx([0, 30, 60], abs=1e-3)
    # between the keys, by a key that another bone has there
    from asterism.formats.gltf import _sampled

    turns = Rotation.from_euler("x", [[0], [30]], degrees=True).as_quat()
    values = np.stack([0 * turns, turns, 0 * turns], axis=1).reshape(6, 4) if kind == "CUBICSPLINE" else turns
    between = _sampled((np.array([0.0, 1.0]), values, kind), np.array([0.5]), True)
    assert np.degrees(Rotation.from_quat(between[0]).magnitude()) == pytest.approx(half, abs=0.6)


def test_an_animation_in_another_file_keeps_its_axes_scale_and_names(tmp_path: Path) -> None:
    their = foreign(tmp_path)
    motion = read_skeleton(their, vertical="y").motion
    write_skeleton(tmp_path / "ours.gltf", motion, like=their)
    document = json.loads((tmp_path / "ours.gltf").read_text())
    assert [one["name"] for one in document["animations"]] == ["motion", "kick"]
    assert "matrix" not in document["nodes"][1] and document["nodes"][0]["scale"] == [0.01] * 3
    again = read_skeleton(tmp_path / "ours.gltf", vertical="y").motion
    assert np.allclose(again.joints, motion.joints, atol=1e-6)
    kicked = read_skeleton(tmp_path / "ours.gltf", animation="kick", vertical="y").motion
    assert np.allclose(kicked.rotations, motion.rotations, atol=1e-6)


def test_a_buffer_beside_the_file_is_read_and_one_elsewhere_is_not(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    assert len(read_skeleton(foreign(inside, uri="data.bin")).motion) == 3
    (tmp_path / "secret.bin").write_bytes((inside / "data.bin").read_bytes())
    for uri in ("../secret.bin", "%2e%2e/secret.bin", "/etc/passwd", "file:///etc/passwd", str(tmp_path / "secret.bin")):
        with pytest.raises(AsterismError, match=r"their\.gltf.*outside of its folder"):
            read_skeleton(foreign(inside, uri=uri))
    (inside / "link.bin").symlink_to(tmp_path / "secret.bin")
    with pytest.raises(AsterismError, match="outside of its folder"):
        read_skeleton(foreign(inside, uri="link.bin"))
    with pytest.raises(AsterismError, match="not beside it"):
        read_skeleton(foreign(inside, uri="gone.bin"))


def test_a_damaged_gltf_is_refused_in_a_sentence(tmp_path: Path) -> None:
    def refused(path: Path, sentence: str) -> None:
        with pytest.raises(AsterismError, match=sentence) as problem:
            read_skeleton(path)
        assert path.name in str(problem.value)

    write_skeleton(tmp_path / "a.glb", any_skeleton(1))
    whole = (tmp_path / "a.glb").read_bytes()
    (tmp_path / "cut.glb").write_bytes(whole[:-50])
    refused(tmp_path / "cut.glb", "cut off")
    (tmp_path / "long.glb").write_bytes(whole[:12] + struct.pack("<I", 2**31) + whole[16:])
    refused(tmp_path / "long.glb", "beyond its end")
    (tmp_path / "json.glb").write_bytes(whole.replace(b'"nodes"', b'"nodes ', 1))
    refused(tmp_path / "json.glb", "JSON cannot be read")
    (tmp_path / "one.glb").write_bytes(whole[:4] + struct.pack("<I", 1) + whole[8:])
    refused(tmp_path / "one.glb", "version 1")
    nodes = [{"name": "a", "children": [1]}, {"name": "b", "children": [0]}]
    refused(foreign(tmp_path, document={"nodes": nodes}), "circle")
    refused(foreign(tmp_path, document={"skins": [], "animations": []}), "no skeleton")
    refused(foreign(tmp_path, document={"skins": [{"joints": [1, 99]}]}), "does not exist")
    refused(
        foreign(tmp_path, document={"accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**7, "type": "MAT4"}] * 3}), "cut off"
    )
    refused(foreign(tmp_path, document={"asset": {"version": "1.0"}}), "2.0 is read")
    mirrored = foreign(tmp_path)
    document = json.loads(mirrored.read_text())
    document["nodes"][0]["scale"] = [-0.01, 0.01, 0.01]
    mirrored.write_text(json.dumps(document))
    refused(mirrored, "mirrored")


NAMES = {
    "Mixamo": "mixamorig:Hips mixamorig:Head mixamorig:LeftShoulder mixamorig:LeftArm mixamorig:LeftForeArm mixamorig:LeftHand "
    "mixamorig:LeftUpLeg mixamorig:LeftLeg mixamorig:LeftFoot mixamorig:LeftToeBase",
    "CMU": "root head lclavicle lhumerus lradius lhand lfemur ltibia lfoot ltoes",
    "Unreal": "pelvis head clavicle_l upperarm_l lowerarm_l hand_l thigh_l calf_l foot_l ball_l",
    "Biovision": "Hips Head LeftCollar LeftShoulder LeftElbow LeftWrist LeftHip LeftKnee LeftAnkle LeftToe",
    "HumanIK": "Character1_Hips Character1_Head Character1_LeftShoulder Character1_LeftArm Character1_LeftForeArm Character1_LeftHand "
    "Character1_LeftUpLeg Character1_LeftLeg Character1_LeftFoot Character1_LeftToeBase",
    "Rigify": "hips head shoulder.L upper_arm.L forearm.L hand.L thigh.L shin.L foot.L toe.L",
    "DEF": "DEF-hips DEF-head DEF-shoulder.L DEF-upper_arm.L DEF-forearm.L DEF-hand.L DEF-thigh.L DEF-shin.L DEF-foot.L DEF-toe.L",
    "SMPL": "Pelvis Head L_Collar L_Shoulder L_Elbow L_Wrist L_Hip L_Knee L_Ankle L_Foot",
    "Biped": "Bip01_Pelvis Bip01_Head Bip01_L_Clavicle Bip01_L_UpperArm Bip01_L_Forearm Bip01_L_Hand Bip01_L_Thigh Bip01_L_Calf "
    "Bip01_L_Foot Bip01_L_Toe0",
    "VRM": "J_Bip_C_Hips J_Bip_C_Head J_Bip_L_Shoulder J_Bip_L_UpperArm J_Bip_L_LowerArm J_Bip_L_Hand J_Bip_L_UpperLeg J_Bip_L_LowerLeg "
    "J_Bip_L_Foot J_Bip_L_ToeBase",
    "OpenSim": "pelvis head clavicle_l humerus_l ulna_l hand_l femur_l tibia_l talus_l toes_l",
    "Daz": "hip head lCollar lShldrBend lForearmBend lHand lThighBend lShin lFoot lToe",
    "ours": "pelvis head left_clavicle left_upper_arm left_forearm left_hand left_thigh left_shank left_foot left_toe",
}
PARTS = ["pelvis", "head", *(f"left {part}" for part in ("clavicle", "upper arm", "forearm", "hand", "thigh", "shank", "foot", "toe"))]


@pytest.mark.parametrize("program", NAMES)
def test_bones_are_known_by_the_names_that_programs_give_them(program: str) -> None:
    names = NAMES[program].split()
    names += [name for name in ("upperarm_twist_01_l", "ik_foot_l", "LeftForeArmRoll") if program in ("Unreal", "HumanIK")]
    assert parts_of(names, [-1, *[0] * (len(names) - 1)]) == dict(zip(PARTS, range(10), strict=True))
    swapped = [
        n.replace("Left", "Right").replace("_L_", "_R_").replace("_l", "_r").replace(".L", ".R").replace("left", "right") for n in names
    ]
    swapped = [f"R{n[1:]}" if n.startswith("L_") else f"r{n[1:]}" if n[0] == "l" and program in ("CMU", "Daz") else n for n in swapped]
    assert parts_of(swapped, [-1, *[0] * (len(names) - 1)]) == {part.replace("left", "right"): b for b, part in enumerate(PARTS)}


def test_fingers_and_their_numbers_are_known() -> None:
    names = ["mixamorig:RightHandThumb1", "index_02_r", "f_middle.03.R", "R_Pinky1"]
    assert set(parts_of(names, [-1, 0, 0, 0])) == {"right thumb 1", "right index 2", "right middle 3", "right little 1"}


def test_packed_accessors_are_read_as_the_specification_has_them(tmp_path: Path) -> None:
    """Rotations as normalised 16-bit integers with a stride, and translations that are zeros but for one sparse value."""
    path = foreign(tmp_path)
    document = json.loads(path.read_text())
    data = bytearray(base64.b64decode(document["buffers"][0]["uri"].split(",")[1]))
    plain = read_skeleton(path, vertical="y").motion
    view = document["bufferViews"][2]
    turns = np.frombuffer(bytes(data), "<f4", 12, view["byteOffset"]).reshape(3, 4)
    packed = np.zeros((3, 8), "<i2")
    packed[:, :4] = np.round(turns * 32767)
    for blob, extra in ((packed, {"byteStride": 16}), (np.array([1], "<u2"), {}), (np.array([[0, 0, 7]], "<f4"), {})):
        data += bytes(-len(data) % 4)
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": blob.nbytes, **extra})
        data += blob.tobytes()
    document["accessors"][2] = {"bufferView": 3, "componentType": 5122, "normalized": True, "count": 3, "type": "VEC4"}
    sparse = {"count": 1, "indices": {"bufferView": 4, "componentType": 5123}, "values": {"bufferView": 5}}
    document["accessors"].append({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse})
    document["animations"][0]["samplers"].append({"input": 1, "output": 3})
    document["animations"][0]["channels"].append({"sampler": 1, "target": {"node": 1, "path": "translation"}})
    document["buffers"] = [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}]
    path.write_text(json.dumps(document))
    found = read_skeleton(path, vertical="y").motion
    assert np.allclose(found.rotations, plain.rotations, atol=1e-4)
    assert found.root.tolist() == pytest.approx(np.array([[0, 0, 0], [0, 0.07, 0], [0, 0, 0]])), "m: 7 cm along the armature's z"


@pytest.mark.parametrize("suffix", [".bvh", ".glb"])
def test_whatever_a_damaged_file_holds_it_ends_in_a_sentence(tmp_path: Path, suffix: str) -> None:
    path, rng = tmp_path / f"walk{suffix}", np.random.default_rng(3)
    write_skeleton(path, any_skeleton(4))
    whole, refused = path.read_bytes(), 0
    for k in range(60):
        data = bytearray(whole[: rng.integers(1, len(whole))] if k % 3 == 2 else whole)
        for at in rng.integers(0, len(data), 6):
            data[at] = ord(rng.choice(list('0123456789-.{}[]",:e '))) if k % 3 else rng.integers(0, 256)
        path.write_bytes(data)
        try:
            read_skeleton(path)
        except AsterismError as problem:
            refused += 1
            assert path.name in str(problem) and "Error" not in str(problem)
    assert refused > 20
