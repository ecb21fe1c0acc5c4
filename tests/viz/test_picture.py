"""Pictures: the panels hold what they say, every format is written whole, and nothing global is touched."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Status
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Side
from fgrecon.viz import SolvedVehicle, as_rgb, contact_sheet, picture, save_picture, style
from fgrecon.viz.describe import describe_errors
from tests.results import changed
from tests.viz.made_up import Example


def draw(example: Example, **changes):
    sight = SolvedVehicle(example.reconstruction, example.observation, example.camera, example.image, example.truth)
    return picture(replace(sight, **changes))


def failed(example: Example):
    return changed(
        example.reconstruction,
        status=Status.FAILED,
        message="every keypoint lies on one line",
        camera_T_object=np.full((4, 4), np.nan),
        wireframe=np.full_like(example.reconstruction.wireframe, np.nan),
        wireframe_uv=np.full_like(example.reconstruction.pose.wireframe_uv, np.nan),
        box_size=np.full(3, np.nan),
        history=(),
        surface_vertices=None,
        surface_faces=None,
    )


def pixels_of(image: np.ndarray, colour: tuple[int, int, int], tolerance: int = 12) -> int:
    return int((np.abs(image.astype(int) - colour).max(axis=-1) <= tolerance).sum())


def titles(figure) -> list[str]:
    return [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]


def texts(figure) -> list[str]:
    inside = [text.get_text() for axes in figure.axes for text in axes.texts]
    return inside + [text.get_text() for text in figure.texts]


def test_panels_are_those_of_the_paper(example: Example) -> None:
    figure = draw(example)
    assert titles(figure) == [
        "Initial",
        "After pose adjustment",
        "After shape and joint adjustment",
        "In 3D",
        "From above",
    ]
    written = texts(figure)
    history = example.reconstruction.diagnostics.history
    last_pose = [step for step in history if step.stage == "pose"][-1]
    for step in (history[0], last_pose, history[-1]):
        assert describe_errors(example.truth, step.camera_T_object, step.keypoints) in written
    caption = " ".join(written[-1].split())
    assert caption.startswith("Converged: the energy changed by less than 1e-9 of itself.")
    assert "Error against the truth: yaw 0.0°, position 0.00 m" in caption


def test_left_right_truth_and_residuals_are_seen(example: Example) -> None:
    image = as_rgb(draw(example, image=None))
    for colour in (*(SIDE_COLOURS[side] for side in Side), style.TRUTH, style.INK):
        assert pixels_of(image, colour) > 100, colour
    bare = as_rgb(draw(example, image=None, truth=None))
    assert pixels_of(bare, style.TRUTH, 2) < 0.02 * pixels_of(image, style.TRUTH, 2)


def test_the_photograph_is_shown_where_it_belongs(example: Example) -> None:
    """A patch of one colour lies under the axes' own coordinates, pixel centres at integers."""
    panel = draw(example, image=None).axes[0]
    u, v = int(panel.get_xlim()[0]) + 20, int(panel.get_ylim()[1]) + 20
    image = np.zeros_like(example.image)
    image[v : v + 10, u : u + 10] = (255, 0, 255)
    figure = draw(example, image=image)
    seen = as_rgb(figure)

    def at(x: float, y: float) -> tuple[int, ...]:
        right, up = figure.axes[0].transData.transform((x, y))
        return tuple(seen[int(seen.shape[0] - up), int(right)].tolist())

    for inside in ((u + 0.7, v + 0.7), (u + 8.3, v + 8.3)):
        assert at(*inside) == (255, 0, 255)
    for outside in ((u - 1.7, v + 4), (u + 10.7, v + 4), (u + 4, v - 1.7), (u + 4, v + 10.7)):
        assert at(*outside) == (0, 0, 0)


def test_arguments_are_left_as_they_were(example: Example) -> None:
    before = example.image.copy(), example.observation.keypoints.copy(), example.reconstruction.wireframe.copy()
    as_rgb(draw(example))
    after = example.image, example.observation.keypoints, example.reconstruction.wireframe
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(before, after, strict=True))


def test_a_failed_result_shows_the_keypoints_and_the_reason(example: Example) -> None:
    figure = draw(example, reconstruction=failed(example))
    assert titles(figure) == ["Initial", "After pose adjustment", "After shape adjustment"]
    written = texts(figure)
    assert written.count("no estimate") == 3
    assert written[-1] == "Failed: every keypoint lies on one line."
    assert as_rgb(figure).std() > 0


