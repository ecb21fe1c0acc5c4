"""The paper's tables, claims and page from made-up scores whose results are known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import Objects
from fgrecon.viz import save_picture
from fgrecon_research.evaluation import report
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.paper.claims import Claim, claims, decoupling_claim, irls_claim, ranking_claim
from fgrecon_research.paper.documents import document, markdown
from fgrecon_research.paper.known_shape import KNOWN_SHAPE_ROWS, KnownShapeScores
from fgrecon_research.paper.network import read_hand_labels
from fgrecon_research.paper.run import PaperEvaluation, _posed
from fgrecon_research.paper.simulated_scores import CHAIN_ROWS, MAIN_ROWS, Scores
from fgrecon_research.paper.tables import (
    Table,
    aop_table,
    decoupling_table,
    known_shape_tables,
    mae_table,
    ms_table,
    per_part_table,
    simulated_parts,
    stage_table,
)
from fgrecon_research.viz.paper_picture import paper_picture


def made_up(rows, count=40, errors=None):
    """Scores of `count` cars, all Hard, half of them Easy and Moderate; the last tenth has no detection."""
    size, width = 14, len(rows)
    missing = np.arange(count) >= count - count // 10
    regimes = np.ones((count, 3), dtype=bool)
    regimes[::2, :2] = False
    orientation = (
        np.zeros((count, width)) if errors is None else np.tile([errors.get(row, 0.0) for row in rows], (count, 1))
    )
    nothing = np.where(missing[:, None], np.inf, 0.0) * np.ones(width)
    return Scores(
        frame=np.array([f"{i // 4:06d}" for i in range(count)]),
        index=np.arange(count) % 4,
        regimes=regimes,
        detection=np.where(missing, -1, np.arange(count) % 4),
        visible=np.ones((count, size), dtype=bool),
        measured=np.where(missing[:, None], np.inf, 0.05) * np.ones(size),
        yaw=np.where(missing[:, None], np.nan, 0.3) * np.ones(width),
        location=np.where(missing[:, None, None], np.nan, [1.0, 1.65, 10.0]) * np.ones((count, width, 1)),
        size=np.where(missing[:, None, None], np.nan, [4.0, 1.7, 1.5]) * np.ones((count, width, 1)),
        orientation=np.where(missing[:, None], 180.0, orientation),
        translation=np.where(nothing == 0, 0.5, np.inf),
        reprojection=np.where(missing[:, None, None], np.inf, 0.01) * np.ones((count, width, size)),
        shape=np.where(nothing == 0, 0.1, np.inf),
        from_mean=np.where(nothing == 0, 0.2, np.inf),
        from_start=np.where(nothing == 0, 2.0, np.inf),
        from_before=np.where(nothing == 0, 0.05, np.inf),
        failures=np.array([], dtype=np.str_),
    )


ERRORS = {"aspnp+size": 20.0, "aspnp_irls+size": 10.0, "poselib_ransac+size": 4.0, "sqpnp_confident+size": 10.0}
ERRORS |= {"epnp+size": 40.0, "sqpnp+size": 35.0, "fgrecon+size": 1.0, "pose": 1.0, "initialisation": 8.0}


@pytest.fixture(scope="module")
def scores():
    return made_up(MAIN_ROWS, errors=ERRORS)


@pytest.fixture(scope="module")
def known():
    count, width = 6, len(KNOWN_SHAPE_ROWS)
    values = np.tile(np.arange(count, dtype=float)[:, None], (1, width))
    distance = np.array([10.0, 15, 25, 35, 45, 60])
    return KnownShapeScores(
        tuple("abcdef"), distance, np.array([5, 5, 5, 6, 6, 6]), values, values / 100, values / 100, ()
    )


def test_undetected_cars_are_wrong_at_every_threshold(scores):
    table = aop_table("table_1", "I", scores, MAIN_ROWS, "")
    rows = dict(table.rows)
    # 20 Easy cars (odd places), of which places 37 and 39 have no detection.
    assert rows["fgrecon, pose stage"][0].value == pytest.approx(90.0)
    assert [cell.value for cell in rows["ASPnP"][:3]] == [0.0, 0.0, 90.0]
    assert rows["paper: Pose adjustment"][0] == 53.62


def test_errors_are_those_of_the_detected_cars(scores):
    rows = dict(mae_table("table_3", "III", scores, MAIN_ROWS, "").rows)
    assert [cell.value for cell in rows["ASPnP"][:3]] == [20.0, 20.0, 20.0]
    assert rows["ASPnP"][3:6] == (20.0, 20.0, 20.0)
    assert rows["ASPnP"][6:] == (0.5, 0.5, 0.5)
    assert rows["paper: ASPnP"][:3] == (98.17, 98.82, 98.83)


def test_stages_and_decoupling(scores):
    rows = dict(stage_table(scores, MAIN_ROWS).rows)
    assert rows["fgrecon, pose stage"][0].value == 100.0
    assert rows["fgrecon, pose stage"][3].value == 2.0
    assert rows["between pose and shape stage"][3].value == pytest.approx(0.05)
    assert rows["paper: Shape adjustment"][:6] == (80.72, 81.81, 71.39, 3.75, 4.69, 4.83)
    both = decoupling_table(scores, MAIN_ROWS, made_up(CHAIN_ROWS), CHAIN_ROWS)
    assert len(both.rows) == 6
    assert dict(both.rows)["fgrecon, then both jointly"][4].value == pytest.approx(10.0)


def test_known_shapes_by_distance_and_marks(known):
    whole, parts = known_shape_tables(known, "note")
    assert dict(whole.rows)["joint"][0].value == 2.5
    rows = dict(parts.rows)
    assert rows["joint, nearer than 20 m (2)"][0].value == 0.5
    assert rows["joint, beyond 40 m (2)"][2].value == 4.5
    assert rows["joint, 6 keypoints marked (3)"][1].value == 4.0


def test_the_claim_about_irls_follows_the_numbers(scores):
    text = str(irls_claim(scores, MAIN_ROWS))
    assert "more than 90 %': refuted" in text
    assert "ASPnP + IRLS (paper's), Eqs. 4 and 5: 50 / 50 / 50 %." in text
    assert "fgrecon, pose stage, the same with the ground: 95 / 95 / 95 %." in text
    assert "91 / 87 / 84 %" in text  # what the paper prints
    better = made_up(MAIN_ROWS, errors={**ERRORS, "aspnp_irls+size": 1.5})
    assert "more than 90 %': confirmed" in irls_claim(better, MAIN_ROWS).heading


def test_the_ranking_names_who_is_not_beaten(scores):
    text = str(ranking_claim(scores, MAIN_ROWS))
    assert "fgrecon, pose stage beats every baseline" not in text  # all are equal at 30 degrees
    clear = made_up(
        MAIN_ROWS,
        errors={**dict.fromkeys(MAIN_ROWS, 40.0), "pose": 1.0, "poselib_ransac+size": 3.0, "fgrecon+size": 1.0},
    )
    clear = replace(
        clear,
        orientation=np.where(
            np.arange(len(clear))[:, None] == 1,
            [[0.0 if row in ("pose", "fgrecon+size") else 90.0 for row in MAIN_ROWS]],
            clear.orientation,
        ),
    )
    text = str(ranking_claim(clear, MAIN_ROWS))
    assert "fgrecon, pose stage beats every baseline at every threshold and regime" in text
    assert "ASPnP + IRLS (paper's) does not beat" in text
    assert "PoseLib RANSAC" in text


def test_the_claim_about_decoupling_compares_sequence_and_joint(scores):
    joint = made_up(MAIN_ROWS, errors={**ERRORS, "sequential": 1.25, "joint": 1.5})
    text = str(decoupling_claim(joint, MAIN_ROWS, made_up(CHAIN_ROWS, errors={"paper_sequential": 9.0}), CHAIN_ROWS))
    assert "1.25 against 1.50 degrees" in text
    assert "9.00 against 0.00 degrees" in text
    assert "by 0.05 m on average, the pose stage by 2.0 m" in text


def test_of_no_car_nothing_is_claimed(scores):
    chain = made_up(CHAIN_ROWS)
    assert len(claims(scores, MAIN_ROWS, chain, CHAIN_ROWS)) == 3
    empty = replace(scores, regimes=scores.regimes & [False, True, True])
    (claim,) = claims(empty, MAIN_ROWS, chain, CHAIN_ROWS)
    assert "nothing can be said" in claim.heading


def test_what_is_said_of_the_claims_is_said_in_short_sentences(scores):
    for claim in claims(scores, MAIN_ROWS, made_up(CHAIN_ROWS), CHAIN_ROWS):
        assert all(len(sentence) < 160 and sentence[-1] in ".:" for sentence in claim.sentences)


def test_cells_as_text_and_as_json():
    cells = (Interval(50.0, 40.0, 62.0), 3, None, float("inf"))
    table = Table("key", "title", "", ("a", "b", "c", "d"), (("row", cells),))
    assert [table.text(cell) for cell in cells] == ["50.0 ±11.0", "3", "-", "-"]
    content = table.document()
    assert content["rows"]["row"] == [{"value": 50.0, "low": 40.0, "high": 62.0}, 3.0, None, None]
    json.dumps(content, allow_nan=False)


_DEFECTS = tuple(f"missing frame: {number:06d}" for number in range(25))


@pytest.fixture(scope="module")
def tables(scores, known, scene):
    category = scene.prior.category
    return (
        aop_table("table_1", "Table I", scores, MAIN_ROWS, "note <1>"),
        ms_table({"fgrecon, pose stage": [1.0, 3.0]}, 0.5),
        per_part_table("per_part", "Parts", "", simulated_parts(scores, MAIN_ROWS), category),
        per_part_table("per_part_real", "Real parts", "", {"keypoint network": np.full(14, np.nan)}, category),
        *known_shape_tables(known, ""),
    )


@pytest.fixture(scope="module")
def page(tables):
    speed = {"instances": 30.0, "seconds": 10.0, "per_second": 3.0}
    return PaperEvaluation(
        ("conditions",),
        (Claim("a claim", ("A sentence.",)),),
        tables,
        {"missing frame": 5},
        _DEFECTS,
        ("000001:0: no luck",),
        speed,
    )


def test_markdown_has_every_table_and_claim(page):
    text = markdown(page)
    assert all(f"## {table.title}\n" in text for table in page.tables)
    assert "**a claim**\n\n- A sentence.\n" in text
    lines = [line for line in text.splitlines() if line.startswith("| fgrecon, pose stage")]
    assert lines[0].count("|") == 11
    assert "| fgrecon, pose stage | 2.00 | 2.00 |" in text


def test_the_picture_has_the_tables_numbers_and_their_intervals(tables, tmp_path):
    drawn = [table for table in tables if table.key in ("table_1", "per_part", "per_part_real")]
    figure = paper_picture(tables)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [table.title for table in drawn]
    for axes, table in zip(figure.axes, drawn, strict=True):
        columns = [i for i, name in enumerate(table.columns) if table.key != "table_1" or name.endswith(" ≤5°")]
        cells = [row[i] for i in columns for _, row in table.rows]
        values = [np.nan if cell is None else getattr(cell, "value", cell) for cell in cells]
        np.testing.assert_array_equal([bar.get_height() for bar in axes.patches], values)
        tops = [ends[1, 1] for line in axes.collections for ends in line.get_segments() if len(ends)]
        highs = np.array([getattr(cell, "high", cell) for cell in cells], dtype=float)
        np.testing.assert_allclose(tops, highs[np.isfinite(highs)])
    first, second = (save_picture(tmp_path / n, paper_picture(tables)).read_bytes() for n in ("a.svg", "b.svg"))
    assert first == second


def test_the_document_is_json_with_machine_and_versions(page):
    content = json.loads(report.to_json(document(page, {"seed": 0})))
    assert content["machine"]["cores"] >= 1
    assert content["versions"]["gtsam"]
    assert content["tables"]["table_1"]["rows"]["paper: Mono3D"][0] == 42.20
    assert content["settings"] == {"seed": 0}


def test_detections_with_poses_become_kitti_results():
    found = Objects.detections(
        ["Pedestrian", "Car", "Car"], np.tile([0.0, 0, 50, 40], (3, 1)), np.array([0.5, 0.9, 0.8])
    )
    scores = made_up(("joint",), count=4)
    scores = replace(scores, detection=np.array([2, -1, -1, -1]))
    cars = _posed(found, scores, "000000", 0)
    assert cars.kind == ("Car", "Car")
    assert cars.rotation_y.tolist() == [-10.0, 0.3]
    assert cars.alpha == pytest.approx([0.0, 0.3 - np.arctan2(1.0, 10.0)])
    assert cars.location[1].tolist() == [1.0, 1.65, 10.0]
    assert found.rotation_y.tolist() == [-10.0] * 3  # the detections are as before


def test_hand_labels_without_a_car_or_of_an_unlabelled_one_are_refused(tmp_path, scene):
    (tmp_path / "training" / "label_2").mkdir(parents=True)
    (tmp_path / "training" / "label_2" / "000003.txt").write_text("")
    path, size = tmp_path / "marks.json", scene.prior.category.size
    mark = {"frame": "000003", "object_index": 2, "regime": "easy", "box_xyxy": [0, 0, 9, 9]}
    mark |= {"keypoints_uv": [[1, 1]] * size, "visible": [True] * size}
    for marks, field in (([], "marks.json"), ([mark], "object_index")):
        path.write_text(json.dumps(marks))
        with pytest.raises(InvalidInputError, match=field):
            read_hand_labels(path, tmp_path, scene.prior.category)


@pytest.mark.data
def test_hand_labels_become_tracks_of_one_frame(data, scene):
    path = data / "hand_labels" / "kitti_object_keypoints14.json"
    tracks = read_hand_labels(path, data / "kitti_object", scene.prior.category)
    assert len(tracks) == 31
    frame = tracks[0].frames[0]
    assert frame.name == "000003:0"
    marked = frame.observation.measured
    assert marked.sum() == frame.observation.confidence.sum()
    points = frame.truth.location + tracks[0].label_offset
    u = tracks[0].camera.project(points)[0]
    assert frame.observation.box[0] < u < frame.observation.box[2]


def test_the_command_names_data_that_is_absent(tmp_path):
    result = CliRunner().invoke(app, ["evaluate", "paper", "--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert result.exit_code != 0
    assert "apollo79" in str(result.exception)
