"""The whole training on made-up photographs: two steps, labels corrected between them, calibration, scores."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fgrecon.core.coverage import reliability
from fgrecon.core.errors import DamagedFileWarning, InvalidInputError
from fgrecon.io.images import write_png
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.network_file import Stored, save_weights
from fgrecon_research.training.keypoints.calibrate import calibrate
from fgrecon_research.training.keypoints.evaluate import azimuth_errors, localisation, marks_reliability, score_marks
from fgrecon_research.training.keypoints.marks import Mark
from fgrecon_research.training.keypoints.trainer import load_checkpoint, load_tensors
from research.tests.training.keypoints.support import made_up_cars, unit_car_prior

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.layout import KNetSettings, RefineSettings  # noqa: E402
from fgrecon_research.training.keypoints.augment import Street  # noqa: E402
from fgrecon_research.training.keypoints.knet import KNet  # noqa: E402
from fgrecon_research.training.keypoints.labelling import (  # noqa: E402
    Labelling,
    Source,
    corrected,
    first_labelling,
    open_photographs,
)
from fgrecon_research.training.keypoints.rounds import Beginning, _as_detector, train_in_rounds  # noqa: E402
from fgrecon_research.training.keypoints.train import HeldOut, Training  # noqa: E402
from fgrecon_research.training.keypoints.train_refine import RefineNet  # noqa: E402

SMALL = KNetSettings(crop=32, width=8)


class Display:
    """Keeps what it is to show."""

    def __init__(self):
        self.logged, self.reports, self.headings = [], [], []
        self.log, self.report = self.logged.append, self.reports.append

    def progress(self, things, heading):
        self.headings.append((heading, len(things)))
        return things


HOW = Training(steps=2, batch=2, warmup=1, save_every=1, workers=0, network=SMALL, street=Street(size=32))


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cars")
    rng, prior = np.random.default_rng(0), unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 6, rng, folder)
    cars = [replace(car, cad_id="ab"[i // 3]) for i, car in enumerate(cars)]
    for car in cars:
        write_png(car.image, rng.integers(0, 255, (*car.size[::-1], 3)).astype(np.uint8))
    return Source(cars, np.arange(4), np.arange(4, 6), prior)


@pytest.fixture(scope="module")
def detector(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    return KeypointCascade(
        save_weights(path, Stored(KNet(SMALL).state_dict(), SMALL.to_dict(), ConfidenceCalibration(), {}))
    )


@pytest.fixture(scope="module")
def trained(source, tmp_path_factory):
    folder, display = tmp_path_factory.mktemp("work"), Display()
    result = train_in_rounds(source, folder, HOW, [1], display=display)
    return folder, display.logged, display.reports, result


def test_rounds_correct_labels_and_go_on(trained, source):
    folder, logged, reports, (_, labelling, photographs) = trained
    assert [report.step for report in reports] == [1, 2]
    assert len(logged) == 4
    names = ["labels-0.npz", "labels-1.npz", "labels-first.npz"]
    assert sorted(path.name for path in folder.glob("labels-*.npz")) == names
    assert set(labelling.fits) == {"a", "b"}
    assert np.isfinite(photographs.keypoints).all()


def test_a_finished_training_is_not_done_again(trained, source):
    folder, _, _, (network, _, _) = trained
    display = Display()
    again, _, _ = train_in_rounds(source, folder, HOW, [1], display=display)
    assert display.reports == []
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, again.state_dict()[name])


def test_every_report_has_a_score_that_changes_nothing(trained, source, tmp_path):
    _, _, reports, (network, _, _) = trained
    assert reports
    assert all(0.0 <= report.score <= 1.0 for report in reports)
    blind, display = replace(source, validate=np.arange(0)), Display()
    other, _, _ = train_in_rounds(blind, tmp_path, HOW, [1], display=display)
    assert [report.score for report in display.reports] == [None, None]
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, other.state_dict()[name])
    first, found, again = ("Shapes of boxes and silhouettes", 2), ("Keypoints in all photographs", 1), "Shapes of what"
    assert display.headings[:3] == [first, ("Photographs", 6), found]
    assert display.headings[3][0].startswith(again)


def test_the_score_is_the_share_of_visible_points_that_are_near(trained, source):
    photographs = trained[3][2]
    held = HeldOut.draw(photographs, source.validate, HOW.street, source.prior.category.mirror, 0, count=40)
    again = HeldOut.draw(photographs, source.validate, HOW.street, source.prior.category.mirror, 0, count=40)
    np.testing.assert_array_equal(held.samples[7].crop, again.samples[7].crop)

    def network(away):
        """Peaks at the labels, or a tenth of the crop and more beside them."""
        rest = iter(held.samples)

        def run(crops):
            maps = np.zeros((len(crops), 14, 16, 16), dtype=np.float32)
            for m, sample in zip(maps, rest, strict=False):
                cells = np.clip(np.rint(np.nan_to_num((sample.keypoints + 0.5) / 2 - 0.5)).astype(int), 0, 15)
                for k, (column, row) in enumerate(cells):
                    m[k, row, (column + away) % 16] = 1.0
            return SimpleNamespace(maps=torch.from_numpy(maps))

        return run

    assert held.score(network(0)) == 1.0
    assert held.score(network(4)) == 0.0
    hidden = HeldOut([replace(sample, visible=np.zeros(14)) for sample in held.samples])
    assert np.isnan(hidden.score(network(0)))


def test_workers_start_after_opencv_has_used_threads(source, tmp_path):
    import cv2

    cv2.setNumThreads(2)
    cv2.resize(np.zeros((2000, 2000, 3), dtype=np.uint8), (1000, 1000))
    display = Display()
    train_in_rounds(source, tmp_path, replace(HOW, workers=1), [1], display=display)
    assert [report.step for report in display.reports] == [1, 2]


def test_a_training_goes_on_with_what_it_began_with(trained, source, tmp_path):
    with pytest.raises(InvalidInputError, match="began with"):
        train_in_rounds(source, trained[0], HOW, [1], Beginning(silhouettes=tmp_path))


def test_a_training_goes_on_with_the_same_marks(source, tmp_path):
    marks = np.full((6, 14, 2), np.nan)
    marks[0, 12] = 1.0
    begun = replace(source, marks=marks)
    train_in_rounds(begun, tmp_path, HOW, [1])
    train_in_rounds(begun, tmp_path, HOW, [1])
    with pytest.raises(InvalidInputError, match="began with"):
        train_in_rounds(replace(source, marks=marks + 1.0), tmp_path, HOW, [1])


def test_a_trained_network_can_go_on(source, tmp_path):
    torch.manual_seed(1)
    begun = KNet(SMALL)
    start = save_weights(
        tmp_path / "s.safetensors", Stored(begun.state_dict(), SMALL.to_dict(), ConfidenceCalibration(), {})
    )
    how = replace(HOW, steps=1, rate=0.0)
    network, labelling, _ = train_in_rounds(source, tmp_path / "work", how, [], Beginning(start=start))
    torch.testing.assert_close(network.head.weight, begun.head.weight, atol=1e-3, rtol=1e-3)
    first = Labelling.open(tmp_path / "work" / "labels-first.npz", source.cars)
    assert np.abs(labelling.labels.keypoints - first.labels.keypoints).max() > 0


def test_networks_between_rounds_keep_the_refinement_that_they_began_with(trained, tmp_path):
    sizes = RefineSettings(crop=64, width=4)
    calibration = ConfidenceCalibration(floor=0.03)
    begun = Stored(
        KNet(SMALL).state_dict(), SMALL.to_dict(), calibration, {}, RefineNet(sizes).state_dict(), sizes.to_dict()
    )
    content = load_checkpoint(trained[0] / "knet.pt")
    detector = _as_detector(content, begun, tmp_path, "cpu")
    between = load_tensors(tmp_path / "round.safetensors")
    assert between.calibration == calibration
    assert between.refine_settings == sizes.to_dict()
    assert detector._refine_patches is not None
    for name, value in between.refinement.items():
        torch.testing.assert_close(value.float(), begun.refinement[name].float(), atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(between.state["head.weight"], content["average"]["head.weight"], atol=1e-3, rtol=1e-3)


def test_a_network_whose_points_agree_with_no_shape_is_refused(source, tmp_path):
    labelling = first_labelling(source)
    folder = tmp_path / "work"
    folder.mkdir()
    for name in ("labels-first.npz", "labels-0.npz"):
        replace(labelling, trusted=np.zeros(6, dtype=bool)).save(folder / name)
    with pytest.raises(InvalidInputError, match="no photograph agrees"):
        train_in_rounds(source, folder, HOW, [])


def test_coupes_do_not_teach_where_rear_windows_are(source):
    names = ("Audi A4 Sedan 2012", "Audi TTS Coupe 2012")
    cars = [replace(car, name=names[i == 1]) for i, car in enumerate(source.cars)]
    labels = first_labelling(replace(source, cars=cars)).labels.keypoints
    unknown = np.isnan(labels).any(axis=-1)
    assert np.flatnonzero(unknown.any(axis=1)).tolist() == [1]
    assert np.flatnonzero(unknown[1]).tolist() == [12, 13]


def test_marks_teach_where_a_coupes_rear_window_is(source, detector, tmp_path):
    cars = [replace(car, name="Audi TTS Coupe 2012") for car in source.cars]
    marks = np.full((6, 14, 2), np.nan)
    marks[0, 12] = cars[0].project(source.prior.mean)[12]
    marked = replace(source, cars=cars, marks=marks)
    assert marked.marked == 1
    first = first_labelling(marked)
    assert np.isnan(first.labels.keypoints[:, 12:]).all()
    labels = corrected(marked, first, detector, open_photographs(marked, first, tmp_path)).labels.keypoints
    assert np.isfinite(labels[:3]).all()
    assert np.isnan(labels[3:, 12:]).all()  # another shape


def test_labels_survive_the_file(source, tmp_path):
    labelling = first_labelling(source)
    labelling.save(tmp_path / "l.npz")
    back = Labelling.open(tmp_path / "l.npz", source.cars)
    np.testing.assert_array_equal(back.labels.keypoints, labelling.labels.keypoints)
    np.testing.assert_array_equal(back.fits["b"].coefficients, labelling.fits["b"].coefficients)
    np.testing.assert_allclose(back.cars[2].rotation, source.cars[2].rotation)
    with pytest.raises(InvalidInputError, match="photographs"):
        Labelling.open(tmp_path / "l.npz", source.cars[:3])


def test_calibration_runs_on_held_out_samples(trained, source, detector):
    photographs = trained[3][2]
    fitted = calibrate(detector, photographs, source.validate, source.prior.category.mirror, samples=6)
    assert all(np.isfinite(value) for value in fitted.to_dict().values())
    assert fitted != ConfidenceCalibration()
    again = calibrate(detector, photographs, source.validate, source.prior.category.mirror, samples=6)
    other = calibrate(detector, photographs, source.validate, source.prior.category.mirror, samples=6, seed=2)
    assert again == fitted != other


def test_reliability_sorts_points_by_confidence():
    found = reliability([0.9, 0.1, 0.8, 0.2], [True, False, False, False], bins=2)
    np.testing.assert_allclose(found.confidence, [0.15, 0.85])
    np.testing.assert_allclose(found.right, [0.0, 0.5])
    assert found.error == pytest.approx((0.15 + 0.35) / 2)


def test_scores_count_visible_points_alone(source, detector):
    car = source.cars[0]
    visible = np.array([True] * 4 + [False] * 10)
    (detection,) = detector(np.zeros((car.size[1], car.size[0], 3), dtype=np.uint8), [car.box])
    extent = max(car.size)
    truth = detection.observation.keypoints + extent * np.array([0.07, 0.0])
    truth[3] += extent
    mark = Mark(car.image, "car", "easy", car.box, truth, visible)
    write_png(car.image, np.zeros((car.size[1], car.size[0], 3), dtype=np.uint8))
    scored = score_marks(detector, [mark])
    result = localisation(scored, ("easy",))
    assert (result.cars, result.points) == (1, 4)
    assert (result.within_tenth, result.within_twentieth) == (0.75, 0.0)
    assert result.median == pytest.approx(0.07)
    assert np.isnan(result.keypoints[4:]).all()
    assert localisation(scored, ("hard",)).cars == 0
    assert marks_reliability(scored, bins=2).count.sum() == 14


def test_directions_are_compared_on_the_full_circle(source, detector):
    class Turned:
        def __init__(self, car, degrees):
            c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
            self.camera_T_object = np.eye(4)
            self.camera_T_object[:3, :3] = car.rotation @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
            self.camera_T_object[:3, 3] = car.translation

    cars = source.cars[1:4]
    answers = iter([Turned(cars[0], 0), Turned(cars[1], 170), None])

    def solve(detection, camera):
        answer = next(answers)
        if answer is None:
            raise InvalidInputError("keypoints", "none", "Give some.")
        return answer

    np.testing.assert_allclose(azimuth_errors(detector, cars, solve), [0, 170, 180], atol=1e-6)


def flipped(path, at):
    """A byte of a file changed."""
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 0xFF
    path.write_bytes(content)


@pytest.mark.parametrize(
    "name", ["knet.pt", "labels-first.npz", "labels-1.npz", "photographs/scales.npy", "photographs/images.npy"]
)
def test_a_damaged_part_of_a_training_is_named_and_made_again(name, source, tmp_path):
    network, labelling, _ = train_in_rounds(source, tmp_path, HOW, [1])
    path = tmp_path / name
    if name.endswith(".npy"):
        path.write_bytes(path.read_bytes()[:100])
    else:
        flipped(path, 0.5)
    with pytest.warns(DamagedFileWarning, match="is damaged"):
        again, labels, _ = train_in_rounds(source, tmp_path, HOW, [1])
    assert np.isfinite(labels.labels.keypoints[labels.trusted]).any()
    if name != "labels-1.npz":  # made by the network of its time, not by that of now
        np.testing.assert_array_equal(labels.labels.keypoints, labelling.labels.keypoints)
        for key, value in network.state_dict().items():
            torch.testing.assert_close(again.state_dict()[key], value, msg=key)
    again, _, _ = train_in_rounds(source, tmp_path, HOW, [1])  # and is whole now
    assert load_checkpoint(tmp_path / "knet.pt")["step"] == 2
