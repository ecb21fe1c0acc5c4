"""Readers of annotations: each format read right, and every refusal names file, instance and keypoint."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.io import savemat

from fgrecon.core.errors import InvalidInputError
from fgrecon_research.io.annotations import Annotations, load_annotations, spread
from research.tests.training.priors.nrsfm_data import chair, draw_world

NAMES = chair().keypoints


def coco(keypoints, **changes):
    """COCO content for keypoints (M, K, 2); unseen ones have flag 0 and coordinates 0."""
    entries = []
    for number, points in enumerate(keypoints):
        flat = [x for p in points for x in ([0, 0, 0] if np.isnan(p[0]) else [float(p[0]), float(p[1]), 2])]
        entries.append({"id": 100 + number, "image_id": number, "category_id": 7, "keypoints": flat})
    return {
        "images": [{"id": number, "file_name": f"{number}.jpg"} for number in range(len(keypoints))],
        "categories": [{"id": 7, "name": "chair", "keypoints": list(NAMES)}],
        "annotations": entries,
        **changes,
    }


@pytest.fixture
def keypoints():
    return draw_world(0, count=6, missing=0.3).keypoints


def write(path, content):
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_coco(tmp_path, keypoints):
    read = load_annotations([write(tmp_path / "chairs.json", coco(keypoints))], chair())
    np.testing.assert_array_equal(read.keypoints, keypoints)
    assert read.names[2] == "2.jpg annotation 102"


def test_coco_reorders_by_name_renames_and_passes_over_other_categories(tmp_path, keypoints):
    content = coco(keypoints[:, ::-1])
    content["categories"][0]["keypoints"] = [
        "tip" if n == "backrest_centre" else n for n in content["categories"][0]["keypoints"][::-1]
    ]
    content["categories"].append({"id": 8, "name": "person", "keypoints": ["nose"]})
    content["annotations"].append({"id": 1, "category_id": 8, "keypoints": [1, 2, 2]})
    content["annotations"].append({"id": 2, "category_id": 7, "iscrowd": 1, "keypoints": []})
    path = write(tmp_path / "chairs.json", content)
    read = load_annotations([path], chair(), {"tip": "backrest_centre"})
    np.testing.assert_array_equal(read.keypoints, keypoints)
    without = load_annotations([path], chair())
    assert np.isnan(without.keypoints[:, NAMES.index("backrest_centre")]).all()


def test_coco_annotations_without_a_labelled_keypoint_are_left_out(tmp_path, keypoints):
    content = coco(keypoints)
    content["annotations"][1]["keypoints"] = [0] * 3 * len(NAMES)
    read = load_annotations([write(tmp_path / "a.json", content)], chair())
    np.testing.assert_array_equal(read.keypoints, np.delete(keypoints, 1, axis=0))


def test_coco_hidden_but_labelled_keypoints_count(tmp_path, keypoints):
    content = coco(keypoints)
    content["annotations"][0]["keypoints"][:3] = [5.0, 6.0, 1]
    read = load_annotations([write(tmp_path / "a.json", content)], chair())
    np.testing.assert_array_equal(read.keypoints[0, 0], [5.0, 6.0])


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (2, 3, r"annotations\[1\].keypoints: got 3\.0"),
        (3, "x", r'annotations\[1\].keypoints\[3\]: got the text "x"'),
        (4, float("inf"), r"annotations\[1\].keypoints\[4\]: got inf"),
    ],
)
def test_coco_refusals_name_file_annotation_and_value(tmp_path, place, value, message):
    content = coco(draw_world(0, count=3, missing=0.0).keypoints)
    content["annotations"][1]["keypoints"][place] = value
    with pytest.raises(InvalidInputError, match=message) as caught:
        load_annotations([write(tmp_path / "bad.json", content)], chair())
    assert "bad.json" in str(caught.value)


def test_coco_of_wrong_length_or_without_names(tmp_path, keypoints):
    short = coco(keypoints)
    short["annotations"][0]["keypoints"] = [1, 2, 2]
    with pytest.raises(InvalidInputError, match=r"annotations\[0\].keypoints: got 3 numbers"):
        load_annotations([write(tmp_path / "a.json", short)], chair())
    with pytest.raises(InvalidInputError, match="no keypoint names"):
        load_annotations([write(tmp_path / "b.json", coco(keypoints, categories=[{"id": 1}]))], chair())
    strange = coco(keypoints[:, :1], categories=[{"id": 7, "keypoints": ["nose"]}])
    with pytest.raises(InvalidInputError, match="categories: got nose"):
        load_annotations([write(tmp_path / "c.json", strange)], chair())
    (tmp_path / "d.json").write_text("[")
    with pytest.raises(InvalidInputError, match=r"d\.json"):
        load_annotations([tmp_path / "d.json"], chair())


def pascal(path, objects):
    """A file as PASCAL3D+ ships them: record.objects, a struct array of objects with anchors."""
    array = np.empty((1, len(objects)), dtype=[("class", "O"), ("anchors", "O")])
    for i, (name, anchors) in enumerate(objects):
        group = {} if anchors is None else anchors
        array[0, i] = (name, group if group else np.zeros((0, 0)))
    savemat(path, {"record": {"filename": "x.jpg", "objects": array}})
    return path


def anchor(location, status):
    return {"location": np.array(location, dtype=float) if location is not None else np.zeros((0, 0)), "status": status}


def test_pascal3d(tmp_path, keypoints):
    paths = []
    for number, points in enumerate(keypoints):
        anchors = {
            name: anchor(None, 2) if np.isnan(p[0]) else anchor(p + 1, 1) for name, p in zip(NAMES, points, strict=True)
        }
        other = ("car", {"left_headlight": anchor([1, 1], 1)})
        paths.append(pascal(tmp_path / f"n{number}.mat", [("chair", anchors), other, ("chair", None)]))
    read = load_annotations([tmp_path], chair())
    np.testing.assert_allclose(read.keypoints, keypoints, atol=1e-9)
    assert read.names[0] == "n0 object 1"
    one = load_annotations([paths[3]], chair())
    np.testing.assert_allclose(one.keypoints[0], keypoints[3], atol=1e-9)


def test_pascal3d_renames_and_refuses(tmp_path):
    path = pascal(tmp_path / "a.mat", [("chair", {"leg": anchor([3, 4], 1)})])
    read = load_annotations([path], chair(), {"leg": "left_front_foot"})
    np.testing.assert_array_equal(read.keypoints[0, 0], [2, 3])
    with pytest.raises(InvalidInputError, match="leg"):
        load_annotations([path], chair())
    with pytest.raises(InvalidInputError, match="no_such_keypoint"):
        load_annotations([path], chair(), {"leg": "no_such_keypoint"})
    bad = pascal(tmp_path / "b.mat", [("chair", {"left_front_foot": anchor(None, 1)})])
    with pytest.raises(InvalidInputError, match=r"b\.mat: object 1: left_front_foot"):
        load_annotations([bad], chair())
    (tmp_path / "c.mat").write_bytes(b"not matlab")
    with pytest.raises(InvalidInputError, match=r"c\.mat"):
        load_annotations([tmp_path / "c.mat"], chair())
    savemat(tmp_path / "d.mat", {"other": 1})
    with pytest.raises(InvalidInputError, match=r"d\.mat: record"):
        load_annotations([tmp_path / "d.mat"], chair())


def test_npz(tmp_path, keypoints):
    path = tmp_path / "a.npz"
    np.savez(path, keypoints_uv=keypoints, vehicle_id=np.arange(6) // 2, orientation=np.zeros(6))
    read = load_annotations([path], chair())
    np.testing.assert_array_equal(read.keypoints, keypoints)
    np.testing.assert_array_equal(read.vehicles, np.arange(6) // 2)
    flagged = np.concatenate([np.nan_to_num(keypoints), np.isfinite(keypoints[..., :1])], axis=2)
    np.savez(path, keypoints=flagged[:, ::-1], keypoint_names=np.array(NAMES[::-1]))
    np.testing.assert_array_equal(load_annotations([path], chair()).keypoints, keypoints)


def test_npz_refusals(tmp_path, keypoints):
    path = tmp_path / "a.npz"
    np.savez(path, keypoints=keypoints[:, :5])
    with pytest.raises(InvalidInputError, match="5 keypoints without names"):
        load_annotations([path], chair())
    np.savez(path, other=keypoints)
    with pytest.raises(InvalidInputError, match=r"a\.npz: keypoints"):
        load_annotations([path], chair())
    infinite = keypoints.copy()
    infinite[4, 2, 1] = np.inf
    np.savez(path, keypoints=infinite)
    with pytest.raises(InvalidInputError, match="instance 4: left_back_foot"):
        load_annotations([path], chair())
    np.savez(path, keypoints=keypoints, vehicle_id=np.zeros(2))
    with pytest.raises(InvalidInputError, match="vehicle_id"):
        load_annotations([path], chair())
    np.savez(path, keypoints=np.array([{}]))
    with pytest.raises(InvalidInputError, match="pickle"):
        load_annotations([path], chair())
    path.write_bytes(b"PK")
    with pytest.raises(InvalidInputError, match=r"a\.npz"):
        load_annotations([path], chair())


def test_unknown_format_no_file_and_nothing_annotated(tmp_path, keypoints):
    with pytest.raises(InvalidInputError, match="known format"):
        load_annotations([tmp_path / "a.txt"], chair())
    with pytest.raises(InvalidInputError, match="at least one"):
        load_annotations([tmp_path], chair())
    for suffix in (".json", ".npz", ".mat", ".csv"):
        with pytest.raises(InvalidInputError):
            load_annotations([tmp_path / f"absent{suffix}"], chair())
    np.savez(tmp_path / "e.npz", keypoints=np.full_like(keypoints, np.nan))
    with pytest.raises(InvalidInputError, match="no annotated keypoint"):
        load_annotations([tmp_path / "e.npz"], chair())


def test_files_of_several_formats_together(tmp_path, keypoints):
    write(tmp_path / "a.json", coco(keypoints[:4]))
    np.savez(tmp_path / "b.npz", keypoints=keypoints[4:])
    read = load_annotations([tmp_path], chair())
    np.testing.assert_array_equal(read.keypoints, keypoints)
    assert read.vehicles is None


def test_spread_is_even_over_views_and_vehicles():
    keypoints = draw_world(1, count=200, missing=0.0).keypoints
    keypoints[::7, :6] = np.nan
    views, vehicles = np.repeat([0, 1], [180, 20]), np.arange(200) % 10
    names = tuple(map(str, range(200)))
    annotations = Annotations(chair(), keypoints, names, vehicles, views)
    chosen = spread(annotations, 30, np.random.default_rng(0))
    assert len(set(chosen.tolist())) == 30
    assert annotations.measured[chosen].sum(axis=1).min() >= 8
    assert np.bincount(views[chosen]).tolist() == [15, 15]
    assert np.ptp(np.bincount(vehicles[chosen], minlength=10)) <= 2
    np.testing.assert_array_equal(chosen, spread(annotations, 30, np.random.default_rng(0)))
    with pytest.raises(InvalidInputError, match="count"):
        spread(annotations, 500, np.random.default_rng(0))


@pytest.mark.data
def test_real_files(data):
    from fgrecon.io.catalogue import load_category

    read = load_annotations([data / "veri_keypoints14/keypoints.npz"], load_category("car14"))
    assert read.keypoints.shape == (9671, 14, 2)
    assert len(np.unique(read.vehicles)) == 163
    read = load_annotations([data / "veri_keypoints36/label_train.csv"], load_category("car36"))
    assert read.keypoints.shape == (9068, 36, 2)
    assert len(np.unique(read.vehicles)) == 228
    with pytest.raises(InvalidInputError, match="36 keypoints"):
        load_annotations([data / "veri_keypoints36/label_train.csv"], load_category("car14"))


def test_veri36_names_line_image_and_keypoint(tmp_path):
    from fgrecon.io.catalogue import load_category

    good = "7_a.jpg,10,20," + ",".join("1,2,1" for _ in range(36))
    path = tmp_path / "a.csv"
    path.write_text(good + "\n" + good.replace("1,2,1,1", "1,x,1,1", 1) + "\n")
    with pytest.raises(InvalidInputError, match=r"line 2 \(7_a\.jpg\): left_"):
        load_annotations([path], load_category("car36"))
    path.write_text("a,1,2,3\n")
    with pytest.raises(InvalidInputError, match="line 1"):
        load_annotations([path], load_category("car36"))
