"""KNet, its loss, training and weights, on made-up data: shapes, determinism, resumption; no quality."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.images import write_png
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.network_file import Stored, save_weights
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.dataset import Photographs, prepare_photographs
from fgrecon_research.training.keypoints.labels import fit_shape, project_labels
from fgrecon_research.training.keypoints.trainer import load_tensors, mean_state
from research.tests.training.keypoints.support import made_up_cars, unit_car_prior

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.layout import KNetSettings  # noqa: E402
from fgrecon_research.training.keypoints.knet import KNet, load_imagenet  # noqa: E402
from fgrecon_research.training.keypoints.losses import gaussian_maps, knet_loss  # noqa: E402
from fgrecon_research.training.keypoints.train import HeldOut, Training, first_network, train_knet  # noqa: E402
from fgrecon_research.training.keypoints.trainer import load_checkpoint  # noqa: E402
from fgrecon_research.training.keypoints.views import TrainingSet, azimuth_weights  # noqa: E402

MIRROR = load_category("car14").mirror
SMALL = KNetSettings(crop=32, width=8)
UNKNOWN = torch.tensor([-1])


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cars")
    rng, prior = np.random.default_rng(0), unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 4, rng, folder)
    for car in cars:
        write_png(car.image, rng.integers(0, 255, (*car.size[::-1], 3)).astype(np.uint8))
    fit = fit_shape(prior, cars)
    prepare_photographs(cars, [fit] * 4, prior, folder / "prepared")
    return Photographs.load(folder / "prepared", project_labels(prior, fit, cars), cars), cars


def test_prepared_photographs_keep_labels_and_masks_in_place(photographs):
    prepared, cars = photographs
    for number, car in enumerate(cars):
        view = prepared.view(number)
        assert max(view.image.shape[:2]) == 192
        assert view.mask.shape == view.image.shape[:2]
        assert 0.4 < (view.mask > 127).mean() < 1.0
        inside = view.keypoints[view.visible > 0.5]
        assert ((inside > -1) & (inside < np.array(view.mask.shape[::-1]))).all()
        assert view.azimuth == car.azimuth


def test_photographs_that_are_there_are_all_there(photographs, tmp_path, monkeypatch):
    save = np.save

    def killed(file, array):
        if array.dtype == np.float64:  # the scales
            with file if hasattr(file, "write") else Path(file).open("wb") as half:
                half.write(b"half of it")
            raise KeyboardInterrupt
        save(file, array)

    _, cars = photographs
    prior = unit_car_prior()
    monkeypatch.setattr(np, "save", killed)
    with pytest.raises(KeyboardInterrupt):
        prepare_photographs(cars, [fit_shape(prior, cars)] * 4, prior, tmp_path)
    assert (tmp_path / "distant.npz").exists()
    assert not (tmp_path / "scales.npy").exists()


def test_directions_are_evened_out():
    azimuth = np.concatenate([np.full(900, 0.1), np.full(100, 3.0)])
    weights = azimuth_weights(azimuth, np.arange(1000), strength=1.0, limit=20.0)
    assert weights.sum() == pytest.approx(1.0)
    assert weights[azimuth > 1].sum() == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(azimuth_weights(azimuth, np.arange(1000), strength=0.0), 1e-3)


def test_shapes_and_a_wrong_size():
    network = KNet(SMALL).eval()
    output = network(torch.zeros(2, 3, 32, 32))
    assert output.maps.shape == (2, 14, 16, 16)
    assert output.visible.shape == (2, 14)
    assert output.azimuth.shape == (2, 36)
    with pytest.raises(InvalidInputError, match="multiple of 32"):
        KNet(KNetSettings(crop=50))


def test_imagenet_weights_have_to_fit():
    network, other = KNet(SMALL), KNet(SMALL)
    state = {}
    for number, module in enumerate(network.encoder()):
        state |= {f"{number}.{name}": value for name, value in module.state_dict().items()}
    load_imagenet(other, state)
    for ours, theirs in zip(network.encoder(), other.encoder(), strict=True):
        assert torch.equal(ours.weight, theirs.weight)
    first = next(iter(state))
    with pytest.raises(InvalidInputError, match="EfficientNet"):
        load_imagenet(other, {**state, first: torch.zeros(1)})


def test_targets_are_distributions_around_the_points():
    points = torch.tensor([[10.0, 20.5]])
    maps = gaussian_maps(points, 16, 2.0, 2.5).view(16, 16)
    cells = (torch.arange(16) + 0.5) * 2 - 0.5
    assert float(maps.sum()) == pytest.approx(1.0)
    assert float((maps.sum(0) * cells).sum()) == pytest.approx(10.0, abs=0.05)
    assert float((maps.sum(1) * cells).sum()) == pytest.approx(20.5, abs=0.05)


def test_hidden_and_absent_points_count_less_and_not_at_all():
    torch.manual_seed(0)
    with torch.no_grad():
        output = KNet(SMALL).eval()(torch.randn(1, 3, 32, 32) * 50 + 127)
    points, azimuth = torch.full((1, 14, 2), 12.0), torch.zeros(1)
    loss = knet_loss(output, points, torch.ones(1, 14), azimuth, UNKNOWN, 2.0)
    assert float(loss["total"]) > 0
    gone = points.clone()
    gone[0, :, 0] = 500.0
    assert float(knet_loss(output, gone, torch.zeros(1, 14), azimuth, UNKNOWN, 2.0)["maps"]) == 0.0


def test_keypoints_of_unknown_place_teach_nothing():
    torch.manual_seed(0)
    network = KNet(SMALL).eval()
    crops, azimuth = torch.randn(1, 3, 32, 32) * 50 + 127, torch.zeros(1)
    points = torch.full((1, 14, 2), 12.0)
    points[0, 12:] = torch.nan
    slopes = []
    for visible in (torch.ones(1, 14), torch.cat([torch.ones(1, 12), torch.zeros(1, 2)], dim=1)):
        network.zero_grad()
        loss = knet_loss(network(crops), points, visible, azimuth, UNKNOWN, 2.0)
        loss["total"].backward()
        slopes.append([p.grad.clone() for p in network.parameters() if p.grad is not None])
    assert all(torch.isfinite(slope).all() for slope in slopes[0])
    assert all(torch.equal(a, b) for a, b in zip(*slopes, strict=True))
    assert slopes[0][-1].abs().max() > 0


def test_kinds_are_learnt_where_they_are_known():
    torch.manual_seed(0)
    network = KNet(replace(SMALL, kinds=3)).eval()
    crops, azimuth = torch.randn(2, 3, 32, 32) * 50 + 127, torch.zeros(2)
    points, visible = torch.full((2, 14, 2), 12.0), torch.ones(2, 14)
    with torch.no_grad():
        output = network(crops)
    expected = -torch.log_softmax(output.kind, dim=1)[1, 2]
    found = knet_loss(output, points, visible, azimuth, torch.tensor([-1, 2]), 2.0)
    torch.testing.assert_close(found["kind"], expected)
    none = knet_loss(output, points, visible, azimuth, torch.tensor([-1, -1]), 2.0)
    assert float(none["kind"]) == 0.0
    assert float(found["total"] - none["total"]) == pytest.approx(0.2 * float(expected), rel=1e-4)


def test_an_interrupted_training_ends_like_an_uninterrupted_one(photographs, tmp_path):
    prepared, _ = photographs
    how = Training(
        steps=4, batch=2, warmup=1, save_every=2, workers=0, network=SMALL, street=Street(size=32), rate=1e-3
    )
    learning = TrainingSet(prepared, np.arange(4), np.full(4, 0.25))
    reports = []
    whole = train_knet(first_network(how), learning, MIRROR, tmp_path / "a.pt", how, report=reports.append)
    train_knet(first_network(how), learning, MIRROR, tmp_path / "b.pt", how, until=2)
    assert load_checkpoint(tmp_path / "b.pt")["step"] == 2
    resumed = train_knet(first_network(how), learning, MIRROR, tmp_path / "b.pt", how)
    for name, value in whole.state_dict().items():
        torch.testing.assert_close(value, resumed.state_dict()[name], msg=name)
    assert [report.step for report in reports] == [2, 4]
    assert set(reports[0].losses) == {"total", "maps", "visible", "azimuth"}


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_a_training_on_a_device_gives_a_network_for_any(photographs, tmp_path, device):
    if device != "cpu" and not torch.cuda.is_available():
        pytest.skip("there is no GPU")
    prepared, _ = photographs
    how = Training(
        steps=2, batch=2, warmup=1, save_every=1, workers=0, device=device, network=SMALL, street=Street(size=32)
    )
    held = HeldOut.draw(prepared, np.arange(4), how.street, MIRROR, 0, 4)
    arguments = (TrainingSet(prepared, np.arange(4), np.full(4, 0.25)), MIRROR, tmp_path / "a.pt", how)
    reports = []
    train_knet(first_network(how), *arguments, held=held, report=reports.append, until=1)
    network = train_knet(first_network(how), *arguments, held=held, report=reports.append)
    assert [report.step for report in reports] == [1, 2]
    assert all(np.isfinite([report.score, *report.losses.values()]).all() for report in reports)
    state = mean_state(KNet(SMALL).state_dict(), network.state_dict(), 0.5)
    path = save_weights(tmp_path / "w.safetensors", Stored(state, SMALL.to_dict(), ConfidenceCalibration(), {}))
    assert all(torch.isfinite(value).all() for value in load_tensors(path).state.values())


def test_a_checkpoint_of_another_network_is_refused(photographs, tmp_path):
    prepared, _ = photographs
    small = Training(steps=1, batch=2, workers=0, network=SMALL, street=Street(size=32))
    arguments = (TrainingSet(prepared, np.arange(4), np.full(4, 0.25)), MIRROR, tmp_path / "a.pt")
    train_knet(first_network(small), *arguments, small)
    wider = Training(steps=1, batch=2, workers=0, network=KNetSettings(crop=32, width=16), street=Street(size=32))
    with pytest.raises(InvalidInputError, match="same sizes"):
        train_knet(first_network(wider), *arguments, wider)
    (tmp_path / "no.pt").write_bytes(b"nothing")
    with pytest.raises(InvalidInputError, match="checkpoint"):
        load_checkpoint(tmp_path / "no.pt")


def test_weights_survive_the_file(tmp_path):
    torch.manual_seed(0)
    network = KNet(SMALL).eval()
    stored = Stored(network.state_dict(), SMALL.to_dict(), ConfidenceCalibration(0.1, 0.2, 0.3, 0.4), {"data": "none"})
    back = load_tensors(save_weights(tmp_path / "w.safetensors", stored))
    assert back.settings == SMALL.to_dict()
    assert back.calibration == stored.calibration
    assert back.provenance == {"data": "none"}
    for name, value in back.state.items():
        torch.testing.assert_close(value, network.state_dict()[name].float(), atol=1e-3, rtol=1e-3)
    for content in (b"nothing", b""):
        (tmp_path / "bad.safetensors").write_bytes(content)
        with pytest.raises(InvalidInputError, match="weights"):
            load_tensors(tmp_path / "bad.safetensors")


def test_the_mean_of_two_networks():
    first = {"a": torch.tensor([1.0, 2.0]), "n": torch.tensor(3)}
    second = {"a": torch.tensor([3.0, 4.0]), "n": torch.tensor(7), "new": torch.tensor([5.0])}
    mean = mean_state(first, second, 0.25)
    torch.testing.assert_close(mean["a"], torch.tensor([2.5, 3.5]))
    assert mean["n"].item() == 7
    torch.testing.assert_close(mean["new"], second["new"])
