"""Pictures of whole images: every vehicle is named in both views, uncertainty is to scale, and nothing overlaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import position_covariance
from fgrecon.core.reconstruction import Status
from fgrecon.viz import DrawnVehicle, as_rgb, save_picture, scene_picture, style
from fgrecon.viz.describe import describe_bounds
from fgrecon.viz.from_above import DASHES, ellipse_scale
from fgrecon.viz.geometry import ellipse, level_axes
from fgrecon.viz.picture import new_figure, place_axes
from fgrecon.viz.scene_table import scene_page
from fgrecon.viz.subjects import DrawnScene
from fgrecon.viz.tags import Plates
from tests.results import changed
from tests.viz.made_up import Example
from tests.viz.scenes import GROUND, shown_of, street
from tests.viz.test_picture import failed


@pytest.fixture(scope="module")
def seen():
    return street()


@pytest.fixture
def vehicles(example: Example, seen):
    return shown_of(example, seen)


def draw(seen, vehicles, **changes):
    return scene_picture(seen.image, vehicles, seen.camera, **{"ground": GROUND} | changes)


def scene_of(vehicles, starts=()) -> DrawnScene:
    return DrawnScene(vehicles, street().camera, (1242.0, 375.0), starts=dict(starts))


def texts(axes) -> list[str]:
    return [text.get_text() for text in axes.texts if text.get_text()]


def outlines(above):
    """The closed outlines of vehicles, by their colours."""
    closed = (line for line in above.lines if len(line.get_xdata()) == 5)
    return {tuple(np.rint(np.array(line.get_color()) * 255).astype(int).tolist()): line for line in closed}


def test_it_is_a_column_wide_and_every_vehicle_is_in_both_views(seen, vehicles):
    figure = draw(seen, vehicles)
    assert figure.get_size_inches()[0] == pytest.approx(8.0 / 2.54)
    photograph, above, aside = figure.axes
    assert texts(photograph) == texts(above) == ["0", "1", "2"]
    words = texts(aside)
    assert {"0", "1", "2", "converged", "ambiguous", "95 % of position"} <= set(words)
    assert min(text.get_fontsize() for axes in figure.axes for text in axes.texts) >= 6.0


def test_plates_are_apart(seen, vehicles):
    figure = draw(seen, vehicles)
    figure.canvas.draw()
    for axes in figure.axes[:2]:
        plates = [text.get_bbox_patch().get_window_extent() for text in axes.texts if text.get_text()]
        assert len(plates) == 3
        for index, plate in enumerate(plates):
            assert not any(plate.overlaps(other) for other in plates[:index])
            assert axes.get_window_extent().overlaps(plate)


def test_crowded_plates_are_apart_and_inside():
    figure = new_figure(3.0, 2.0)
    axes = place_axes(figure, 0.0, 0.0, 3.0, 2.0)
    axes.set_xlim(0, 30)
    axes.set_ylim(0, 20)
    plates = Plates(axes, 6.0)
    for number in range(8):
        plates.put(str(number), np.array([(29.0, 19.0 - 0.1 * number)]), ((0, 1), (1, 0), (-1, 0), (0, -1)), style.INK)
    taken = np.array(plates.taken)
    for index, one in enumerate(taken):
        for other in taken[:index]:
            assert not ((np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])) > 1e-9).all()
    assert taken[:, :2].min() >= 0
    assert (taken[:, 2:] <= np.array([216.0, 144.0]) + 1e-9).all()


def test_places_from_above_are_to_scale(seen, vehicles):
    above = draw(seen, vehicles).axes[1]
    for vehicle in vehicles:
        outline = outlines(above)[style.categorical(vehicle.identity)].get_xydata()
        assert outline[:4].mean(axis=0) == pytest.approx(vehicle.result.location[[0, 2]], abs=0.05)
    (left, right), (near, far) = above.get_xlim(), above.get_ylim()
    width, height = above.get_position().size * above.figure.get_size_inches()
    assert (right - left) / width == pytest.approx((far - near) / height, rel=1e-6)
    assert near < 0 < far


def test_statuses_differ_in_their_lines(seen, vehicles):
    drawn = outlines(draw(seen, vehicles).axes[1])
    assert drawn[style.categorical(0)].get_linestyle() == "-"
    assert drawn[style.categorical(1)].get_linestyle() == "--"
    assert len({str(dashes) for dashes in DASHES.values()}) == len(Status)


def test_without_a_ground_there_is_neither_grid_nor_horizon(seen, vehicles):
    with_ground, without = (len(draw(seen, vehicles, ground=g).axes[0].collections) for g in (GROUND, None))
    assert with_ground == without + 3  # the grid, and the horizon with its casing


def test_the_horizon_is_where_the_ground_says(seen, vehicles):
    """A camera that is pitched down sees it higher; one that is level at its principal point."""
    pitch = np.radians(2.0)
    tilted = Ground(np.array([0.0, np.cos(pitch), np.sin(pitch)]), 1.65)
    rows = []
    for ground in (GROUND, tilted):
        horizon = draw(seen, vehicles, ground=ground).axes[0].collections[2].get_paths()[0].vertices
        rows.append(horizon[:, 1].mean())
    assert rows[0] == pytest.approx(seen.camera.matrix[1, 2], abs=0.1)
    assert rows[1] == pytest.approx(rows[0] - seen.camera.matrix[1, 1] * np.tan(pitch), abs=2.0)


def test_the_table_tells_what_is_known(example, seen):
    vehicles = shown_of(example, seen)
    page = scene_page(scene_of(vehicles))
    assert [row.name for row in page.rows] == ["0", "1", "2"]  # nearest first
    first = vehicles[0].result
    distance = np.linalg.norm(first.location)
    towards = first.location / distance
    sigma = np.sqrt(towards @ position_covariance(first.camera_T_object, first.uncertainty.pose_covariance) @ towards)
    assert page.rows[0].cells[0] == f"{distance:.1f} ± {1.96 * sigma:.1f}"
    assert page.rows[0].details[-1].endswith("converged")
    rough = changed(first, pose_covariance=first.uncertainty.pose_covariance * (10.5 / (1.96 * sigma)) ** 2)
    (row,) = scene_page(scene_of([replace(vehicles[0], result=rough)])).rows
    assert row.cells[0] == f"{distance:.0f} ± 10"  # no decimal that tells nothing
    many = [replace(vehicles[0], identity=number) for number in range(7)]
    assert [name for name, _ in scene_page(scene_of(many)).columns][-1] == "l [m]"
    spoken = scene_page(scene_of([replace(v, words="30 km/h") for v in vehicles]))
    assert all("30 km/h" in row.details[-1] for row in spoken.rows)


def test_class_and_score_of_a_detection_are_in_the_table(example, seen):
    vehicles = [replace(v, detection="Van 0.87") for v in shown_of(example, seen)]
    assert all(row.details[0] == "Van 0.87" for row in scene_page(scene_of(vehicles)).rows)
    many = [replace(vehicles[0], identity=number) for number in range(15)]
    assert all(row.cells[-1] == "Van 0.87" and not row.details for row in scene_page(scene_of(many)).rows)


def test_beside_errors_it_says_how_far_the_result_is_known(example, seen):
    """So that a result that is off by metres is not taken for a sure one."""
    for vehicle, row in zip(
        shown_of(example, seen, truth=True), scene_page(scene_of(shown_of(example, seen, truth=True))).rows, strict=True
    ):
        assert row.details[-1] == describe_bounds(vehicle.result)
    assert row.details[-1].startswith("95 %: ± ")


@pytest.mark.parametrize("count", [3, 15])
def test_axis_labels_are_within_the_picture_and_all_vehicles_in_the_table(example, seen, count):
    vehicles = [replace(shown_of(example, seen)[0], identity=number) for number in range(count)]
    figure = draw(seen, vehicles)
    figure.canvas.draw()
    above = figure.axes[1]
    everything = above.get_tightbbox()
    assert everything.x0 >= figure.bbox.x0 + 1
    assert everything.y0 >= figure.bbox.y0 + 1
    assert not any("more" in text for text in texts(figure.axes[2]))


def test_the_label_of_an_axis_with_long_numbers_is_within_the_picture(seen, vehicles):
    result = vehicles[0].result
    moved = result.camera_T_object.copy()
    moved[:3, 3] *= 130.0 / moved[2, 3]
    figure = draw(seen, [*vehicles[1:], replace(vehicles[0], result=changed(result, camera_T_object=moved))])
    figure.canvas.draw()
    above = figure.axes[1]
    assert "100" in [text.get_text() for text in above.get_yticklabels()]
    label = above.yaxis.label.get_window_extent()
    assert label.x0 >= figure.bbox.x0 + 1
    assert not any(label.overlaps(text.get_window_extent()) for text in above.get_yticklabels() if text.get_text())


def test_regions_of_many_vehicles_are_thin_and_in_their_colours(example, seen):
    first = shown_of(example, seen)[0]
    widths = {}
    for count in (3, 15):
        rings = [
            line
            for line in draw(seen, [replace(first, identity=number) for number in range(count)]).axes[1].lines
            if len(line.get_xdata()) > 20
        ]
        assert len(rings) == count
        widths[count] = rings[0].get_linewidth()
        assert len({tuple(ring.get_color()) for ring in rings}) == (
            1 if count == 3 else len({tuple(style.categorical(n)) for n in range(15)})
        )
    assert widths[15] < widths[3]


def test_what_is_not_known_is_a_word(example, seen):
    """A spread that is more than the value can be off says nothing; far away there is no room for decimals."""
    first = shown_of(example, seen)[0]
    pose = first.result.camera_T_object.copy()

    def cells(turn, along, scale=1.0):
        covariance = np.diag([0.0, np.radians(turn) ** 2, 0.0, *[along**2] * 3])
        there = pose.copy()
        there[:3, 3] *= scale
        result = changed(first.result, camera_T_object=there, pose_covariance=covariance)
        return scene_page(scene_of([replace(first, result=result)])).rows[0].cells

    distance = float(np.linalg.norm(pose[:3, 3]))
    assert cells(1.0, distance) == ("unknown", cells(1.0, 0.1)[1])
    assert cells(95.0, 0.1) == (cells(1.0, 0.1)[0], "unknown")
    assert cells(1.0, 20.0, 150.0 / distance)[0] == "150 ± 39"


def test_a_pose_that_is_not_determined_is_its_2d_box(seen, vehicles):
    """Though it has one, which may be anywhere: its lines are neither in the photograph nor seen from above."""
    nowhere = vehicles[0].result.camera_T_object.copy()
    nowhere[:3, 3] = (0.0, 1.0, 2.0)
    lost = changed(vehicles[0].result, status=Status.DEGENERATE, camera_T_object=nowhere)
    figure = draw(seen, [replace(vehicles[0], result=lost), *vehicles[1:]])
    without = draw(seen, [replace(vehicles[0], result=None), *vehicles[1:]])
    assert texts(figure.axes[1]) == ["1", "2"]
    np.testing.assert_array_equal(*(as_rgb(drawn, 100)[:90] for drawn in (figure, without)))  # the photograph
    assert {"degenerate", "no pose: 2D box"} <= set(texts(figure.axes[2]))


def test_with_the_truth_it_tells_the_gain(example, seen):
    vehicles = shown_of(example, seen, truth=True)
    starts = {v.identity: v.result.diagnostics.history[0].camera_T_object for v in vehicles}
    assert scene_page(scene_of(vehicles, starts)).rows[0].cells == ("3.00 → 0.30", "0.0 → 0.0")
    figure = draw(seen, vehicles, before=True)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["Start", "Result", "", ""]
    assert {"start", "truth"} <= set(texts(figure.axes[3]))
    for start in starts.values():  # they are within the view from above
        assert start[2, 3] + 2.0 < figure.axes[2].get_ylim()[1]


@pytest.mark.parametrize("count", [3, 9])
@pytest.mark.parametrize(("before", "detection"), [(False, ""), (True, ""), (False, "truck 0.87")])
def test_no_text_of_the_table_covers_another(example, seen, count, before, detection):
    vehicles = shown_of(example, seen, truth=before)
    vehicles = [replace(vehicles[number % 3], identity=number, detection=detection) for number in range(count)]
    figure = draw(seen, vehicles, before=before)
    figure.canvas.draw()
    places = [text.get_window_extent() for text in figure.axes[-1].texts if text.get_text()]
    assert len(places) > 3 * count
    for index, place in enumerate(places):
        assert not any(place.shrunk(0.99, 0.7).overlaps(other.shrunk(0.99, 0.7)) for other in places[:index])
        assert place.x1 <= figure.bbox.x1 + 1


def test_the_legend_of_enlarged_ellipses_is_within_the_picture(seen, vehicles):
    tiny = [replace(v, result=changed(v.result, pose_covariance=np.eye(6) * 1e-6)) for v in vehicles]
    figure = draw(seen, tiny)
    figure.canvas.draw()
    (line,) = (text for text in figure.axes[-1].texts if text.get_text().startswith("95 %"))
    assert line.get_text() == "95 % of position (20 ×)"
    assert line.get_window_extent().x1 <= figure.bbox.x1 - 1


def test_what_was_not_solved_has_its_box(example, seen, vehicles):
    lost = [vehicles[0], replace(vehicles[1], result=failed(example)), replace(vehicles[2], result=None, name="far")]
    figure = draw(seen, lost)
    assert set(texts(figure.axes[0])) == {"0", "1", "far"}
    assert texts(figure.axes[1]) == ["0"]
    assert {"failed", "refused", "no pose: 2D box"} <= set(texts(figure.axes[2]))
    nothing = draw(seen, lost[1:])
    assert as_rgb(nothing, 60).std() > 10


def test_a_vehicle_that_is_nowhere_leaves_room_for_the_others(seen, vehicles):
    pose = vehicles[1].result.camera_T_object.copy()
    pose[2, 3] = 1e6
    figure = draw(seen, [vehicles[0], replace(vehicles[1], result=changed(vehicles[1].result, camera_T_object=pose))])
    assert figure.axes[1].get_ylim()[1] < 400
    assert texts(figure.axes[1]) == ["0", "1"]  # at the border
    assert as_rgb(figure, 60).std() > 10


def test_a_long_table_says_how_many_are_left_out(seen, vehicles):
    many = [replace(vehicles[0], identity=number) for number in range(60)]
    figure = draw(seen, many)
    aside = figure.axes[2]
    words = texts(aside)
    left = next(int(text.split()[1]) for text in words if text.startswith("and "))
    assert sum(text.isdigit() for text in words) + left == 60
    lowest = max(text.get_position()[1] for text in aside.texts)
    assert lowest < max(aside.get_ylim())


def test_trails_and_portraits(example, seen, vehicles):
    """A frame of a video, in an image that is higher than wide."""
    trail = np.linspace((0.0, 1.65, 20.0), (2.0, 1.65, 12.0), 8)
    portrait = Camera(seen.camera.matrix, image_size=(600, 900))
    figure = scene_picture(None, [replace(vehicles[0], trail=trail, words="30 km/h")], portrait)
    paths = [line.get_xydata() for line in figure.axes[1].lines if len(line.get_xdata()) == 8]
    assert np.allclose(paths[0], trail[:, [0, 2]])
    assert figure.get_size_inches()[1] < 14 / 2.54


def test_for_a_slide_the_view_from_above_is_beside_the_photograph(seen, vehicles):
    figure = draw(seen, vehicles, beside=True)
    width, height = figure.get_size_inches()
    assert width > 2 * 8.0 / 2.54
    assert width > 2.5 * height
    photograph, above, aside = (axes.get_position() for axes in figure.axes)
    assert photograph.x1 < above.x0 < above.x1 < aside.x0
    assert above.y0 > 0


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_files(seen, vehicles, tmp_path, kind):
    path = save_picture(tmp_path / f"scene.{kind}", draw(seen, vehicles))
    assert path.read_bytes() == save_picture(tmp_path / f"again.{kind}", draw(seen, vehicles)).read_bytes()
    if kind == "png":
        from fgrecon.io.images import read_image

        assert read_image(path).shape[1] >= 1240  # the photograph keeps its pixels


def test_bad_input_is_named(seen, vehicles):
    with pytest.raises(InvalidInputError, match="vehicles"):
        draw(seen, [])
    with pytest.raises(InvalidInputError, match="id of its own"):
        draw(seen, [vehicles[0], vehicles[0]])
    with pytest.raises(InvalidInputError, match="image"):
        scene_picture(seen.image[..., 0], vehicles, seen.camera)


def test_axes_of_the_ground():
    for normal in ([0.0, 1.0, 0.0], [0.1, 0.95, 0.2], [0.0, 0.05, 0.9987]):
        ground = Ground(np.array(normal), 2.0)
        axes = level_axes(ground)
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert axes[1] == pytest.approx(ground.normal)
    assert np.array_equal(level_axes(None), np.eye(3))


def test_covariance_of_the_position_is_in_the_camera_frame():
    """A vehicle that faces right and is uncertain along its own forward axis is so along the camera's x axis."""
    pose, covariance = np.eye(4), np.diag([0.0, 0, 0, 4.0, 1.0, 0.25])
    assert position_covariance(pose, covariance) == pytest.approx(np.diag([4.0, 1.0, 0.25]))
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    pose[:3, :3] = quarter
    assert position_covariance(pose, covariance) == pytest.approx(np.diag([0.25, 1.0, 4.0]))


def test_ellipses_are_as_large_as_said(vehicles):
    outline = ellipse(np.array([[4.0, 0.0], [0.0, 0.25]]), 2.0, 360)
    assert np.ptp(outline, axis=0) == pytest.approx([8.0, 2.0], abs=1e-3)
    assert ellipse_scale(scene_of(vehicles), 0.1) == 1.0
    tiny = [replace(v, result=changed(v.result, pose_covariance=np.eye(6) * 1e-6)) for v in vehicles]
    assert ellipse_scale(scene_of(tiny), 5.0) == 20.0
    unknown = [replace(v, result=changed(v.result, pose_covariance=None)) for v in vehicles]
    assert ellipse_scale(scene_of(unknown), 5.0) == 1.0
    assert isinstance(vehicles[0], DrawnVehicle)