def test_a_result_without_history_says_so(example: Example) -> None:
    figure = draw(example, reconstruction=changed(example.reconstruction, history=()))
    assert texts(figure).count("not recorded") == 2


def test_a_bare_result_is_drawn(example: Example) -> None:
    bare = changed(example.reconstruction, surface_vertices=None, surface_faces=None, keypoint_covariance=None)
    nothing = np.full_like(example.observation.keypoints, np.nan)
    observation = replace(example.observation, keypoints=nothing, box=None)
    figure = draw(example, reconstruction=bare, observation=observation, image=None, truth=None)
    assert pixels_of(as_rgb(figure), SIDE_COLOURS[Side.LEFT]) > 100


def test_the_3d_view_takes_the_corner_that_the_camera_sees(example: Example) -> None:
    corners = {}
    for name, turn in (("front left", 0.0), ("rear right", np.pi)):
        pose = example.reconstruction.camera_T_object.copy()
        pose[:3, :3] = pose[:3, :3] @ np.array(
            [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
        )
        eye = -pose[:3, :3].T @ pose[:3, 3]
        corners[name] = f"{'front' if eye[0] > 0 else 'rear'} {'left' if eye[2] > 0 else 'right'}"
        figure = draw(example, reconstruction=changed(example.reconstruction, camera_T_object=pose), truth=None)
        assert f"from the {corners[name]}" in texts(figure)
    assert len(set(corners.values())) == 2


@pytest.mark.parametrize(
    ("name", "magic"),
    [("a.png", b"\x89PNG"), ("a.svg", b"<?xml"), ("a.pdf", b"%PDF"), ("a.jpg", b"\xff\xd8"), ("a.JPEG", b"\xff\xd8")],
)
def test_every_format_is_written_and_is_the_same_again(
    example: Example, tmp_path: Path, name: str, magic: bytes
) -> None:
    first = save_picture(tmp_path / name, draw(example), dpi=60).read_bytes()
    again = save_picture(tmp_path / name, draw(example), dpi=60).read_bytes()
    assert first.startswith(magic)
    assert first == again
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(("name", "fix"), [("a.bmp", "end in one of"), ("a", "end in one of"), ("no/a.png", "folder")])
def test_a_path_that_cannot_be_written_is_refused(example: Example, tmp_path: Path, name: str, fix: str) -> None:
    with pytest.raises(InvalidInputError, match=fix):
        save_picture(tmp_path / name, draw(example), dpi=30)
    assert not list(tmp_path.iterdir())


def test_an_image_of_another_kind_is_refused(example: Example) -> None:
    with pytest.raises(InvalidInputError, match="image"):
        draw(example, image=example.image.astype(float))


def test_resolution_follows_the_dots_per_inch(example: Example) -> None:
    figure = draw(example, image=None)
    small, large = as_rgb(figure, dpi=50), as_rgb(figure, dpi=100)
    assert small.dtype == np.uint8
    assert large.shape == (small.shape[0] * 2, small.shape[1] * 2, 3)


def test_contact_sheet_has_a_cell_for_each_vehicle(example: Example) -> None:
    sight = SolvedVehicle(
        example.reconstruction, example.observation, example.camera, example.image, example.truth, "first"
    )
    ambiguous = replace(sight, reconstruction=replace(example.reconstruction, status=Status.AMBIGUOUS), title="second")
    lost = replace(sight, reconstruction=failed(example), image=None, title="")
    figure = contact_sheet([sight, ambiguous, lost], columns=2)
    assert titles(figure) == ["first", "second, ambiguous", "failed"]
    image = as_rgb(figure)
    assert pixels_of(image[: len(image) // 2], style.TRUTH, 30) > 20
    corner = image[-len(image) // 3 :, -image.shape[1] // 3 :]
    assert (corner == 255).all()  # the fourth cell of two rows stays empty


def test_contact_sheet_refuses_nothing_to_draw(example: Example) -> None:
    sight = SolvedVehicle(example.reconstruction, example.observation, example.camera)
    with pytest.raises(InvalidInputError, match="vehicles"):
        contact_sheet([])
    with pytest.raises(InvalidInputError, match="columns"):
        contact_sheet([sight], columns=0)


def test_pyplot_is_never_loaded() -> None:
    code = (
        "import sys\n"
        "from tests.viz.made_up import make_example\n"
        "from fgrecon.viz import SolvedVehicle, picture, as_rgb\n"
        "e = make_example()\n"
        "as_rgb(picture(SolvedVehicle(e.reconstruction, e.observation, e.camera)), dpi=30)\n"
        "print('matplotlib.pyplot' in sys.modules)\n"
    )
    out = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"
